//! The state accumulated from a run's events: the curve of error against time, the final metrics, warnings, counters.
//! Built from the event stream and, on resume, from `metrics.jsonl`. The report has no other source.

use trimip_core::engine::events::{Event, Provenance, Totals};
use trimip_core::engine::poses::{Aligned, Moved};
use trimip_core::measures::quality::ScaleQuality;

/// One evaluation.
#[derive(Clone, Debug, PartialEq)]
pub struct Evaluation {
    /// Counters at the time of the evaluation.
    pub totals: Totals,
    /// Stride of the evaluation: every n-th test view was used.
    pub stride: usize,
    /// Number of test views; 0 if unknown.
    pub frames: usize,
    /// True if time ran out before all requested views and scales were evaluated.
    pub bounded: bool,
    /// True for the evaluation that ends the run.
    pub last: bool,
    /// Per scale, fine to coarse.
    pub scales: Vec<ScaleQuality>,
    /// Mean of the scales' PSNR, dB.
    pub psnr: f64,
    /// Mean of the scales' SSIM.
    pub ssim: f64,
    /// Duration of the evaluation, seconds.
    pub seconds: f64,
}

impl Evaluation {
    /// Returns the number of test views that were evaluated, each at all of its scales.
    pub fn views(&self) -> usize {
        self.scales.iter().map(|quality| quality.images).max().unwrap_or(0)
    }
}

/// One process's share of the run.
#[derive(Clone, Debug, PartialEq)]
pub struct SessionPart {
    /// Backend.
    pub backend: String,
    /// Device of the backend.
    pub device: String,
    /// Seconds since the program's start, everything included.
    pub wall_seconds: f64,
    /// Peak resident memory in bytes, if known.
    pub peak_memory_bytes: Option<u64>,
    /// Command line, version, date.
    pub provenance: Provenance,
}

/// Latest training figures.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Training {
    /// Mean loss of the latest step.
    pub loss: f64,
    /// Share of occupied cells.
    pub occupied: f64,
    /// Samples marched per ray since the previous event; 0 if no ray was cast.
    pub marched_per_ray: f64,
    /// Samples kept per ray since the previous event.
    pub kept_per_ray: f64,
}

/// The history of a run, the source of its report.
#[derive(Clone, Debug, Default)]
pub struct History {
    /// Evaluations in step order, one per step and stride.
    pub evaluations: Vec<Evaluation>,
    /// Warnings, one line each, without duplicates.
    pub warnings: Vec<String>,
    /// Processes that worked on the run, in order.
    pub parts: Vec<SessionPart>,
    /// Latest counters.
    pub totals: Totals,
    /// Latest training figures.
    pub training: Training,
    /// How far refined poses have moved from the given ones, and how the test views were aligned with the model.
    pub poses: Option<(Moved, Option<Aligned>)>,
    /// True after the last step of the schedule.
    pub finished: bool,
    /// Predicted peak memory of the latest plan, bytes.
    pub predicted_memory_bytes: Option<u64>,
    /// Counters of the latest step event; rates are differences from these.
    logged: Totals,
}

impl History {
    /// Builds the history from events read from a file.
    pub fn of(events: &[Event]) -> Self {
        let mut history = Self::default();
        events.iter().for_each(|event| history.take(event));
        history
    }

    /// Adds the next event.
    pub fn take(&mut self, event: &Event) {
        if let Some(totals) = totals(event) {
            self.totals = *totals;
        }
        match event {
            Event::Plan { memory_bytes, .. } => self.predicted_memory_bytes = Some(*memory_bytes),
            Event::Resumed { totals } => self.logged = *totals,
            Event::Step { totals, loss, occupied, .. } => {
                let rays = totals.rays.saturating_sub(self.logged.rays).max(1) as f64;
                self.training = Training {
                    loss: *loss,
                    occupied: *occupied,
                    marched_per_ray: totals.marched.saturating_sub(self.logged.marched) as f64 / rays,
                    kept_per_ray: totals.samples.saturating_sub(self.logged.samples) as f64 / rays,
                };
                self.logged = *totals;
            }
            Event::Evaluation { totals, stride, frames, bounded, last, scales, psnr, ssim, seconds } => {
                // A step that is evaluated again after a resume replaces its earlier evaluation.
                self.evaluations.retain(|other| {
                    (other.totals.step, other.stride) != (totals.step, *stride) && !(*last && other.last)
                });
                self.evaluations.push(Evaluation {
                    totals: *totals,
                    stride: *stride,
                    frames: *frames,
                    bounded: *bounded,
                    last: *last,
                    scales: scales.clone(),
                    psnr: *psnr,
                    ssim: *ssim,
                    seconds: *seconds,
                });
            }
            Event::Warning { message } if !self.warnings.contains(message) => {
                self.warnings.push(message.clone());
            }
            Event::Poses { moved, aligned } => self.poses = Some((*moved, *aligned)),
            Event::Finished { .. } => self.finished = true,
            Event::Extended { .. } => {
                self.finished = false;
                self.evaluations.iter_mut().for_each(|evaluation| evaluation.last = false);
            }
            Event::SessionEnded { backend, device, wall_seconds, peak_memory_bytes, provenance } => {
                self.parts.push(SessionPart {
                    backend: backend.clone(),
                    device: device.clone(),
                    wall_seconds: *wall_seconds,
                    peak_memory_bytes: *peak_memory_bytes,
                    provenance: provenance.clone(),
                });
            }
            _ => {}
        }
    }

    /// Returns the evaluation at the end of the run.
    pub fn last(&self) -> Option<&Evaluation> {
        self.evaluations.iter().find(|evaluation| evaluation.last)
    }

