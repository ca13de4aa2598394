//! A training loop and a measure of one's own, over a bare session: no scene plan, no run folder, no report.
//!
//! `cargo run --release -p trimip --example training_loop`

use trimip::{Config, Frame, backends, data, settings};

/// Steps of the training.
const STEPS: u64 = 2000;

fn main() -> trimip::Result<()> {
    let mut config = Config::default();
    config.encoder.plane_size = 256;
    config.field.hidden = 32;
    config.train.samples_per_step = 32_768;
    config.change::<data::DataConfig>(|data| data.format = "builtin".into())?;
    let error = train(&config, STEPS)?;
    println!("mean absolute error of the first test view: {error:.4}");
    Ok(())
}

/// Trains for `steps` steps, and returns the mean absolute error of the first test view.
pub fn train(config: &Config, steps: u64) -> trimip::Result<f64> {
    // Conversion to settings and back checks the ranges of the typed configuration.
    let config = Config::from_settings(&settings::of(config)?)?;
    let scene = data::open(&config.section()?)?;
    let mut session = backends::train(&config, scene.train)?;
    for step in 0..steps {
        let report = session.step(step as f64 / steps as f64)?;
        if step % 500 == 0 {
            println!("step {step}: {:.2} dB", report.batch_psnr);
        }
    }
    let test = scene.test.load(0)?;
    let frame = session.render(&test.views[0].camera)?;
    let photograph = test.composited(0, config.data.background);
    Ok(mean_absolute_error(&frame, &photograph))
}

/// Returns the mean over pixels and channels of |rendered − photograph|.
fn mean_absolute_error(frame: &Frame, photograph: &[[f32; 3]]) -> f64 {
    let errors = frame.pixels.iter().flat_map(|pixel| pixel.rgb).zip(photograph.iter().flatten());
    let sum: f64 = errors.map(|(a, b)| f64::from((a - b).abs())).sum();
    sum / (3 * photograph.len()) as f64
}
