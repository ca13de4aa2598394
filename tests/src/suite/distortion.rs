//! Tests of the distortion loss: a whole training step matches finite differences, and the loss does not depend on the
//! unit of length.

use super::{
    gradients::of_a_step,
    losses::{Given, TOLERANCE},
};
use crate::fixtures::small;
use trimip_core::{
    Backend, Config, Result,
    config::{Contraction, LossRays},
    engine::batch::Interval,
};

/// Returns configurations of bounded and contracted space in which the distortion loss outweighs the colour loss.
pub fn configurations() -> Vec<(&'static str, Config)> {
    let change = |name, change: &dyn Fn(&mut Config)| {
        let mut config = small();
        config.loss.distortion = 0.8;
        change(&mut config);
        (name, config)
    };
    vec![
        // Pixels have one, one and nine cones at the three scales.
        change("distortion of cones by scale", &|c| {
            (c.renderer.cones, c.renderer.cone_width) = (3, 0.3);
        }),
        change("mostly distortion, all rays, a box with three sides", &|c| {
            (c.loss.distortion, c.loss.rays) = (20.0, LossRays::All);
            (c.scene.aabb_min, c.scene.aabb_max) = ([-1.0, -1.5, -0.5], [2.0, 1.5, 0.75]);
        }),
        change("distortion in contracted space", &|c| {
            (c.scene.contraction, c.renderer.min_transmittance) = (Contraction::Ball, 0.0);
        }),
    ]
}

/// The loss and the gradients of a training step match central differences of the reference.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn finite_differences<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    configurations().iter().try_for_each(|(name, config)| of_a_step(&make, name, config))
}

/// Returns bounded and contracted space around the origin, with a box or a ball `scale` times as large as usual.
fn spaces(scale: f32, weight: f32) -> [Config; 2] {
    [Contraction::None, Contraction::Ball].map(|contraction| {
        let mut config = small();
        (config.scene.contraction, config.loss.distortion) = (contraction, weight);
        (config.scene.aabb_min, config.scene.aabb_max) = ([-1.5 * scale; 3], [1.5 * scale; 3]);
        config
    })
}

/// A world eight times as large with an eighth of the density has the same loss. With a weight of 0, the loss and its
/// gradient are 0.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn in_other_units<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let scale = 8.0;
    let near = Given::new(5).without_colours();
    let mut far = near.clone();
    far.rays.iter_mut().for_each(|ray| ray.origin = ray.origin.map(|x| scale * x));
    far.densities.iter_mut().for_each(|density| *density /= scale);
    for interval in &mut far.intervals {
        *interval = Interval { t: scale * interval.t, length: scale * interval.length };
    }
    for (small, large) in spaces(1.0, 0.7).iter().zip(&spaces(scale, 0.7)) {
        let (own, other) = (near.evaluate(make(), small, &[])?, far.evaluate(make(), large, &[])?);
        let (loss, same) = (own.result.sums.loss, other.result.sums.loss);
        assert!(loss > 0.1 && (loss - same).abs() < TOLERANCE * loss, "{same}, not {loss}");
        for (a, b) in own.by_density.iter().zip(&other.by_density) {
            assert!((f64::from(scale) * a - b).abs() < 1e-5 * a.abs().max(1.0), "{b}, not eight times {a}");
        }
    }
    for config in spaces(1.0, 0.0) {
        let found = near.evaluate(make(), &config, &[])?;
        assert!(
            found.result.sums.loss == 0.0 && found.by_density.iter().all(|&g| g == 0.0),
            "no weight, no loss"
        );
    }
    Ok(())
}
