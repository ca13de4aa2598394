//! Runs of a comparison, for tests.

use super::figures::Figures;
use super::runs::{Run, Scales, Status};
use trimip::run::curve::Measure;
use trimip::systems::find;
use trimip_core::{
    config::Convention,
    measures::quality::{Measures, ScaleQuality, mean_quality},
};

/// Returns a finished run of the system with these PSNRs.
pub fn run(system: &str, scene: &str, seed: u64, psnr: [f64; 2]) -> Run {
    let quality = |scale, psnr| ScaleQuality {
        scale,
        images: 2,
        perceptual_images: 0,
        measures: Measures { psnr, psnr_plain: psnr - 1.0, ssim: psnr / 100.0, ..Measures::UNKNOWN },
    };
    let scales = vec![quality(1, psnr[0]), quality(2, psnr[1])];
    let figures = Figures {
        mean: mean_quality(&scales),
        scales,
        views: 2,
        test_views: Some(200),
        background: [1.0; 3],
        convention: Convention::Public,
        seconds: 10.0,
        evaluation_seconds: 1.0,
        steps: 100,
        samples: 1_000,
        parameters: [1_000, 24],
        model_bytes: Some(4_096),
        peak_memory_bytes: None,
        curve: vec![Measure { seconds: 5.0, psnr: 10.0 }, Measure { seconds: 10.0, psnr: psnr[0] }],
    };
    Run {
        scales: Scales::Four,
        scene: scene.into(),
        system: find(system).unwrap().name,
        seed,
        folder: scene.into(),
        status: Status::Finished,
        figures: Some(figures),
    }
}
