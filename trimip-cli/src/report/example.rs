//! A report of two evaluations on a small curve, for tests of the pages.

use trimip::events::{Event, Provenance, Totals};
use trimip::quality::{Measures, ScaleQuality};
use trimip::report::{Report, Status};
use trimip::{Config, machine::Machine, run::history::History};

/// An evaluation event at `step` with `psnr` at two scales.
fn evaluation(step: u64, stride: usize, last: bool, psnr: f64) -> Event {
    let scale = |scale, psnr| ScaleQuality {
        scale,
        images: 8,
        perceptual_images: 0,
        measures: Measures { psnr, psnr_constant: 12.0, ssim: 0.9, ..Measures::UNKNOWN },
    };
    let seconds = step as f64 / 10.0;
    Event::Evaluation {
        totals: Totals { step, seconds, samples: step * 1000, rays: step * 10, ..Totals::default() },
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

/// Passes the report to a test.
pub fn example(test: impl FnOnce(&Report<'_>)) {
    let (settings, config) = (trimip::settings::defaults(), Config::default());
    let provenance = Provenance {
        command: Some("trimip-cli --config a&b.toml".into()),
        version: Some("0.1.0 (abc)".into()),
        ended_unix: Some(0),
        test_views: Some(200),
    };
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
            provenance,
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
