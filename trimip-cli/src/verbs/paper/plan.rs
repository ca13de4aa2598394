//! The runs of a command and the time that they will take, printed before the first run starts.

use super::request::{PaperRun, Request};
use crate::terminal::{count, duration};
use trimip::run::history::History;
use trimip_core::engine::events::progress;

/// Progress of a run.
struct State {
    /// Share of the run that is done, 0 to 1.
    done: f64,
    /// Seconds of training so far.
    seconds: f64,
    /// Seconds of evaluations; `None` unless the run is finished.
    evaluation: Option<f64>,
}

impl State {
    fn of(job: &PaperRun) -> Self {
        let history = History::of(&job.folder.events());
        let finished = history.last().is_some() && job.folder.model().exists();
        // Without a checkpoint, a run starts over.
        let begun = job.folder.checkpoint().exists();
        Self {
            done: if begun { progress(&job.config, &history.totals).clamp(0.0, 1.0) } else { 0.0 },
            seconds: if begun { history.totals.seconds } else { 0.0 },
            evaluation: finished.then(|| history.evaluation_seconds()),
        }
    }
}

/// Returns the plan as lines of text.
pub fn lines(request: &Request) -> Vec<String> {
    let states: Vec<State> = request.jobs.iter().map(State::of).collect();
    let finished = states.iter().filter(|state| state.evaluation.is_some()).count();
    let begun = states.iter().filter(|state| state.evaluation.is_none() && state.done > 0.0).count();
    let names = |names: Vec<&str>| names.join(", ");
    let mut lines = vec![
        format!("systems: {}", names(request.systems.iter().map(|system| system.name).collect())),
        format!("scenes: {}", names(request.scenes.iter().map(|scene| scene.name.as_str()).collect())),
    ];
    if !request.missing.is_empty() {
        lines.push(format!("missing: {}", names(request.missing.clone())));
    }
    lines.push(format!(
        "runs: {}, {finished} finished, {begun} begun; trained on {}; {}",
        request.jobs.len(),
        request.split.join(" + "),
        request.budget().to_lowercase()
    ));
    lines.push(time(&request.jobs, &states, request.stride));
    lines.push(format!("page: {}", request.page().display()));
    lines
}

/// Returns the expected time of the runs that are left, in words.
fn time(jobs: &[PaperRun], states: &[State], stride: u32) -> String {
    let (mut training, mut unknown) = (0.0, Vec::new());
    for (job, state) in jobs.iter().zip(states).filter(|(_, state)| state.evaluation.is_none()) {
        match left(job, state, jobs, states) {
            Some(seconds) => training += seconds,
            None if unknown.contains(&job.system.name) => {}
            None => unknown.push(job.system.name),
        }
    }
    let open = states.iter().filter(|state| state.evaluation.is_none()).count();
    let known: Vec<f64> = states.iter().filter_map(|state| state.evaluation).collect();
    let mut text = format!("expected time: {} of training", duration(training));
    if !unknown.is_empty() {
        text += &format!(
            ", plus the schedules of {}, estimated once a run of each has begun",
            unknown.join(", ")
        );
    }
    let views = match stride {
        1 => "all test views".to_string(),
        _ => format!("1 in {stride} test views"),
    };
    text += &match known.len() {
        0 => format!("; evaluating {views} takes extra time"),
        runs => {
            let mean = known.iter().sum::<f64>() / runs as f64;
            let noun = count(open as u64, "evaluation");
            format!("; {} for {noun} of {views}, judging by finished ones", duration(mean * open as f64))
        }
    };
    text
}

/// Returns the seconds of training left; `None` for a budget of steps if no run of the same system has begun.
fn left(job: &PaperRun, state: &State, jobs: &[PaperRun], states: &[State]) -> Option<f64> {
    let train = &job.config.train;
    if train.steps == 0 {
        return Some((train.seconds - state.seconds).max(0.0));
    }
    let alike = jobs
        .iter()
        .zip(states)
        .filter(|(other, _)| other.system.name == job.system.name && other.scales == job.scales);
    let rates: Vec<f64> =
        alike.filter(|(_, state)| state.done > 0.0).map(|(_, state)| state.seconds / state.done).collect();
    let whole = rates.iter().sum::<f64>() / rates.len() as f64;
    whole.is_finite().then_some(whole * (1.0 - state.done))
}
