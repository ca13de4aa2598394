//! The event stream of a run, the only source of progress bars, logs, CSV files and reports.

use crate::Config;
use crate::engine::poses::{Aligned, Moved};
use crate::measures::quality::{ScaleQuality, float_or_null};
use serde::{Deserialize, Serialize};

/// Counters of a run; they continue after a resume.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Totals {
    /// Optimiser steps done.
    pub step: u64,
    /// Seconds of training, without those of evaluation and of rendering pictures.
    pub seconds: f64,
    /// Kept samples, summed over steps.
    pub samples: u64,
    /// Samples marched, whose density was evaluated; summed over steps.
    pub marched: u64,
    /// Rays, one per pixel, summed over steps.
    pub rays: u64,
    /// Steps whose batch kept no sample.
    pub empty_batches: u64,
    /// Number of non-finite values found in losses or gradients.
    pub non_finite: u64,
    /// Kept samples without a backward pass, summed over steps (`train.backward_fraction`).
    #[serde(default)]
    pub left_out: u64,
}

impl Totals {
    /// Returns the mean number of kept samples per ray; `None` before the first ray.
    pub fn samples_per_ray(&self) -> Option<f64> {
        (self.rays > 0).then(|| self.samples as f64 / self.rays as f64)
    }

    /// Returns the fraction of the kept samples that had a backward pass; `None` before the first sample.
    pub fn backward_fraction(&self) -> Option<f64> {
        (self.samples > 0).then(|| self.samples.saturating_sub(self.left_out) as f64 / self.samples as f64)
    }

    /// Returns the number of rays per second of training; `None` before any time has passed.
    pub fn rays_per_second(&self) -> Option<f64> {
        (self.seconds > 0.0).then(|| self.rays as f64 / self.seconds)
    }
}

/// Origin of the part of a run that one process executed. Values that older versions did not record are `None`.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Provenance {
    /// The command line; the program appears without its path.
    pub command: Option<String>,
    /// Version of the program, with its commit if known.
    pub version: Option<String>,
    /// End of the part: seconds since 1970-01-01, UTC.
    pub ended_unix: Option<u64>,
    /// Number of views of the test split, evaluated or not.
    pub test_views: Option<usize>,
}

