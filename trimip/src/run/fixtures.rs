//! Events of a run and its report, for tests.

use crate::machine::Machine;
use crate::report::{Report, Status};
use crate::run::history::History;
use trimip_core::Config;
use trimip_core::engine::events::{Event, Provenance, Totals};
use trimip_core::measures::quality::{Measures, ScaleQuality};

/// Returns an evaluation event at `step` with `psnr` at two scales.
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

/// Returns a step event at `step` with these counters.
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

/// Passes a report of two evaluations on a small curve to `test`.
pub fn report(test: impl FnOnce(&Report<'_>)) {
    let settings = crate::settings::defaults();
    let config = Config::default();
    let history = History::of(&[
        Event::Warning { message: "a <dark> image".into() },
        evaluation(10, 25, false, 20.0),
        evaluation(100, 25, false, 25.0),
        evaluation(100, 1, true, 24.5),
        Event::SessionEnded {
            device: "two cores".into(),
            backend: "cpu".into(),
            wall_seconds: 20.0,
            peak_memory_bytes: None,
            provenance: Provenance {
                command: Some("trimip-cli --config a&b.toml".into()),
                version: Some("0.1.0 (abc)".into()),
                ended_unix: Some(0),
                test_views: Some(200),
            },
        },
    ]);
    test(&Report {
        status: Status::Finished,
        run: "first_run".into(),
        scene: "lego & co".into(),
        config: &config,
        settings: &settings,
        history: &history,
        machine: Machine::detect(),
        model_bytes: Some(1_000),
        views: Vec::new(),
    });
}
