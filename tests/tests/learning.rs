//! Checks that a model trained on the built-in scene renders held-out views better than any constant colour.

use trimip_core::{
    Config, Session, engine::trainer::Trainer, measures::metrics::psnr, run::evaluate::evaluate,
};
use trimip_cpu::{CpuBackend, simd::Simd};
use trimip_data::settings::DataConfig;
use trimip_tests::fixtures::as_code;

/// Minimum gain in dB over the best constant colour, which is the mean of the held-out image itself.
const MARGIN: f64 = 6.0;

/// Number of training steps.
const STEPS: u64 = 150;

fn configuration() -> Config {
    let mut config = as_code();
    let read = config.change(|data: &mut DataConfig| {
        data.format = "builtin".into();
        (data.builtin_size, data.builtin_train, data.builtin_test) = (32, 8, 2);
        (data.builtin_supersampling, data.scales) = (2, 2);
    });
    read.unwrap();
    (config.encoder.plane_size, config.encoder.levels) = (32, 5);
    config.field.hidden = 32;
    config.renderer.steps_per_diagonal = 192;
    config.occupancy.resolution = 32;
    config.occupancy.warmup = 64;
    config.train.samples_per_step = 4096;
    config.train.steps = STEPS;
    config
}

/// Returns the mean PSNR on the held-out views, and that of the best constant colour of each view.
fn held_out(config: &Config) -> (f64, f64) {
    let scene = trimip_data::open(&config.section().unwrap()).unwrap();
    let mut trainer = Trainer::new(CpuBackend::new(2, Simd::detect()).unwrap(), config, scene.train).unwrap();
    for step in 0..STEPS {
        let report = trainer.step(step as f64 / STEPS as f64).unwrap();
        assert!(report.loss.is_finite() && report.totals.non_finite == 0);
    }
    let mut constant = Vec::new();
    let views = evaluate(&mut trainer, scene.test.as_ref(), 1, &config.data, |view| {
        let count = view.target.len() as f32;
        let mean = [0, 1, 2].map(|c| view.target.iter().map(|p| p[c]).sum::<f32>() / count);
        constant.push(psnr(&vec![mean; view.target.len()], view.target));
        Ok(true)
    })
    .unwrap();
    let mean = |values: &mut dyn Iterator<Item = f64>| values.sum::<f64>() / views.len() as f64;
    (mean(&mut views.iter().map(|view| view.measures.psnr)), mean(&mut constant.iter().copied()))
}

#[test]
fn held_out_views_beat_a_constant_colour() {
    let (model, constant) = held_out(&configuration());
    assert!(model > constant + MARGIN, "{model:.2} dB, a constant has {constant:.2} dB");
}

#[test]
fn so_does_the_ablation_without_mipmap() {
    let mut config = configuration();
    config.encoder.mipmap = false;
    let (model, constant) = held_out(&config);
    assert!(model > constant + MARGIN, "{model:.2} dB, a constant has {constant:.2} dB");
}
