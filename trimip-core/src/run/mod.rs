//! A training run: steps, evaluations, checkpoints and events, in order. It uses a session and a store, and is
//! independent of files, terminals and devices.

pub mod alignment;
pub mod evaluate;
mod evaluation;
mod timekeeper;

use crate::{
    Camera, Config, Error, ErrorKind, Frames, Result, Session,
    engine::{
        checkpoint::Checkpoint,
        events::{Event, EventSink, Totals, progress},
        poses::Refined,
        session::StepReport,
    },
    field::model::Model,
    measures::perception::Perception,
    run::{
        evaluate::{TestFrames, ViewResult},
        timekeeper::Timekeeper,
    },
};
use std::sync::atomic::{AtomicBool, Ordering};
use web_time::Instant;

/// A run that has kept no sample after this number of steps fails, because nothing will ever become visible.
const BLIND_STEPS: u64 = 64;

/// The place where a run stores its results.
pub trait Store {
    /// Stores the checkpoint; returns its size in bytes.
    ///
    /// # Errors
    /// When the checkpoint cannot be stored.
    fn checkpoint(&mut self, checkpoint: &Checkpoint) -> Result<u64>;
    /// Stores the model; returns its size in bytes.
    ///
    /// # Errors
    /// When the model cannot be stored.
    fn model(&mut self, model: &Model) -> Result<u64>;
    /// Stores names and cameras of the training photographs as refined by training; does nothing by default.
    ///
    /// # Errors
    /// When the cameras cannot be stored.
    fn cameras(&mut self, cameras: &[(String, Camera)]) -> Result<()> {
        let _ = cameras;
        Ok(())
    }
    /// Receives every view of the final evaluation.
    ///
    /// # Errors
    /// When the view cannot be stored.
    fn view(&mut self, view: &ViewResult<'_>) -> Result<()>;
    /// Called after all views of the final evaluation were received and before the event of its result, so that the
    /// views of an announced result are stored.
    ///
    /// # Errors
    /// When the views cannot be stored.
    fn evaluated(&mut self) -> Result<()>;
}

/// An observer of a run in progress.
pub trait Observer {
    /// Called between two steps. The time of the call does not count as training, so an observer pauses the run by
    /// waiting here. If it returns true, [`model`](Self::model) receives the current model, and this function is called
    /// again.
    fn between(&mut self, totals: &Totals) -> bool {
        let _ = totals;
        false
    }

    /// Receives the model.
    fn model(&mut self, model: Model) {
        drop(model);
    }
}

/// The absence of an observer.
impl Observer for () {}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The schedule is complete and the final evaluation is done.
    Finished,
    /// The run was asked to stop; its checkpoint is written.
    Stopped,
}

/// Everything a run works with.
pub struct Run<'a> {
    /// The settings.
    pub config: &'a Config,
    /// The model in training.
    pub session: &'a mut dyn Session,
    /// Test frames.
    pub frames: &'a dyn Frames,
    /// Computes the measures of perception in the final evaluation, for the views that `eval.perceptual_views` asks for.
    pub perception: &'a mut dyn Perception,
    /// Receives the results.
    pub store: &'a mut dyn Store,
    /// Receives the events.
    pub events: &'a mut dyn EventSink,
    /// Observes the model between steps.
    pub observer: &'a mut dyn Observer,
    /// Set by another thread to stop the run after the current step.
    pub stop: &'a AtomicBool,
    /// Counters at the last evaluation of an earlier part of the run; zero if there is none. The points of the curve
    /// between that evaluation and the beginning of this part were missed; one evaluation at the beginning replaces
    /// them.
    pub evaluated: Totals,
}

