//! The event stream of a run, the only source of progress bars, logs, CSV files and reports.

use serde::{Deserialize, Deserializer, Serialize};

/// Floats for JSON: infinite and NaN values are written as `null` and read back as NaN.
fn float_or_null<'de, D: Deserializer<'de>>(deserializer: D) -> Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

/// A value that was not measured.
fn unknown() -> f64 {
    f64::NAN
}

/// PSNR and SSIM of one scale, means over its images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScaleQuality {
    /// Reduction of the images: 1, 2, 4, 8.
    pub scale: u32,
    /// Number of images.
    pub images: usize,
    /// Mean over the images of −10·log10(mean squared error), dB, on [0, 1] values that were not rounded.
    #[serde(deserialize_with = "float_or_null")]
    pub psnr: f64,
    /// The same on colours rounded to 8 bits.
    #[serde(default = "unknown", deserialize_with = "float_or_null")]
    pub psnr_8bit: f64,
    /// The same for unrounded colours on the opposite background; transparency lowers it.
    #[serde(default = "unknown", deserialize_with = "float_or_null")]
    pub psnr_opposite: f64,
    /// PSNR of each photograph's mean colour, from the mean of their errors: the level of a model that learned nothing.
    #[serde(default = "unknown", deserialize_with = "float_or_null")]
    pub psnr_constant: f64,
    /// Mean over the images of the structural similarity.
    #[serde(deserialize_with = "float_or_null")]
    pub ssim: f64,
}

/// Counters of a run; they continue after a resume.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Totals {
    /// Optimiser steps done.
    pub step: u64,
    /// Seconds of training, evaluation and pictures excluded.
    pub seconds: f64,
    /// Kept samples, summed over steps.
    pub samples: u64,
    /// Samples marched and asked for density, summed over steps.
    pub marched: u64,
    /// Rays, summed over steps.
    pub rays: u64,
    /// Steps whose batch kept no sample.
    pub empty_batches: u64,
    /// Non-finite values met in losses or gradients.
    pub non_finite: u64,
}

/// Origin of the part of a run that one process did; `None` for values that older versions did not record.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct Provenance {
    /// The command line, with the program by its name alone.
    pub command: Option<String>,
    /// Version of the program, with its commit where that is known.
    pub version: Option<String>,
    /// When it ended: seconds since the beginning of 1970, UTC.
    pub ended_unix: Option<u64>,
    /// Views of the test split, evaluated or not.
    pub test_views: Option<usize>,
}

/// An event. Serialised with a `kind` field, one JSON object a line in `metrics.jsonl`.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(tag = "kind", rename_all = "snake_case")]
pub enum Event {
    /// The overview of a run, before it starts.
    Plan {
        /// One line each.
        lines: Vec<String>,
        /// Predicted peak memory.
        memory_bytes: u64,
    },
    /// Training continues from a checkpoint.
    Resumed {
        /// Where it stands.
        totals: Totals,
    },
    /// A finished run continues with a longer budget.
    Extended {
        /// Where it stands.
        totals: Totals,
        /// One line: the budget before and after, and what the schedule does.
        message: String,
    },
    /// Steps done since the last such event.
    Step {
        /// Where the run stands.
        totals: Totals,
        /// Fraction of the run done, 0 to 1.
        progress: f64,
        /// Mean loss of the latest step.
        #[serde(deserialize_with = "float_or_null")]
        loss: f64,
        /// PSNR of the latest step's own pixels, dB (of all scales together).
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
        /// Share of occupied cells.
        #[serde(deserialize_with = "float_or_null")]
        occupied: f64,
        /// Seconds of training and evaluation left, estimated.
        #[serde(deserialize_with = "float_or_null")]
        seconds_left: f64,
    },
    /// The model was evaluated.
    Evaluation {
        /// Where the run stands.
        totals: Totals,
        /// Every n-th test view was used.
        stride: usize,
        /// Number of test views; 0 in events of earlier versions.
        #[serde(default)]
        frames: usize,
        /// True if `eval.share` left no time for all requested views or scales.
        #[serde(default)]
        bounded: bool,
        /// True for the evaluation that ends the run.
        last: bool,
        /// Per scale, fine to coarse.
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
        /// Views done.
        done: usize,
        /// Number of views of this evaluation, as far as known.
        total: usize,
        /// Rendered share of the current view, 0 to 1.
        #[serde(default)]
        part: f64,
    },
    /// A checkpoint was written.
    Checkpoint {
        /// Step it holds.
        step: u64,
        /// Its size.
        bytes: u64,
    },
    /// Something the user should know that does not stop the run.
    Warning {
        /// One line.
        message: String,
    },
    /// The run was asked to stop and did.
    Stopped {
        /// Where it stands.
        totals: Totals,
    },
    /// Training is over.
    Finished {
        /// Where it ended.
        totals: Totals,
    },
    /// One process's part of the run is over, whatever its outcome.
    SessionEnded {
        /// The device behind the backend's name.
        #[serde(default)]
        device: String,
        /// Backend of this part.
        backend: String,
        /// Seconds from the program's start, everything included.
        wall_seconds: f64,
        /// Largest resident memory of the process, where the system tells.
        peak_memory_bytes: Option<u64>,
        /// Where it came from.
        #[serde(default)]
        provenance: Provenance,
    },
}

/// Receives every event in order.
pub trait EventSink {
    /// Takes one event.
    fn emit(&mut self, event: &Event);
}

impl<F: FnMut(&Event)> EventSink for F {
    fn emit(&mut self, event: &Event) {
        self(event);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_event_with_a_value_that_json_cannot_hold_is_read_back() {
        let scales = vec![ScaleQuality {
            scale: 1,
            images: 1,
            psnr: f64::INFINITY,
            psnr_8bit: 50.0,
            psnr_opposite: 40.0,
            psnr_constant: 10.0,
            ssim: 1.0,
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
        assert!(psnr.is_nan() && scales[0].psnr.is_nan() && ssim == 1.0);
    }
}
