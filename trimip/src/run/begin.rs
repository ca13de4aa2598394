//! The starting point of a run: fresh settings, the folder's checkpoint, or a finished run with a longer budget.

use super::{folder::RunFolder, history::Evaluation, history::History, store::FileStore};
use crate::formatting;
use trimip_core::{
    Advice, Config, Error, Result, Settings,
    config::TrainConfig,
    engine::{
        checkpoint::Checkpoint,
        events::{Event, Totals, progress},
    },
    field::adamw,
    plain_file,
    scene_plan::{self, Finding},
};

/// The starting point of a run.
pub struct Beginning {
    pub settings: Settings,
    /// The plan's decisions, if the run resumes.
    pub findings: Vec<Finding>,
    pub checkpoint: Option<Checkpoint>,
    /// How a finished run continues, one line.
    pub extended: Option<String>,
}

impl Beginning {
    /// Starts or resumes a run of the settings `given` in a locked folder; with `fresh`, always starts anew. A resumed run keeps its plan.
    /// A new run is planned once its scene has been read.
    ///
    /// # Errors
    /// When the folder contains another run, or the settings are invalid.
    pub fn of(given: Settings, folder: &RunFolder, fresh: bool) -> Result<Self> {
        let (mut settings, mut findings) = (given.clone(), Vec::new());
        let earlier = if fresh { None } else { folder.findings()? };
        if let Some(earlier) = earlier {
            scene_plan::adopt(&mut settings, &earlier)?;
            findings = earlier;
            keep_extension(&mut settings, folder)?;
        }
        let config = Config::from_settings(&settings)?;
        let checkpoint = if fresh { None } else { folder.resume_point(&config)? };
        let settings = if checkpoint.is_some() { settings } else { given };
        Ok(Self { settings, findings, checkpoint, extended: None })
    }

    /// Extends the finished run of a locked folder by `more` seconds. Uses the settings that the run was trained with, with `assignments`
    /// applied.
    ///
    /// # Errors
    /// When the run is not finished, or an assignment changes its model.
    pub fn extend(folder: &RunFolder, more: f64, assignments: &[String]) -> Result<Self> {
        let checkpoint = Checkpoint::read(&folder.checkpoint())?;
        let totals = checkpoint.state.totals;
        if progress(&checkpoint.config, &totals) < 1.0 {
            return Err(Error::input(
                folder.root().display(),
                format!(
                    "holds a run that is not finished ({:.0} %)",
                    100.0 * progress(&checkpoint.config, &totals)
                ),
                Advice::Argument("finish it first: leave {continue-for} out, and give the folder or configuration that the run was started with".into()),
            ));
        }
        let mut settings = crate::settings::defaults();
        settings.apply_file(&folder.config().display().to_string(), &checkpoint.config.to_toml())?;
        let findings = folder.findings()?.unwrap_or_default();
        for change in findings.iter().flat_map(|finding| &finding.changes) {
            let now = settings.value(&change.path);
            settings.decide(&change.path, &now)?;
        }
        assignments.iter().try_for_each(|set| settings.apply_assignment(set))?;
        let old = &checkpoint.config.train;
        // A run limited by steps gets as many more steps as fit into this time at its mean speed so far.
        let budget = match old.steps {
            0 => format!("train.seconds={:?}", old.seconds.max(totals.seconds) + more),
            steps => {
                let rate = totals.step as f64 / totals.seconds.max(f64::MIN_POSITIVE);
                format!("train.steps={}", steps + (rate * more).ceil().max(1.0) as u64)
            }
        };
        settings.apply_assignment(&budget)?;
        let config = Config::from_settings(&settings)?;
        let train = TrainConfig { steps: old.steps, seconds: old.seconds, ..config.train.clone() };
        let place = folder.checkpoint().display().to_string();
        checkpoint.expect_config(&place, &Config { train, ..config.clone() })?;
        let at = progress(&config, &totals);
        let extended = format!(
            "extended: continues for {} after {}; the schedule is stretched to the new length and is at {:.0} % of it: \
             learning rate {:.1e}, marching step {}",
            formatting::duration(more),
            formatting::duration(totals.seconds),
            100.0 * at,
            adamw::learning_rate(&config, at),
            config.renderer.step_scale.at(at)
        );
        Ok(Self { settings, findings, checkpoint: Some(checkpoint), extended: Some(extended) })
    }

