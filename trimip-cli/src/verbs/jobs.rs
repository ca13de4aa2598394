//! Trainings of `bench` and `paper` as jobs, which ranks take as they come free.

use crate::{interrupt, terminal};
use serde::{Deserialize, Serialize};
use std::sync::atomic::Ordering;
use trimip::ranks::farm;
use trimip::{Ended, Listeners, Result, Training, events::Event, machine};
use trimip_core::{ErrorKind, exchange::Ranks};

/// How a job ended.
#[derive(Serialize, Deserialize)]
pub enum JobEnd {
    /// The run is trained.
    Trained,
    /// The user stopped it.
    Stopped,
    /// It failed, for this reason.
    Failed(String),
}

/// Trains without a word, as one job of several.
pub fn job(training: Result<Training>) -> JobEnd {
    let quietly = |training: Training| {
        let stop = interrupt::install()?;
        machine::reset_peak_memory();
        let mut events = |_: &Event| {};
        let going = |_, _| !stop.load(Ordering::Relaxed);
        let listeners = Listeners { events: &mut events, reading: &going, onlooker: &mut (), stop: &stop };
        training.run_with(listeners)?.outcome
    };
    match training.and_then(quietly) {
        Ok(Ended::Stopped) => JobEnd::Stopped,
        Ok(_) => JobEnd::Trained,
        Err(error) if error.kind == ErrorKind::Stopped => JobEnd::Stopped,
        Err(error) => JobEnd::Failed(error.message),
    }
}

/// Trains runs on all ranks, of which this is rank 0: a rank that is free takes the next one. A run that fails is left to the
/// caller, who finds it unfinished. `what` describes the runs. Returns false if the user stopped it.
///
/// # Errors
/// When another rank is gone.
pub fn spread(
    ranks: &dyn Ranks,
    what: &str,
    runs: &[usize],
    training: impl Fn(usize) -> Result<Training>,
) -> Result<bool> {
    let stop = interrupt::install()?;
    let going = || !stop.load(Ordering::Relaxed);
    let mut count = 0;
    farm(
        ranks,
        what,
        runs,
        &going,
        |run| Ok(job(training(run))),
        |_, end| {
            count += 1;
            let told = |end| terminal::aside(format!("run {count} of {} {end}", runs.len()));
            match end {
                JobEnd::Trained => told("is trained".to_string()),
                JobEnd::Failed(reason) => told(format!("failed: {reason}")),
                JobEnd::Stopped => {}
            }
            Ok(going())
        },
    )?;
    Ok(going())
}