impl Run<'_> {
    /// Trains from `totals` (of a restored checkpoint, or zero) to the end of the schedule, then evaluates.
    ///
    /// # Errors
    /// When a step fails. The last good state is stored first.
    pub fn train(&mut self, totals: Totals) -> Result<Outcome> {
        self.train_until(totals, u64::MAX)
    }

    /// Trains as [`Run::train`] does, but stops after step `last_step` as if asked to, unless the schedule ends there.
    ///
    /// # Errors
    /// As [`Run::train`].
    pub fn train_until(&mut self, totals: Totals, last_step: u64) -> Result<Outcome> {
        let mut kept = (totals.step > 0).then_some(totals.step);
        let outcome = self.steps(totals, last_step, &mut kept);
        if let Err(error) = &outcome
            && error.kind() == ErrorKind::Device
        {
            // A failed device returns no state: only what was stored before remains.
            let message = match kept {
                Some(step) => format!("the device failed: the checkpoint of step {step} is kept, the same command resumes from it"),
                None => "the device failed before a checkpoint was written; train.checkpoint_seconds sets how often checkpoints are written".into(),
            };
            self.events.emit(&Event::Warning { message });
        }
        outcome
    }

    /// Does the work of [`Run::train_until`]; `kept` is the step of the last checkpoint.
    fn steps(&mut self, mut totals: Totals, last_step: u64, kept: &mut Option<u64>) -> Result<Outcome> {
        let mut points = evaluation_points(self.config.eval.points);
        points.retain(|&point| point > self.progress(&self.evaluated));
        let (mut saved, mut logged_totals) = (totals.seconds, totals);
        let mut keeper = Timekeeper::new(self.config.eval.time_fraction, self.config.eval.points);
        let mut told = self.tell(Vec::new());
        while self.progress(&totals) < 1.0 {
            if points.first().is_some_and(|&point| point <= self.progress(&totals)) {
                points.retain(|&point| point > self.progress(&totals));
                match self.evaluate_on_the_way(&totals, &mut keeper) {
                    Err(error) if error.kind() != ErrorKind::Device => {
                        return Err(self.save_after(error, &totals, kept));
                    }
                    evaluated => evaluated?,
                }
            }
            if self.stop.load(Ordering::Relaxed) || totals.step >= last_step {
                self.save(&totals, kept)?;
                self.events.emit(&Event::Stopped { totals });
                return Ok(Outcome::Stopped);
            }
            let started = Instant::now();
            let report = match self.session.step(self.progress(&totals)) {
                Ok(report) => report,
                Err(error) if error.kind() == ErrorKind::Device => return Err(error),
                Err(error) => return Err(self.save_after(error, &totals, kept)),
            };
            let seconds = started.elapsed().as_secs_f64();
            keeper.trained(seconds, report.totals.rays - totals.rays);
            totals = Totals { seconds: totals.seconds + seconds, ..report.totals };
            if totals.step >= BLIND_STEPS && totals.samples == 0 {
                return Err(self.save_after(blind(&totals), &totals, kept));
            }
            let done = self.progress(&totals) >= 1.0;
            if done || totals.seconds - logged_totals.seconds >= self.config.train.log_seconds {
                self.log(&report, &totals, &logged_totals, &keeper);
                logged_totals = totals;
                told = self.tell(told);
            }
            while self.observer.between(&totals) {
                let model = self.session.model()?;
                self.observer.model(model);
            }
            let every = self.config.train.checkpoint_seconds;
            if every > 0.0 && totals.seconds - saved >= every && !done {
                self.save_on_the_way(&totals, kept)?;
                saved = totals.seconds;
            }
        }
        let checkpoint = self.checkpoint(&totals, *kept)?;
        let stored = self.store(&checkpoint, kept);
        drop(checkpoint);
        // If the checkpoint could not be stored, the run can resume only from the previous checkpoint, but the model is
        // still written.
        let model = self.session.finish()?;
        self.store.model(&model).map_err(|error| stored.clone().err().unwrap_or(error))?;
        self.tell_poses()?;
        self.events.emit(&Event::finished(totals));
        let outcome = self.evaluate_at_the_end(&totals, &mut keeper);
        stored.and(outcome)
    }

    /// Stores refined cameras, aligns test views with the finished model, and emits the result.
    fn tell_poses(&mut self) -> Result<()> {
        let Some(Refined { cameras, intrinsics, moved }) = self.session.refined() else { return Ok(()) };
        self.store.cameras(&cameras)?;
        let test = TestFrames { frames: self.frames, data: &self.config.data, finest: 1 };
        let measured = self.config.eval.final_stride(self.frames.len()).is_some();
        let aligned = if measured { alignment::measure(self.session, test, &intrinsics)? } else { None };
        self.events.emit(&Event::Poses { moved, aligned });
        Ok(())
    }

    fn progress(&self, totals: &Totals) -> f64 {
        progress(self.config, totals)
    }

    /// Emits a warning for each setting that the device cannot honour and that is not yet in `told`. Returns the texts
    /// for all such settings.
    fn tell(&mut self, told: Vec<String>) -> Vec<String> {
        let notes = self.session.notes();
        for message in notes.iter().filter(|note| !told.contains(note)) {
            self.events.emit(&Event::Warning { message: message.clone() });
        }
        notes
    }

    fn log(&mut self, report: &StepReport, totals: &Totals, before: &Totals, keeper: &Timekeeper) {
        let seconds = (totals.seconds - before.seconds).max(1e-9);
        let progress = self.progress(totals).min(1.0);
        let per_progress = (totals.seconds - before.seconds) / (progress - self.progress(before)).max(1e-12);
        let views = self.frames.len().max(1);
        let part = views.div_ceil(self.config.eval.stride_of(views)) as f64 / views as f64;
        let measured = if self.config.eval.final_stride(views).is_some() {
            keeper.left(per_progress, self.pixels_of_a_view() * views as f64, part)
        } else {
            0.0
        };
        self.events.emit(&Event::Step {
            totals: *totals,
            progress,
            loss: report.loss,
            batch_psnr: report.batch_psnr,
            learning_rate: report.learning_rate,
            samples_per_second: (totals.samples - before.samples) as f64 / seconds,
            rays_per_second: (totals.rays - before.rays) as f64 / seconds,
            occupied: report.occupied,
            seconds_left: per_progress * (1.0 - progress) + measured,
        });
    }

    /// Stores a checkpoint and records its step.
    ///
    /// # Errors
    /// As [`checkpoint`](Self::checkpoint) and [`store`](Self::store).
    fn save(&mut self, totals: &Totals, kept: &mut Option<u64>) -> Result<()> {
        let checkpoint = self.checkpoint(totals, *kept)?;
        self.store(&checkpoint, kept)
    }

    /// Saves as [`save`](Self::save) does, but only warns if the checkpoint cannot be stored, because the disk may have
    /// room for the next one.
    fn save_on_the_way(&mut self, totals: &Totals, kept: &mut Option<u64>) -> Result<()> {
        let checkpoint = self.checkpoint(totals, *kept)?;
        if let Err(error) = self.store(&checkpoint, kept) {
            let step = totals.step;
            let message = format!(
                "no checkpoint of step {step}: {error}; training continues and tries again at the next checkpoint"
            );
            self.events.emit(&Event::Warning { message });
        }
        Ok(())
    }

    /// Creates the checkpoint of the current state.
    ///
    /// # Errors
    /// When a value in the checkpoint is not finite. The last good checkpoint, of step `kept`, is then not overwritten.
    fn checkpoint(&mut self, totals: &Totals, kept: Option<u64>) -> Result<Checkpoint> {
        let mut checkpoint = self.session.checkpoint()?;
        checkpoint.state.totals.seconds = totals.seconds;
        let step = checkpoint.state.totals.step;
        if let Some((name, index, value)) = checkpoint.not_finite() {
            return Err(Error::run(format!(
                "step {step}: {name}[{index}] is {value}, {}; lower optimizer.learning_rate",
                remaining(kept)
            )));
        }
        Ok(checkpoint)
    }

    /// Stores a checkpoint, and records its step in `kept`.
    ///
    /// # Errors
    /// When the checkpoint cannot be stored.
    fn store(&mut self, checkpoint: &Checkpoint, kept: &mut Option<u64>) -> Result<()> {
        let bytes = self.store.checkpoint(checkpoint)?;
        let step = checkpoint.state.totals.step;
        *kept = Some(step);
        self.events.emit(&Event::Checkpoint { step, bytes });
        Ok(())
    }

    /// Saves the state before a failed step, if it is usable; returns the error to report.
    fn save_after(&mut self, error: Error, totals: &Totals, kept: &mut Option<u64>) -> Error {
        match self.save(totals, kept) {
            Ok(()) => error,
            // Saving returned the same error: the session only has the state of the failed step.
            Err(unsaved) if unsaved.message() == error.message() => error.with_note(remaining(*kept)),
            Err(unsaved) => error.with_note(unsaved),
        }
    }
}

/// Describes the last good state: the checkpoint of step `kept`.
fn remaining(kept: Option<u64>) -> String {
    kept.map_or("no checkpoint was written before".into(), |step| {
        format!("the checkpoint of step {step} is kept")
    })
}

/// Returns the error of a run whose rays hit nothing.
fn blind(totals: &Totals) -> Error {
    Error::run(format!(
        "{} steps of {} rays kept no sample: no ray hits anything in the box from scene.aabb_min to scene.aabb_max; set them to \
         where the subject is (trimip-cli data inspect shows where the cameras are)",
        totals.step, totals.rays
    ))
}

/// Returns the progress values at which a run is evaluated: `count` points, evenly spaced in the logarithm, from 1/32
/// (excluded) to 1.
pub fn evaluation_points(count: u32) -> Vec<f64> {
    (0..count).map(|i| 32_f64.powf(f64::from(i + 1) / f64::from(count) - 1.0)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn evaluation_points_rise_to_the_end() {
        let points = evaluation_points(5);
        assert!(points.is_sorted() && points[4] == 1.0 && (points[0] - 1.0 / 16.0).abs() < 1e-12);
        assert!(evaluation_points(0).is_empty());
    }
}
