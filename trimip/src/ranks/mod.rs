//! Several processes, called ranks, that work as one program. Rank 0 runs the program, reads and writes every file of a run, and
//! leads; the others [`follow`] its orders. Rank 0 trains through a session that gives the same orders to all ranks, so that every
//! rank takes the same steps.

mod jobs;
mod lead;
mod orders;

pub use jobs::{digest, scatter_jobs, work_on_jobs};
pub use lead::train;

use crate::{backends, machine, run::memory};
use orders::{Order, computes_with};
use std::sync::Arc;
use trimip_core::{
    Config, Error, ErrorKind, Result, Session,
    engine::{checkpoint::Checkpoint, exchange::Ranks},
    scene::fingerprint::Fingerprint,
    scene_plan::Compute,
};

/// Orders all other ranks to end.
///
/// # Errors
/// When another rank is gone.
pub fn dismiss(ranks: &dyn Ranks) -> Result<()> {
    Order::Quit.give(ranks)
}

/// Follows the orders of rank 0 until it dismisses this rank. `work` does the jobs of [`scatter_jobs`], by calling [`work_on_jobs`] at its
/// end; `tell` receives warnings.
///
/// # Errors
/// When this rank cannot follow an order. The other ranks then wait for it in vain, and the caller has to end them.
pub fn follow(
    ranks: &Arc<dyn Ranks>,
    work: &mut dyn FnMut(&dyn Ranks) -> Result<()>,
    tell: &mut dyn FnMut(String),
) -> Result<()> {
    loop {
        match Order::await_from(&**ranks)? {
            Order::Train { version, config, data, computes } => {
                let session = open(ranks, &version, &config, data, &computes, tell);
                let answer = session.as_ref().map(drop);
                ranks.send(0, &serde_json::to_vec(&answer).map_err(Error::run)?)?;
                follow_training(ranks, session.ok())?;
            }
            Order::Jobs { version } => {
                expect_own(&version)?;
                work(&**ranks)?;
            }
            Order::Quit => return Ok(()),
            _ => return Err(Error::run("rank 0 gave an order to a session that is not open")),
        }
    }
}

fn expect_own(version: &str) -> Result<()> {
    let own = machine::version();
    if version == own {
        return Ok(());
    }
    Err(Error::input(
        "this program",
        format!("is {own}, but the program of rank 0 is {version}"),
        "install the same program on every machine",
    ))
}

/// Returns a description of the compute of all ranks together, if each rank has `compute`.
pub fn together(compute: Compute, ranks: &dyn Ranks) -> Compute {
    let of = ranks.rank().size;
    Compute {
        name: format!("{of} ranks, each {}", compute.name),
        samples_per_second: of as f64 * compute.samples_per_second,
        ..compute
    }
}

/// Opens the session of a training that rank 0 leads.
fn open(
    ranks: &Arc<dyn Ranks>,
    version: &str,
    config: &str,
    data: Fingerprint,
    computes: &str,
    tell: &mut dyn FnMut(String),
) -> Result<Box<dyn Session>> {
    expect_own(version)?;
    let config = Config::from_toml("the orders of rank 0", config)?;
    let near = ranks.on_machine();
    let own = computes_with(&config, near)?;
    if own != computes {
        tell(format!(
            "computes with {own}, but rank 0 with {computes}: a single process would give other bits"
        ));
    }
    let scene = trimip_data::open(&config.section()?)?;
    if let Some(difference) = Fingerprint::of(&scene.train).difference(&data) {
        return Err(Error::input(
            &config.data.root,
            format!("holds other photographs than rank 0: {difference}"),
            "give every machine the same data under the same path",
        ));
    }
    // The first rank of each machine checks the memory; rank 0 does so for its own machine.
    if config.backend == "cpu" && near.id == 0 {
        let predicted = backends::predict_memory(&config, &scene.train);
        if let Some(warning) = memory::check(&config, &predicted, near.size)? {
            tell(format!("warns: {warning}"));
        }
    }
    backends::train_over(&config, scene.train, Arc::clone(ranks))
}

/// Follows the orders of rank 0 until the training is over. Without a session, only waits for the end of the training.
fn follow_training(ranks: &Arc<dyn Ranks>, session: Option<Box<dyn Session>>) -> Result<()> {
    let Some(mut session) = session else {
        return match Order::await_from(&**ranks)? {
            Order::Close => Ok(()),
            _ => Err(Error::run("rank 0 trains although this rank cannot")),
        };
    };
    loop {
        let done = match Order::await_from(&**ranks)? {
            Order::Step(progress) => session.step(progress).map(drop),
            Order::Checkpoint => session.join_checkpoint(),
            Order::Restore => {
                let checkpoint = {
                    let mut bytes = Vec::new();
                    ranks.broadcast(&mut bytes)?;
                    Checkpoint::from_bytes("the checkpoint of rank 0", &bytes)?
                };
                session.restore(&checkpoint)?;
                Ok(())
            }
            Order::Close => return Ok(()),
            _ => return Err(Error::run("rank 0 gave another order while a session was open")),
        };
        match done {
            // All ranks have the same sums, so a step fails on all of them or on none. Rank 0 reports the failure.
            Err(error) if error.kind() == ErrorKind::Device => return Err(error),
            Err(_) | Ok(()) => {}
        }
    }
}
