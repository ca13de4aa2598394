//! Tests of the exposure of photographs: derivatives of a whole step with respect to log-gains, and the effect of gains on a run.

use super::training::{configuration, steps};
use crate::fixtures::{lively, noise};
use trimip_core::{
    Backend, Config, Layout, Result, Session, ViewSet, config::Exposure, engine::trainer::Trainer,
};

/// Number of photographs.
const PHOTOGRAPHS: usize = 3;

/// Number of pixels of a step.
const PIXELS: usize = 150;

/// Returns a configuration whose photographs have gains.
pub fn exposed() -> Config {
    let mut config = configuration();
    config.loss.exposure = Exposure::Gain;
    config.optimizer.exposure_rate = 1e-2;
    config
}

/// The gradient of a whole step with respect to the log-gains is the slope of its loss. This includes photographs with views of
/// several scales, and the mean of the log-gains, which is subtracted.
///
/// # Errors
/// When a step fails.
pub fn whole_step<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = exposed();
    let mut trainer = Trainer::new(make(), &config, noise(PHOTOGRAPHS, 16, 2, 3))?;
    trainer.set_parameters(&lively(&Layout::new(&config), 13));
    trainer.occupy_all();
    let values = [[0.25_f32, -0.5, 0.0], [0.75, 0.125, -0.25], [-0.25, 0.5, 1.0]];
    trainer.set_log_gains(&values);
    let (_, gradient) = trainer.loss_and_exposure_gradient(0, PIXELS as u32)?;
    assert_eq!(gradient.len(), PHOTOGRAPHS);
    let most = gradient.as_flattened().iter().fold(0.0_f32, |most, g| most.max(g.abs()));
    assert!(most > 1e-3, "{gradient:?}");
    // A fourth-order difference with long steps, because a device adds its losses in f32.
    let h = 1.0 / 16.0;
    for (photograph, c) in (0..PHOTOGRAPHS).flat_map(|photograph| [0, 1, 2].map(|c| (photograph, c))) {
        let mut at = |by: f32| -> Result<f64> {
            let mut moved = values;
            moved[photograph][c] += by;
            trainer.set_log_gains(&moved);
            let (sums, _) = trainer.loss_and_gradient(0, PIXELS as u32)?;
            Ok(sums.loss / sums.weight)
        };
        let (near, far) = (at(h)? - at(-h)?, at(2.0 * h)? - at(-2.0 * h)?);
        let (found, slope) = (f64::from(gradient[photograph][c]), (8.0 * near - far) / f64::from(12.0 * h));
        assert!((found - slope).abs() < 1e-3 * f64::from(most), "{photograph}, {c}: {found}, not {slope}");
    }
    Ok(())
}

/// Returns opaque photographs, in which no background is visible.
fn opaque() -> ViewSet {
    let mut views = noise(3, 16, 2, 2);
    views.pixels.iter_mut().for_each(|pixel| pixel[3] = 255);
    views
}

/// Gains that stay at 1 change no bit of a run, but gains that move change some. No model file contains gains.
///
/// # Errors
/// When a step fails.
pub fn beside_the_model<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let run = |exposure: Exposure, rate: f64| {
        let mut config = exposed();
        (config.loss.exposure, config.optimizer.exposure_rate) = (exposure, rate);
        let mut trainer = Trainer::new(make(), &config, opaque())?;
        steps(&mut trainer, &config, 12)?;
        let parameters: Vec<u32> = trainer.parameters().into_iter().map(f32::to_bits).collect();
        Ok((parameters, trainer.checkpoint()?, trainer.log_gains()))
    };
    let (plain, without, none) = run(Exposure::None, 1e-2)?;
    let (still, with, zero) = run(Exposure::Gain, 0.0)?;
    let (moved, _, gains) = run(Exposure::Gain, 1e-2)?;
    assert!(plain == still, "gains of 1 change bits");
    assert!(plain != moved, "gains that move change nothing");
    assert!(none.is_empty() && zero == [[0.0; 3]; 3] && gains.as_flattened().iter().any(|e| e.abs() > 1e-3));
    assert!(without.file.tensors.keys().all(|name| !name.starts_with("exposure")));
    assert!(with.file.tensors.keys().any(|name| name.starts_with("exposure")));
    let names = |file: trimip_core::field::tensors::TensorFile| file.tensors.into_keys().collect::<Vec<_>>();
    assert_eq!(names(with.into_model().file), names(without.into_model().file));
    Ok(())
}
