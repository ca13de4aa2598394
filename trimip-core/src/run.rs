//! A training run: steps, evaluations, checkpoints and events in their order. Knows a session and a place to store
//! things, nothing of files, terminals or devices.

use crate::{
    Config, Error, ErrorKind, Frames, Result, Session,
    checkpoint::Checkpoint,
    evaluate::{MeanQuality, ViewQuality, ViewResult, evaluate, mean_quality, per_scale},
    events::{Event, EventSink, Totals},
    model::Model,
    session::StepReport,
};
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

/// Where a run keeps its results.
pub trait Store {
    /// Keeps the checkpoint; returns its size in bytes.
    fn checkpoint(&mut self, checkpoint: &Checkpoint) -> Result<u64>;
    /// Keeps the model; returns its size in bytes.
    fn model(&mut self, model: &Model) -> Result<u64>;
    /// Sees every view of the final evaluation.
    fn view(&mut self, view: &ViewResult<'_>) -> Result<()>;
}

/// How a run ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Outcome {
    /// The schedule is done and the final evaluation made.
    Finished,
    /// It was asked to stop; the checkpoint is written.
    Stopped,
}

/// What a run works with.
pub struct Run<'a> {
    /// The settings.
    pub config: &'a Config,
    /// The model in training.
    pub session: &'a mut dyn Session,
    /// Test frames.
    pub frames: &'a dyn Frames,
    /// Where results go.
    pub store: &'a mut dyn Store,
    /// Where events go.
    pub events: &'a mut dyn EventSink,
    /// Set from outside to stop after the current step.
    pub stop: &'a AtomicBool,
}

