//! Events of a run, for tests.

use trimip_core::engine::events::{Event, Totals};
use trimip_core::measures::quality::{Measures, ScaleQuality};

/// An evaluation event at `step` with `psnr` at two scales.
pub fn evaluation(step: u64, stride: usize, last: bool, psnr: f64) -> Event {
    let scale = |scale, psnr| ScaleQuality {
        scale,
        images: 8,
        perceptual_images: 0,
        measures: Measures { psnr, psnr_constant: 12.0, ssim: 0.9, ..Measures::UNKNOWN },
    };
    Event::Evaluation {
        totals: Totals {
            step,
            seconds: step as f64 / 10.0,
            samples: step * 1000,
            rays: step * 10,
            ..Totals::default()
        },
        stride,
        frames: 8 * stride,
        bounded: false,
        last,
        scales: vec![scale(1, psnr - 1.0), scale(2, psnr + 1.0)],
        psnr,
        ssim: 0.9,
        seconds: 2.0,
    }
}

/// A step event at `step` with these counters.
pub fn step(step: u64, rays: u64, marched: u64, samples: u64) -> Event {
    Event::Step {
        totals: Totals { step, rays, marched, samples, seconds: step as f64, ..Totals::default() },
        progress: 0.5,
        loss: 0.25,
        batch_psnr: f64::INFINITY,
        learning_rate: 0.002,
        samples_per_second: 1000.0,
        rays_per_second: 10.0,
        occupied: 0.125,
        seconds_left: 1.0,
    }
}
