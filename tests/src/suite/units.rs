//! The unit of length changes nothing: a world that is larger by any factor, with densities smaller by that factor, has the same loss and
//! the same gradients.

use crate::fixtures::{every_variant, lively, noise};
use trimip_core::{
    Backend, Config, Layout, Result, ViewSet,
    config::{Contraction, EncoderKind, schedule::Schedule},
    engine::trainer::Trainer,
    scene::depths::KnownDepth,
};

/// Number of rays of a step.
const RAYS: u32 = 200;

/// Returns the configuration of a world `times` as large.
fn larger(config: &Config, times: f32) -> Config {
    let mut config = config.clone();
    for corner in config.scene.aabb_min.iter_mut().chain(&mut config.scene.aabb_max) {
        *corner *= times;
    }
    config.field.density_scale /= times;
    config.renderer.cone_width *= times;
    config
}

/// Returns the photographs of a world `times` as large.
fn seen(times: f64) -> ViewSet {
    let mut views = noise(4, 24, 2, 3);
    views.views.iter_mut().for_each(|view| view.camera.origin *= times);
    let far = |own: &KnownDepth| KnownDepth {
        distance: own.distance * times as f32,
        deviation: own.deviation * times as f32,
        ..*own
    };
    views.depths = views.depths.iter().map(far).collect();
    views
}

/// The loss and the gradient of a step are the same in worlds of other units: with distortion, opacity and depth terms, in bounded and
/// contracted space, for every encoder whose features do not depend on lengths.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn change_nothing<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let by_length = [EncoderKind::Frequencies];
    for own in every_variant().into_iter().filter(|config| !by_length.contains(&config.encoder.kind)) {
        for contraction in [Contraction::None, Contraction::Ball] {
            let mut config = own.clone();
            config.scene.contraction = contraction;
            (config.loss.distortion, config.loss.opacity) = (0.3, 0.2);
            config.loss.depth = Schedule::new(vec![[0.0, 0.2]]);
            if config.validate().is_err() {
                continue;
            }
            let parameters = lively(&Layout::new(&config), 7);
            let step = |times: f32| -> Result<(f64, Vec<f32>)> {
                let config = larger(&config, times);
                let mut trainer = Trainer::new(make(), &config, seen(times.into()))?;
                trainer.set_parameters(&parameters);
                let (sums, gradient) = trainer.loss_and_gradient(0, RAYS)?;
                Ok((sums.loss / sums.weight, gradient))
            };
            let (loss, gradient) = step(1.0)?;
            let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>().sqrt();
            let length = norm(&mut gradient.iter().map(|&g| g.into()));
            assert!(loss > 0.0 && length > 0.0, "{:?}", config.encoder.kind);
            for times in [1024.0, 1.0 / 1024.0, 37.0] {
                let (other, theirs) = step(times)?;
                let what = format!("{:?}, {contraction:?}, {times} times as large", config.encoder.kind);
                assert!((other / loss - 1.0).abs() < 1e-3, "{what}: a loss of {other}, not {loss}");
                let apart = norm(&mut gradient.iter().zip(&theirs).map(|(a, b)| f64::from(a - b)));
                assert!(apart < 0.02 * length, "{what}: gradients are {apart} apart, of {length}");
            }
        }
    }
    Ok(())
}
