//! The processes that `mpirun` or `srun` launched together. Rank 0 runs the program; the others follow its orders.

#[cfg(feature = "mpi")]
mod supervisor;

use std::sync::Arc;
use trimip_core::{Result, engine::exchange::Ranks};

/// Returns true on rank 0, or without MPI, for the only process that prints.
pub fn speaks() -> bool {
    trimip_mpi::launched().id == 0
}

/// Returns the ranks of this program, if there are several.
pub fn all() -> Option<Arc<dyn Ranks>> {
    launched::all()
}

/// Runs `program` on rank 0, while the other ranks follow its orders and do `work` on its jobs. Without a launcher, only runs `program`.
///
/// # Errors
/// Errors of the program, and when the ranks cannot work together.
pub fn among(program: impl FnOnce() -> Result<u8>, work: impl FnMut(&dyn Ranks) -> Result<()>) -> Result<u8> {
    if trimip_mpi::launched().size == 1 { program() } else { launched::among(program, work) }
}

#[cfg(feature = "mpi")]
mod launched {
    use super::supervisor;
    use crate::{interrupt, terminal, wording::exit_code};
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::sync::{Arc, OnceLock};
    use trimip::ranks;
    use trimip_core::{ErrorKind, Result, engine::exchange::Ranks};
    use trimip_mpi::World;

    static WORLD: OnceLock<Arc<World>> = OnceLock::new();

    pub fn all() -> Option<Arc<dyn Ranks>> {
        WORLD.get().map(|world| Arc::clone(world) as Arc<dyn Ranks>).filter(|ranks| ranks.rank().size > 1)
    }

    pub fn among(
        program: impl FnOnce() -> Result<u8>,
        work: impl FnMut(&dyn Ranks) -> Result<()>,
    ) -> Result<u8> {
        if !supervisor::is_there() {
            return supervisor::watch();
        }
        supervisor::heed()?;
        let world = Arc::clone(WORLD.get_or_init(|| Arc::new(World::default())));
        if let Err(error) = world.start() {
            // All ranks have the same error, so only rank 0 reports it.
            return if super::speaks() { Err(error) } else { Ok(exit_code(&error)) };
        }
        let rank = world.rank().id;
        compare_arguments(&world)?;
        let work = || if rank == 0 { lead(&world, program) } else { follow(&world, rank, work) };
        // Without the abort, the other ranks would wait for a rank that panicked.
        let outcome = catch_unwind(AssertUnwindSafe(work)).unwrap_or_else(|_| {
            terminal::aside(format!("error: rank {rank} panicked"));
            world.abort(3)
        });
        world.end();
        outcome
    }

    /// Warns if this rank was started with other arguments than rank 0, whose arguments count.
    fn compare_arguments(world: &World) -> Result<()> {
        let words = std::env::args_os().skip(1).map(|word| word.to_string_lossy().into_owned());
        let own = words.collect::<Vec<_>>().join(" ");
        let mut first = own.clone().into_bytes();
        world.broadcast(&mut first)?;
        if first != own.as_bytes() {
            terminal::aside(format!(
                "warning: rank {} was started with the arguments \"{own}\", which are ignored: those of rank 0 count",
                world.rank().id
            ));
        }
        Ok(())
    }

    fn lead(world: &World, program: impl FnOnce() -> Result<u8>) -> Result<u8> {
        let outcome = program();
        match &outcome {
            // The other ranks may be in the middle of a step and wait for this rank.
            Err(error) if error.kind() == ErrorKind::Device => {
                terminal::error(&error.clone().of_rank(0));
                world.abort(3)
            }
            _ => ranks::dismiss(world)?,
        }
        summary(world);
        outcome
    }

    fn follow(world: &Arc<World>, rank: usize, mut work: impl FnMut(&dyn Ranks) -> Result<()>) -> Result<u8> {
        let ranks: Arc<dyn Ranks> = Arc::clone(world) as Arc<dyn Ranks>;
        let mut tell = |text| terminal::aside(format!("warning: rank {rank} {text}"));
        // Rank 0 receives the same signal and orders the others to end.
        interrupt::saves();
        let outcome = interrupt::install().and_then(|_| ranks::follow(&ranks, &mut work, &mut tell));
        outcome.map(|()| 0).inspect_err(|error| {
            terminal::error(&error.clone().of_rank(rank));
            world.abort(exit_code(error))
        })
    }

    /// Prints how much data the ranks exchanged during training.
    fn summary(world: &World) {
        let traffic = world.traffic();
        if traffic.steps == 0 {
            return;
        }
        let a_step = traffic.bytes as f64 / traffic.steps as f64;
        terminal::aside(format!(
            "{} ranks: rank 0 sent {} a step, {:.2} times the touched part of the gradient; exchanges took {:.1} % of the \
             time",
            world.rank().size,
            terminal::bytes(a_step as u64),
            traffic.bytes as f64 / traffic.touched.max(1) as f64,
            100.0 * traffic.trading / traffic.seconds.max(f64::MIN_POSITIVE)
        ));
    }
}

#[cfg(not(feature = "mpi"))]
mod launched {
    use std::sync::Arc;
    use trimip_core::{Error, Result, engine::exchange::Ranks};

    pub fn all() -> Option<Arc<dyn Ranks>> {
        None
    }

    pub fn among(_: impl FnOnce() -> Result<u8>, _: impl FnMut(&dyn Ranks) -> Result<()>) -> Result<u8> {
        if !super::speaks() {
            return Ok(2);
        }
        Err(Error::input(
            format!("{} processes", trimip_mpi::launched().size),
            "this build trains in one process",
            "start it without mpirun, or build it with --features mpi",
        ))
    }
}
