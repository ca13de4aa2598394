//! Where training rays come from: shares and weights of the scales.

use super::Bench;
use crate::fixtures::{lively, noise, small};
use trimip_core::{Backend, Layout, Result, backend::Sampler, schedule::Schedule};

/// Rays of a step are shared among the scales as the schedule says, and weigh what makes up for it. A ray's scale shows
/// in the width of its cone.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn balance<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut config = small();
    config.train.scale_balance = Schedule::new(vec![[0.0, 0.0], [0.5, 0.5], [0.9, 1.0]]);
    let views = noise(3, 32, 3, 4);
    let finest = views.views[0].camera.intrinsics.fx.recip() / std::f64::consts::PI.sqrt();
    let parameters = lively(&Layout::new(&config), 1);
    let mut bench = Bench::new(make(), &config, Some(views), &parameters)?;
    // 4^(b-1) of the rays a scale, rounded down for all but the finest; weights 4^(1-b).
    let expected = [
        (0.0, [3_201, 800, 200], [1.0, 4.0, 16.0]),
        (0.49, [3_201, 800, 200], [1.0, 4.0, 16.0]),
        (0.5, [2_401, 1_200, 600], [1.0, 2.0, 4.0]),
        (1.0, [1_401, 1_400, 1_400], [1.0, 1.0, 1.0]),
    ];
    for (progress, shares, weights) in expected {
        let Bench { backend, stages, space, .. } = &mut bench;
        stages.sampler.follow(progress);
        stages.sampler.training_rays(&mut space.lane, 7, 4_201, 0..4_201, &mut space.rays);
        let (rays, targets) = (backend.read(&space.rays.rays), backend.read(&space.rays.targets));
        let mut found = [0; 3];
        for (ray, target) in rays.iter().zip(&targets) {
            let width = f64::from(ray.slope) / f64::from(ray.cosine).powi(2) / finest;
            let scale = width.log2().round() as usize;
            found[scale] += 1;
            assert!((target.weight - weights[scale]).abs() < 1e-6, "weight {} at {progress}", target.weight);
        }
        assert_eq!(found, shares, "{progress}");
    }
    Ok(())
}
