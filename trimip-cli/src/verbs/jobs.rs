//! Trainings of `bench` and `paper` as jobs that free ranks take.

use crate::{interrupt, terminal};
use serde::{Deserialize, Serialize};
use std::path::PathBuf;
use std::sync::atomic::Ordering;
use trimip::ranks::scatter_jobs;
use trimip::{Listeners, Outcome, Result, Training, events::Event, machine};
use trimip_core::{Error, ErrorKind, engine::exchange::Ranks, scene::fingerprint::Fingerprint};
use trimip_data::settings::DataConfig;

/// How a job ended.
#[derive(Serialize, Deserialize)]
pub enum JobEnd {
    /// The run is trained; the fingerprint is that of its photographs, `None` if the run was trained already.
    Trained(Option<Fingerprint>),
    /// The user stopped the run.
    Stopped,
    /// The run failed, with this reason.
    Failed(String),
}

/// Trains silently, as one job of several. The other ranks of this machine train their own jobs at the same time.
pub fn job(ranks: &dyn Ranks, training: Result<Training>) -> JobEnd {
    let quietly = |training: Training| {
        let stop = interrupt::install()?;
        machine::reset_peak_memory();
        let mut events = |_: &Event| {};
        let going = |_, _| !stop.load(Ordering::Relaxed);
        let listeners = Listeners { events: &mut events, reading: &going, observer: &mut (), stop: &stop };
        let trained = training.with_machine_rank(ranks.on_machine()).run_with(listeners)?;
        trained.outcome.map(|ended| (ended, trained.data))
    };
    match training.and_then(quietly) {
        Ok((Outcome::Stopped, _)) => JobEnd::Stopped,
        Ok((_, data)) => JobEnd::Trained(data),
        Err(error) if error.kind() == ErrorKind::Stopped => JobEnd::Stopped,
        Err(error) => JobEnd::Failed(error.message()),
    }
}

/// Trains runs on all ranks: each free rank takes the next run. Called on rank 0. A run that fails stays unfinished,
/// and the caller finds it later. `what` describes the runs, `data` returns the data set of a run. Returns false if the
/// user stopped it on any rank.
///
/// # Errors
/// When another rank is gone, or two runs on one data set used different photographs.
pub fn spread(
    ranks: &dyn Ranks,
    what: &str,
    runs: &[usize],
    data: impl Fn(usize) -> Result<DataConfig>,
    training: impl Fn(usize) -> Result<Training>,
) -> Result<bool> {
    let stop = interrupt::install()?;
    let going = || !stop.load(Ordering::Relaxed);
    let (mut count, mut whole, mut seen) = (0, true, Vec::new());
    scatter_jobs(
        ranks,
        what,
        runs,
        &going,
        |run| Ok(job(ranks, training(run))),
        |run, end| {
            count += 1;
            let told = |end| terminal::aside(format!("run {count} of {} {end}", runs.len()));
            match end {
                JobEnd::Trained(views) => {
                    told("is trained".to_string());
                    if let Some(views) = views {
                        let folder = training(run)?.folder().root().to_path_buf();
                        seen.push(RunData { folder, data: format!("{:?}", data(run)?), views });
                    }
                    expect_one(&seen)?;
                }
                JobEnd::Failed(reason) => told(format!("failed: {reason}")),
                // No more jobs are handed out, because a rank that the user stopped would end each of them at once.
                JobEnd::Stopped => whole = false,
            }
            Ok(whole && going())
        },
    )?;
    Ok(whole && going())
}

/// The data that a run was trained on.
struct RunData {
    folder: PathBuf,
    /// Settings of the data set.
    data: String,
    views: Fingerprint,
}

/// Refuses the last of these runs if an earlier one on the same data set used different photographs.
fn expect_one(seen: &[RunData]) -> Result<()> {
    let Some((last, earlier)) = seen.split_last() else { return Ok(()) };
    let same = earlier.iter().filter(|run| run.data == last.data);
    for run in same {
        if let Some(difference) = last.views.difference(&run.views) {
            return Err(Error::input(
                last.folder.display(),
                format!("was trained on other photographs than {}: {difference}", run.folder.display()),
                "give every machine the same data under the same path, and remove the run with the other photographs",
            ));
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_on_one_data_set_have_the_same_photographs() {
        let run = |folder: &str, data: &str, pixels| RunData {
            folder: folder.into(),
            data: data.into(),
            views: Fingerprint { views: 3, cameras: 1, pixels },
        };
        let mut seen = vec![run("a", "lego", 5), run("b", "chair", 6), run("c", "lego", 5)];
        expect_one(&seen).expect("no two on one data set differ");
        seen.push(run("d", "chair", 5));
        let error = expect_one(&seen).unwrap_err();
        assert!(
            error.kind() == ErrorKind::Input
                && error.message().starts_with("d: was trained on other photographs"),
            "{error}"
        );
        assert!(error.message().contains("than b: other pixels"), "{error}");
    }
}