    /// Returns the history of the folder's run if it is this run and complete: trained, evaluated, and with the views and the
    /// pictures of its evaluation.
    ///
    /// # Errors
    /// When the settings are invalid.
    pub fn finished(&self, folder: &RunFolder) -> Result<Option<History>> {
        let Some(checkpoint) = self.checkpoint.as_ref().filter(|_| self.extended.is_none()) else {
            return Ok(None);
        };
        let (config, totals) = (Config::from_settings(&self.settings)?, checkpoint.state.totals);
        let history = History::of(&super::history::up_to(folder.events(), totals.step));
        let done = progress(&config, &totals) >= 1.0 && folder.model().exists();
        let done = done && (history.last().is_none() || FileStore::is_whole(folder));
        Ok((done && evaluated(&config, &history, &totals)).then_some(history))
    }
}

/// Refuses a folder that contains a run of settings other than `given`, as a training into that folder would. Fast, because it reads no
/// checkpoint.
///
/// # Errors
/// When the folder contains another run, or the settings are invalid.
pub fn expect_same(given: &Settings, folder: &RunFolder) -> Result<()> {
    let text = plain_file::read_to_string(&folder.config());
    let Some(text) = text.ok().filter(|_| folder.checkpoint().exists()) else { return Ok(()) };
    let mut settings = given.clone();
    if let Some(findings) = folder.findings()? {
        scene_plan::adopt(&mut settings, &findings)?;
    }
    keep_extension(&mut settings, folder)?;
    let there = Config::from_toml(&folder.config().display().to_string(), &text)?;
    folder.expect_none(&Config::from_settings(&settings)?.differences(&there))
}

/// Keeps the budget of an earlier extension if the given budget is smaller. The settings with which the run began then still match it, and
/// the run counts as finished.
fn keep_extension(settings: &mut Settings, folder: &RunFolder) -> Result<()> {
    let extended = || folder.events().iter().any(|event| matches!(event, Event::Extended { .. }));
    let Ok(text) = plain_file::read_to_string(&folder.config()) else { return Ok(()) };
    if !extended() {
        return Ok(());
    }
    let kept = Config::from_toml(&folder.config().display().to_string(), &text)?.train;
    let given = Config::from_settings(settings)?.train;
    if given.steps > 0 && given.steps < kept.steps {
        settings.decide("train.steps", &kept.steps.to_string())?;
    } else if given.steps == 0 && kept.steps == 0 && given.seconds < kept.seconds {
        settings.decide("train.seconds", &format!("{:?}", kept.seconds))?;
    }
    Ok(())
}

/// Returns true if the history contains the final evaluation that the configuration requests.
fn evaluated(config: &Config, history: &History, totals: &Totals) -> bool {
    let bounded = config.eval.time_fraction > 0.0;
    let asked = |e: &Evaluation| e.bounded && bounded || config.eval.final_stride(e.frames) == Some(e.stride);
    config.eval.final_stride(1).is_none()
        || history.last().is_some_and(|e| e.totals.step == totals.step && asked(e))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::fixtures::evaluation;

    #[test]
    fn a_run_is_finished_when_the_evaluation_asked_for_is_there() {
        let mut config = Config::default();
        config.train.steps = 40;
        let totals = Totals { step: 40, ..Totals::default() };
        assert_eq!(progress(&config, &totals), 1.0);
        let history = History::of(&[evaluation(40, 1, true, 25.0)]);
        assert!(evaluated(&config, &history, &totals));
        assert!(!evaluated(&config, &History::default(), &totals));
        config.eval.r#final = trimip_core::config::FinalEval::Stride(2);
        assert!(!evaluated(&config, &history, &totals));
        config.eval.r#final = trimip_core::config::FinalEval::Flag(false);
        assert!(evaluated(&config, &History::default(), &totals));
    }
}