    /// Returns the final evaluation, or else the latest one.
    pub fn best_known(&self) -> Option<&Evaluation> {
        self.last().or(self.evaluations.last())
    }

    /// Returns the counters at the last step that was evaluated; zero if none was.
    pub fn last_evaluated(&self) -> Totals {
        let totals = self.evaluations.iter().map(|evaluation| evaluation.totals);
        totals.max_by_key(|totals| totals.step).unwrap_or_default()
    }

    /// Returns the evaluations that are drawn as one line, in step order: the largest group with the same test views and scales.
    pub fn curve(&self) -> Vec<&Evaluation> {
        let views = |e: &Evaluation| (e.stride, e.scales.first().map_or(0, |scale| scale.scale));
        let alike = |e: &Evaluation| self.evaluations.iter().filter(|other| views(other) == views(e)).count();
        // On a tie, the finer group wins; it has the smaller key.
        let Some(best) =
            self.evaluations.iter().max_by_key(|e| (alike(e), std::cmp::Reverse(views(e)))).map(views)
        else {
            return Vec::new();
        };
        let mut curve: Vec<_> = self.evaluations.iter().filter(|e| views(e) == best).collect();
        curve.sort_by_key(|evaluation| evaluation.totals.step);
        curve
    }

    /// Returns the backends and devices that worked on the run, without duplicates.
    pub fn devices(&self) -> Vec<String> {
        let mut devices: Vec<String> = Vec::new();
        for part in self.parts.iter().filter(|part| !part.device.is_empty()) {
            let device = format!("{}: {}", part.backend, part.device);
            if !devices.contains(&device) {
                devices.push(device);
            }
        }
        devices
    }

    /// Returns the number of views in the test split, evaluated or not, if a part recorded it.
    pub fn test_views(&self) -> Option<usize> {
        self.parts.iter().rev().find_map(|part| part.provenance.test_views)
    }

    /// Returns the peak resident memory over all parts in bytes, if known.
    pub fn peak_memory_bytes(&self) -> Option<u64> {
        self.parts.iter().filter_map(|part| part.peak_memory_bytes).max()
    }

    /// Returns the total time of evaluations in seconds. Two evaluations at the same step share one rendering.
    pub fn evaluation_seconds(&self) -> f64 {
        let mut steps: Vec<(u64, f64)> = Vec::new();
        for evaluation in &self.evaluations {
            match steps.iter_mut().find(|(step, _)| *step == evaluation.totals.step) {
                Some((_, seconds)) => *seconds = seconds.max(evaluation.seconds),
                None => steps.push((evaluation.totals.step, evaluation.seconds)),
            }
        }
        steps.iter().map(|(_, seconds)| seconds).sum()
    }
}

/// Returns the counters of an event.
pub fn totals(event: &Event) -> Option<&Totals> {
    match event {
        Event::Resumed { totals }
        | Event::Extended { totals, .. }
        | Event::Step { totals, .. }
        | Event::Evaluation { totals, .. }
        | Event::Stopped { totals }
        | Event::Finished { totals, .. } => Some(totals),
        _ => None,
    }
}

/// Returns the events up to `step`, which a run that resumes there keeps. The run repeats later steps, so their events would be duplicates.
pub fn up_to(events: Vec<Event>, step: u64) -> Vec<Event> {
    events.into_iter().filter(|event| totals(event).is_none_or(|totals| totals.step <= step)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::fixtures::{evaluation, step};

    #[test]
    fn a_resumed_run_keeps_its_curve_and_repeats_nothing() {
        let before = vec![
            evaluation(10, 5, false, 20.0),
            Event::Warning { message: "dark".into() },
            evaluation(30, 5, false, 24.0),
        ];
        let kept = up_to(before, 20);
        assert_eq!(kept.len(), 2);
        let mut history = History::of(&kept);
        for event in [
            Event::Warning { message: "dark".into() },
            evaluation(30, 5, false, 24.5),
            evaluation(40, 5, false, 26.0),
            evaluation(40, 1, true, 25.0),
        ] {
            history.take(&event);
        }
        let steps: Vec<_> = history.curve().iter().map(|e| (e.totals.step, e.psnr)).collect();
        assert_eq!(steps, [(10, 20.0), (30, 24.5), (40, 26.0)]);
        assert_eq!(history.warnings, ["dark"]);
        assert_eq!(history.last().unwrap().psnr, 25.0);
        assert_eq!(history.evaluation_seconds(), 6.0);
    }

    #[test]
    fn samples_per_ray_are_those_since_the_event_before() {
        let mut history = History::of(&[step(1, 10, 1000, 900), step(2, 20, 1400, 1000)]);
        assert_eq!((history.training.marched_per_ray, history.training.kept_per_ray), (40.0, 10.0));
        let totals = Totals { step: 2, rays: 20, marched: 1400, samples: 1000, ..Totals::default() };
        history.take(&Event::Resumed { totals });
        history.take(&step(3, 20, 1400, 1000));
        assert_eq!(history.training.marched_per_ray, 0.0);
    }

    #[test]
    fn a_run_that_is_extended_is_not_finished() {
        let finished = Event::finished(Totals { step: 40, ..Totals::default() });
        let mut history = History::of(&[evaluation(40, 1, true, 25.0), finished]);
        assert!(history.finished && history.last().is_some());
        let totals = history.totals;
        history.take(&Event::Extended { totals, message: String::new() });
        assert!(!history.finished && history.last().is_none() && history.evaluations.len() == 1);
    }

    #[test]
    fn the_final_evaluation_done_again_replaces_the_first() {
        let history = History::of(&[evaluation(40, 1, true, 25.0), evaluation(40, 2, true, 26.0)]);
        assert_eq!(history.evaluations.len(), 1);
        assert_eq!(history.last().unwrap().stride, 2);
    }
}