impl Run<'_> {
    /// Trains from `totals` (those of a restored checkpoint, or zero) to the end of the schedule, then evaluates.
    ///
    /// # Errors
    /// When a step fails: the last good state is stored first.
    pub fn train(&mut self, totals: Totals) -> Result<Outcome> {
        self.train_until(totals, u64::MAX)
    }

    /// As [`Run::train`], but stops as if it were asked to once step `last_step` is done and the schedule is not.
    ///
    /// # Errors
    /// As [`Run::train`].
    pub fn train_until(&mut self, totals: Totals, last_step: u64) -> Result<Outcome> {
        let mut kept = (totals.step > 0).then_some(totals.step);
        let outcome = self.steps(totals, last_step, &mut kept);
        if let Err(error) = &outcome
            && error.kind == ErrorKind::Device
        {
            // A device that failed gives nothing back: what was stored before is what there is.
            let message = match kept {
                Some(step) => format!("the device failed: the checkpoint of step {step} is kept, the same command goes on from it"),
                None => "the device failed before a checkpoint was written; train.checkpoint_seconds says how often".into(),
            };
            self.events.emit(&Event::Warning { message });
        }
        outcome
    }

    /// As [`Run::train_until`]; `kept` is the step of the last checkpoint.
    fn steps(&mut self, mut totals: Totals, last_step: u64, kept: &mut Option<u64>) -> Result<Outcome> {
        let mut points = evaluation_points(self.config.eval.points);
        points.retain(|&point| point > self.progress(&totals));
        let (mut saved, mut logged_totals) = (totals.seconds, totals);
        let mut told = self.tell(Vec::new());
        while self.progress(&totals) < 1.0 {
            if self.stop.load(Ordering::Relaxed) || totals.step >= last_step {
                self.save(&totals, kept)?;
                self.events.emit(&Event::Stopped { totals });
                return Ok(Outcome::Stopped);
            }
            let started = Instant::now();
            let report = match self.session.step(self.progress(&totals)) {
                Ok(report) => report,
                Err(error) if error.kind == ErrorKind::Device => return Err(error),
                Err(error) => return Err(self.save_after(error, &totals, kept)),
            };
            totals = Totals { seconds: totals.seconds + started.elapsed().as_secs_f64(), ..report.totals };
            let done = self.progress(&totals) >= 1.0;
            if done || totals.seconds - logged_totals.seconds >= self.config.train.log_seconds {
                self.log(&report, &totals, &logged_totals);
                logged_totals = totals;
                told = self.tell(told);
            }
            let every = self.config.train.checkpoint_seconds;
            if every > 0.0 && totals.seconds - saved >= every && !done {
                self.save(&totals, kept)?;
                saved = totals.seconds;
            }
            if points.first().is_some_and(|&point| point <= self.progress(&totals)) && !done {
                points.retain(|&point| point > self.progress(&totals));
                match self.evaluate_on_the_way(&totals) {
                    Err(error) if error.kind != ErrorKind::Device => {
                        return Err(self.save_after(error, &totals, kept));
                    }
                    evaluated => {
                        evaluated?;
                    }
                }
            }
        }
        self.save(&totals, kept)?;
        let model = self.session.finish()?;
        self.store.model(&model)?;
        self.events.emit(&Event::Finished { totals });
        self.evaluate_at_the_end(&totals)
    }

    fn progress(&self, totals: &Totals) -> f64 {
        progress(self.config, totals)
    }

    /// Tells what the device takes otherwise than the settings read, once it is known; returns all that was told.
    fn tell(&mut self, told: Vec<String>) -> Vec<String> {
        let notes = self.session.notes();
        for message in notes.iter().filter(|note| !told.contains(note)) {
            self.events.emit(&Event::Warning { message: message.clone() });
        }
        notes
    }

    fn log(&mut self, report: &StepReport, totals: &Totals, before: &Totals) {
        let seconds = (totals.seconds - before.seconds).max(1e-9);
        let progress = self.progress(totals).min(1.0);
        let per_progress = (totals.seconds - before.seconds) / (progress - self.progress(before)).max(1e-12);
        self.events.emit(&Event::Step {
            totals: *totals,
            progress,
            loss: report.loss,
            batch_psnr: report.batch_psnr,
            learning_rate: report.learning_rate,
            samples_per_second: (totals.samples - before.samples) as f64 / seconds,
            rays_per_second: (totals.rays - before.rays) as f64 / seconds,
            occupied: report.occupied,
            seconds_left: per_progress * (1.0 - progress),
        });
    }

    /// Stores a checkpoint, and remembers its step.
    ///
    /// # Errors
    /// When a number of it is not finite: the last good one is not overwritten.
    fn save(&mut self, totals: &Totals, kept: &mut Option<u64>) -> Result<()> {
        let mut checkpoint = self.session.checkpoint()?;
        checkpoint.state.totals.seconds = totals.seconds;
        let step = checkpoint.state.totals.step;
        if let Some((name, index, value)) = checkpoint.not_finite() {
            let kept = kept.map_or("no checkpoint was written before".into(), |step| {
                format!("the checkpoint of step {step} is kept")
            });
            return Err(Error::run(format!(
                "step {step}: {name}[{index}] is {value}, {kept}; lower optimizer.learning_rate"
            )));
        }
        let bytes = self.store.checkpoint(&checkpoint)?;
        *kept = Some(step);
        self.events.emit(&Event::Checkpoint { step, bytes });
        Ok(())
    }

    /// Saves the state before a step that failed, if it is one to go on from; returns what the user must see.
    fn save_after(&mut self, error: Error, totals: &Totals, kept: &mut Option<u64>) -> Error {
        match self.save(totals, kept) {
            Ok(()) => error,
            Err(unsaved) => Error { message: format!("{}; {}", error.message, unsaved.message), ..error },
        }
    }

    /// Tells nothing when the run was asked to stop meanwhile.
    fn evaluate_on_the_way(&mut self, totals: &Totals) -> Result<()> {
        let started = Instant::now();
        let stride = self.config.eval.stride as usize;
        let (qualities, whole) = self.views(stride, false)?;
        if whole && !qualities.is_empty() {
            self.report(&qualities, stride, totals, false, started);
        }
        Ok(())
    }

    fn evaluate_at_the_end(&mut self, totals: &Totals) -> Result<Outcome> {
        let Some(stride) = self.config.eval.final_stride() else {
            return Ok(Outcome::Finished);
        };
        let started = Instant::now();
        let (qualities, whole) = self.views(stride, true)?;
        if !whole {
            self.events.emit(&Event::Stopped { totals: *totals });
            return Ok(Outcome::Stopped);
        }
        if qualities.is_empty() {
            return Ok(Outcome::Finished);
        }
        // The curve's last point is taken on the same views as its other points.
        let curve = self.config.eval.stride as usize;
        if self.config.eval.points > 0 && curve != stride && curve.is_multiple_of(stride) {
            self.report(&qualities, curve, totals, false, started);
        }
        let psnr = self.report(&qualities, stride, totals, true, started);
        let floor = self.config.eval.min_psnr;
        // A NaN misses every floor.
        if floor > 0.0 && (psnr.is_nan() || psnr < floor) {
            return Err(Error::run(format!(
                "mean PSNR {psnr:.2} dB is below the floor eval.min_psnr = {floor}; the model and the report are written"
            )));
        }
        Ok(Outcome::Finished)
    }

    fn views(&mut self, stride: usize, last: bool) -> Result<(Vec<ViewQuality>, bool)> {
        let (stop, store, events) = (self.stop, &mut *self.store, &mut *self.events);
        let total = self.frames.len().div_ceil(stride);
        let (mut seen, mut whole) = (None, true);
        let mut done = 0;
        let background = self.config.data.background;
        let qualities = evaluate(self.session, self.frames, stride, background, |view| {
            if seen != Some(view.index) {
                seen = Some(view.index);
                events.emit(&Event::EvaluationProgress { done, total });
                done += 1;
            }
            if last {
                store.view(view)?;
            }
            whole = !stop.load(Ordering::Relaxed);
            Ok(whole)
        })?;
        Ok((qualities, whole))
    }

    fn report(
        &mut self,
        views: &[ViewQuality],
        stride: usize,
        totals: &Totals,
        last: bool,
        started: Instant,
    ) -> f64 {
        let scales = per_scale(views, stride);
        let MeanQuality { psnr, ssim, .. } = mean_quality(&scales);
        let seconds = started.elapsed().as_secs_f64();
        self.events.emit(&Event::Evaluation { totals: *totals, stride, last, scales, psnr, ssim, seconds });
        psnr
    }
}

/// Fraction of the schedule done at `totals`; 1 or more at its end.
pub fn progress(config: &Config, totals: &Totals) -> f64 {
    let train = &config.train;
    if train.seconds > 0.0 { totals.seconds / train.seconds } else { totals.step as f64 / train.steps as f64 }
}

/// Progress at which a run is evaluated: `count` points evenly spaced in the logarithm, from 1/32 (left out) to 1.
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
