//! The processes that `mpirun` or `srun` launched together. Rank 0 is the program; the others do what it orders.

#[cfg(feature = "mpi")]
mod guard;

use std::sync::Arc;
use trimip_core::{Result, exchange::Ranks};

/// The ranks of this program, if there are several.
pub fn all() -> Option<Arc<dyn Ranks>> {
    launched::all()
}

/// Runs `program` on rank 0, and lets the others follow it and `help` with its jobs; without a launcher just runs it.
///
/// # Errors
/// Those of the program, and when the ranks cannot work together.
pub fn among(program: impl FnOnce() -> Result<u8>, help: impl FnMut(&dyn Ranks) -> Result<()>) -> Result<u8> {
    if trimip_mpi::launched().of == 1 { program() } else { launched::among(program, help) }
}

#[cfg(feature = "mpi")]
mod launched {
    use super::guard;
    use crate::{interrupt, terminal};
    use std::sync::{Arc, OnceLock};
    use trimip::ranks;
    use trimip_core::{Error, Result, exchange::Ranks};
    use trimip_mpi::World;

    static WORLD: OnceLock<Arc<World>> = OnceLock::new();

    pub fn all() -> Option<Arc<dyn Ranks>> {
        WORLD.get().map(|world| Arc::clone(world) as Arc<dyn Ranks>).filter(|ranks| ranks.share().of > 1)
    }

    pub fn among(
        program: impl FnOnce() -> Result<u8>,
        help: impl FnMut(&dyn Ranks) -> Result<()>,
    ) -> Result<u8> {
        if !guard::is_there() {
            return guard::watch();
        }
        guard::heed()?;
        let world = Arc::clone(WORLD.get_or_init(|| Arc::new(World::default())));
        world.start()?;
        let rank = world.share().rank;
        // A rank that panics would leave the others waiting for it.
        let (tell, held) = (std::panic::take_hook(), Arc::clone(&world));
        std::panic::set_hook(Box::new(move |panic| {
            tell(panic);
            terminal::aside(format!("error: rank {rank} panicked"));
            held.abort(3);
        }));
        let outcome = if rank == 0 { lead(&world, program) } else { follow(&world, rank, help) };
        world.end();
        outcome
    }

    fn lead(world: &World, program: impl FnOnce() -> Result<u8>) -> Result<u8> {
        let outcome = program();
        match &outcome {
            // The others may be in the middle of a step and wait for this rank.
            Err(error) if error.exit_code() == 3 => {
                terminal::error(&Error { message: format!("rank 0: {}", error.message), ..error.clone() });
                world.abort(3)
            }
            _ => ranks::dismiss(world)?,
        }
        summary(world);
        outcome
    }

    fn follow(world: &Arc<World>, rank: usize, mut help: impl FnMut(&dyn Ranks) -> Result<()>) -> Result<u8> {
        // Rank 0 gets the same signal, and tells the others when to end.
        interrupt::install()?;
        let ranks: Arc<dyn Ranks> = Arc::clone(world) as Arc<dyn Ranks>;
        ranks::follow(&ranks, &mut help).map(|()| 0).inspect_err(|error| {
            terminal::error(&Error { message: format!("rank {rank}: {}", error.message), ..error.clone() });
            world.abort(error.exit_code())
        })
    }

    /// Tells what the ranks sent each other in a training.
    fn summary(world: &World) {
        let traffic = world.traffic();
        if traffic.steps == 0 {
            return;
        }
        let a_step = traffic.bytes as f64 / traffic.steps as f64;
        terminal::aside(format!(
            "{} ranks: a step sent {} from rank 0, {:.2} times the touched part of the gradient; exchanges took {:.1} % of the \
             time",
            world.share().of,
            terminal::bytes(a_step as u64),
            traffic.bytes as f64 / traffic.touched.max(1) as f64,
            100.0 * traffic.trading / traffic.seconds.max(f64::MIN_POSITIVE)
        ));
    }
}

#[cfg(not(feature = "mpi"))]
mod launched {
    use std::sync::Arc;
    use trimip_core::{Error, Result, exchange::Ranks};

    pub fn all() -> Option<Arc<dyn Ranks>> {
        None
    }

    pub fn among(_: impl FnOnce() -> Result<u8>, _: impl FnMut(&dyn Ranks) -> Result<()>) -> Result<u8> {
        Err(Error::input(
            format!("{} processes", trimip_mpi::launched().of),
            "this build trains in one process",
            "start it without mpirun, or build it with --features mpi",
        ))
    }
}
