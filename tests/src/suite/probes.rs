//! Probes of the occupancy grid are ordinary samples: ray, interval and sphere of a probe all describe the same
//! position.

use super::Bench;
use crate::fixtures::{lively, small};
use trimip_core::{Backend, Layout, Result, Space, backend::Occupancy};

/// Positions in the unit cube and directions in f32, after about ten roundings of 6e-8 on values up to the box's size.
const TOLERANCE: f64 = 4e-6;

/// Every probe lies in the box, on its ray, and has its ray's radius there. Directions are uniform.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn on_their_rays<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut config = small();
    (config.scene.aabb_min, config.scene.aabb_max) = ([-1.0, -1.5, -0.5], [2.0, 1.5, 0.75]);
    let parameters = lively(&Layout::new(&config), 3);
    let views = crate::fixtures::noise(1, 8, 1, 1);
    let mut bench = Bench::new(make(), &config, Some(views), &parameters)?;
    let Bench { backend, stages, space, .. } = &mut bench;
    let count = stages.occupancy.choose(1);
    stages.occupancy.probes(&mut space.lane, 1, 0..count, &mut space.rays, &mut space.samples);
    let (rays, owners) = (backend.read(&space.rays.rays), backend.read(&space.samples.rays));
    let intervals = backend.read(&space.samples.intervals);
    let spheres = backend.read(&space.samples.spheres);
    assert_eq!(spheres.len(), 8 * 8 * 8, "every cell is asked while the grid warms up");
    let cube = Space::<f64>::new(&config.scene);
    let (mut mean, mut square) = ([0.0; 3], [0.0; 3]);
    for ((sphere, interval), &owner) in spheres.iter().zip(&intervals).zip(&owners) {
        let ray = &rays[owner as usize];
        let (t, direction) = (f64::from(interval.t), ray.direction.map(f64::from));
        let on_ray = |axis: usize| f64::from(ray.origin[axis]) + t * direction[axis];
        let position = cube.to_cube([0, 1, 2].map(on_ray));
        for (found, expected) in sphere.position.into_iter().zip(position) {
            assert!((f64::from(found) - expected).abs() < TOLERANCE, "{sphere:?} is not on {ray:?}");
            assert!((0.0..=1.0).contains(&found), "{sphere:?}");
        }
        let radius = f64::from(ray.slope) * t;
        assert!((f64::from(sphere.radius) / radius - 1.0).abs() < TOLERANCE, "{sphere:?}: radius {radius}");
        assert!((direction.iter().map(|x| x * x).sum::<f64>() - 1.0).abs() < TOLERANCE, "{ray:?}");
        assert!(interval.length > 0.0, "{interval:?}");
        (0..3).for_each(|axis| {
            mean[axis] += direction[axis] / spheres.len() as f64;
            square[axis] += direction[axis].powi(2) / spheres.len() as f64;
        });
    }
    // Uniform directions have mean 0 and mean square 1/3; the bound is four standard errors of 512 draws.
    for axis in 0..3 {
        assert!(mean[axis].abs() < 4.0 * (1.0 / 3.0 / 512.0_f64).sqrt(), "{mean:?}");
        assert!((square[axis] - 1.0 / 3.0).abs() < 4.0 * (4.0 / 45.0 / 512.0_f64).sqrt(), "{square:?}");
    }
    Ok(())
}