/// An event. Serialised with a `kind` field, one JSON object per line of `metrics.jsonl`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
#[non_exhaustive]
pub enum Event {
    /// Overview of a run, before it starts.
    Plan {
        /// The overview, line by line.
        lines: Vec<String>,
        /// The overview in a few short lines.
        #[serde(default)]
        summary: Vec<String>,
        /// Predicted peak memory.
        memory_bytes: u64,
    },
    /// Training continues from a checkpoint.
    Resumed {
        /// Counters of the run at this point.
        totals: Totals,
    },
    /// A finished run continues with a larger budget.
    Extended {
        /// Counters of the run at this point.
        totals: Totals,
        /// One line: the budget before and after, and the effect on the schedule.
        message: String,
    },
    /// Steps were done since the last event of this kind.
    Step {
        /// Counters of the run at this point.
        totals: Totals,
        /// Fraction of the run that is done, 0 to 1.
        progress: f64,
        /// Mean loss of the latest step.
        #[serde(deserialize_with = "float_or_null")]
        loss: f64,
        /// PSNR of the pixels of the latest step, over all scales, in dB.
        #[serde(deserialize_with = "float_or_null")]
        batch_psnr: f64,
        /// Learning rate of the networks.
        learning_rate: f64,
        /// Kept samples per second since the last event.
        #[serde(deserialize_with = "float_or_null")]
        samples_per_second: f64,
        /// Rays per second since the last event.
        #[serde(deserialize_with = "float_or_null")]
        rays_per_second: f64,
        /// Fraction of the occupancy grid's cells that are occupied.
        #[serde(deserialize_with = "float_or_null")]
        occupied: f64,
        /// Estimated seconds of training and evaluation that remain.
        #[serde(deserialize_with = "float_or_null")]
        seconds_left: f64,
    },
    /// The model was evaluated.
    Evaluation {
        /// Counters of the run at this point.
        totals: Totals,
        /// Stride: every `stride`-th test view was used.
        stride: usize,
        /// Number of test views; 0 in events of earlier versions.
        #[serde(default)]
        frames: usize,
        /// True if `eval.time_fraction` left no time for all requested views or scales.
        #[serde(default)]
        bounded: bool,
        /// True for the evaluation that ends the run.
        last: bool,
        /// Quality per scale, fine to coarse.
        scales: Vec<ScaleQuality>,
        /// Mean of the scales' PSNR.
        #[serde(deserialize_with = "float_or_null")]
        psnr: f64,
        /// Mean of the scales' SSIM.
        #[serde(deserialize_with = "float_or_null")]
        ssim: f64,
        /// Seconds the evaluation took.
        seconds: f64,
    },
    /// Progress within an evaluation.
    EvaluationProgress {
        /// Number of finished views.
        done: usize,
        /// Number of views of this evaluation, as far as known.
        total: usize,
        /// Fraction of the current view that is rendered, 0 to 1.
        #[serde(default)]
        part: f64,
    },
    /// Training has refined the poses of its photographs.
    Poses {
        /// How far the refined poses are from the given ones.
        moved: Moved,
        /// Alignment of the test views' poses; `None` without a final evaluation.
        aligned: Option<Aligned>,
    },
    /// A checkpoint was written.
    Checkpoint {
        /// Step of the checkpoint.
        step: u64,
        /// Size of the checkpoint file.
        bytes: u64,
    },
    /// A message for the user; the run continues.
    Warning {
        /// One line.
        message: String,
    },
    /// The run stopped on request.
    Stopped {
        /// Counters of the run at this point.
        totals: Totals,
    },
    /// Training is over.
    Finished {
        /// Counters at the end.
        totals: Totals,
        /// Mean number of kept samples per ray over the whole run; `None` without rays, and in events of earlier
        /// versions.
        #[serde(default)]
        samples_per_ray: Option<f64>,
        /// Rays per second of training over the whole run.
        #[serde(default)]
        rays_per_second: Option<f64>,
        /// Fraction of the kept samples that had a backward pass over the whole run.
        #[serde(default)]
        backward_fraction: Option<f64>,
    },
    /// One process's part of a run is over, whatever its outcome.
    SessionEnded {
        /// Name of the device that the backend used.
        #[serde(default)]
        device: String,
        /// Backend of this part.
        backend: String,
        /// Seconds since the program started, everything included.
        wall_seconds: f64,
        /// Peak resident memory of the process, if the system reports it.
        peak_memory_bytes: Option<u64>,
        /// Command and version of the process.
        #[serde(default)]
        provenance: Provenance,
    },
}

impl Event {
    /// Returns the event for the end of a training run with these counters.
    pub fn finished(totals: Totals) -> Self {
        Self::Finished {
            totals,
            samples_per_ray: totals.samples_per_ray(),
            rays_per_second: totals.rays_per_second(),
            backward_fraction: totals.backward_fraction(),
        }
    }
}

/// A receiver of all events, in order.
pub trait EventSink {
    /// Receives one event.
    fn emit(&mut self, event: &Event);
}

impl<F: FnMut(&Event)> EventSink for F {
    fn emit(&mut self, event: &Event) {
        self(event);
    }
}

/// Returns the fraction of the schedule that is done at `totals`; 1 or more at the end of the schedule.
pub fn progress(config: &Config, totals: &Totals) -> f64 {
    let train = &config.train;
    if train.steps > 0 { totals.step as f64 / train.steps as f64 } else { totals.seconds / train.seconds }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::measures::quality::Measures;

    #[test]
    fn an_event_with_a_value_that_json_cannot_hold_is_read_back() {
        let scales = vec![ScaleQuality {
            scale: 1,
            images: 1,
            perceptual_images: 0,
            measures: Measures { psnr: f64::INFINITY, ssim: 1.0, ..Measures::UNKNOWN },
        }];
        let event = Event::Evaluation {
            totals: Totals::default(),
            stride: 1,
            frames: 1,
            bounded: false,
            last: true,
            scales,
            psnr: f64::INFINITY,
            ssim: 1.0,
            seconds: 0.5,
        };
        let text = serde_json::to_string(&event).unwrap();
        let Event::Evaluation { psnr, scales, ssim, .. } = serde_json::from_str(&text).unwrap() else {
            panic!("another kind: {text}");
        };
        assert!(psnr.is_nan() && scales[0].measures.psnr.is_nan() && ssim == 1.0);
    }
}
