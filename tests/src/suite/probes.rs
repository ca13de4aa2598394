//! Tests of the probes of the occupancy grid, which are ordinary samples: the ray, the interval and the sphere of a
//! probe all describe the same position.

use super::Bench;
use crate::fixtures::{TestRandom, encoded, every_encoder, lively, noise, small};
use trimip_core::{
    Backend, Layout, Query, Result, Session, Space, Viewer,
    engine::{backend::Occupancy, batch::Radiance, trainer::Trainer},
    field::{encoders, encoders::SamplePosition, exact::Exact},
    geometry::occupancy::OUTSIDE,
};

/// Tolerance of positions in the unit cube and of directions: about ten roundings of 6e-8 in f32, on values up to the
/// box's size.
const TOLERANCE: f64 = 4e-6;

/// Every probe lies in the box and on its ray, and has the radius of the ray there. The directions of the rays are
/// uniform.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn on_their_rays<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut config = small();
    (config.scene.aabb_min, config.scene.aabb_max) = ([-1.0, -1.5, -0.5], [2.0, 1.5, 0.75]);
    let parameters = lively(&Layout::new(&config), 3);
    let views = noise(1, 8, 1, 1);
    let mut bench = Bench::new(make(), &config, Some(views), &parameters)?;
    let Bench { backend, stages, workspace, .. } = &mut bench;
    let count = stages.occupancy.select(1);
    stages.occupancy.probes(&mut workspace.stream, 1, 0..count, &mut workspace.rays, &mut workspace.samples);
    let (rays, owners) = (backend.read(&workspace.rays.rays), backend.read(&workspace.samples.rays));
    let intervals = backend.read(&workspace.samples.intervals);
    let spheres = backend.read(&workspace.samples.spheres);
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
    // Uniform directions have mean 0 and mean square 1/3; the bounds are four standard errors of 512 draws.
    for axis in 0..3 {
        assert!(mean[axis].abs() < 4.0 * (1.0 / 3.0 / 512.0_f64).sqrt(), "{mean:?}");
        assert!((square[axis] - 1.0 / 3.0).abs() < 4.0 * (4.0 / 45.0 / 512.0_f64).sqrt(), "{square:?}");
    }
    Ok(())
}

/// Cells outside of the visual hull are neither probed nor occupied, and do not contribute to the mean density, which
/// is the threshold.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn within_the_hull<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    const SIDE: usize = 8;
    let mut config = small();
    // With so high a limit, the mean density is the threshold.
    config.occupancy.threshold = 1e9;
    let parameters = lively(&Layout::new(&config), 3);
    let inside = |cell: usize| cell % SIDE >= SIDE / 2;
    let bits_of = |of: &dyn Fn(usize) -> bool| {
        let byte = |i: usize| (0..8).fold(0, |byte, bit| byte | u8::from(of(8 * i + bit)) << bit);
        (0..SIDE.pow(3) / 8).map(byte).collect::<Vec<u8>>()
    };
    let upper = |cell: usize| cell / SIDE / SIDE >= SIDE / 2;
    // Densities of the lower and the upper half. Only the upper density exceeds the mean over the hull, 2; both exceed
    // the mean over the whole grid, 1. If all densities are 0, the whole hull becomes occupied.
    for ([below, above], expected) in
        [([1.5, 2.5], bits_of(&|cell| inside(cell) && upper(cell))), ([0.0, 0.0], bits_of(&inside))]
    {
        let views = noise(1, 8, 1, 1);
        let mut bench = Bench::new(make(), &config, Some(views), &parameters)?;
        let Bench { backend, stages, workspace, .. } = &mut bench;
        let densities: Vec<f32> =
            (0..SIDE.pow(3)).map(|cell| if inside(cell) { 0.0 } else { OUTSIDE }).collect();
        stages.occupancy.restore(&bits_of(&inside), Some(&densities));
        let count = stages.occupancy.select(1);
        stages.occupancy.probes(
            &mut workspace.stream,
            1,
            0..count,
            &mut workspace.rays,
            &mut workspace.samples,
        );
        let spheres = backend.read(&workspace.samples.spheres);
        assert_eq!(spheres.len(), SIDE.pow(3) / 2, "every cell of the hull is asked while the grid warms up");
        assert!(spheres.iter().all(|sphere| sphere.position[0] >= 0.5), "cells outside are not");
        let density = |z: f32| if z < 0.5 { below } else { above };
        let radiance = spheres.iter().map(|s| Radiance { rgb: [0.0; 3], density: density(s.position[2]) });
        backend.write(&mut workspace.radiance, &radiance.collect::<Vec<_>>());
        backend.install(|| stages.occupancy.update(&workspace.radiance));
        assert_eq!(stages.occupancy.bits(), expected, "{below} and {above}");
        let found = stages.occupancy.densities();
        assert!((0..SIDE.pow(3)).all(|cell| inside(cell) == (found[cell] >= 0.0)), "marks stay");
    }
    Ok(())
}

/// Queries of world positions return the density and colour of the model in f64, wherever the box is. The results of
/// more queries than one tile holds are in the order of the queries.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn queries<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for encoder in every_encoder() {
        let mut config = encoded(small(), &encoder);
        (config.scene.aabb_min, config.scene.aabb_max) = ([9.0, -1.5, -0.5], [12.0, 1.5, 0.75]);
        let mut trainer = Trainer::new(make(), &config, noise(1, 8, 1, 1))?;
        trainer.set_parameters(&lively(trainer.layout(), 5));
        let exact = Exact::new(&trainer.model()?)?;
        let (space, mut random) = (Space::<f64>::new(&config.scene), TestRandom::new(8));
        let queries: Vec<Query> = (0..1300)
            .map(|_| Query {
                point: std::array::from_fn(|axis| {
                    let side = |end: [f32; 3]| f64::from(end[axis]);
                    random.between(side(config.scene.aabb_min), side(config.scene.aabb_max))
                }),
                radius: random.between(-6.0, -1.0).exp2() as f32,
                direction: random.direction().as_vec3().to_array(),
            })
            .collect();
        let found = trainer.query(&queries)?;
        assert_eq!(found.len(), queries.len());
        let features = trainer.features(&queries)?;
        let width = encoders::of(&config).width(&config);
        assert_eq!(features.len(), queries.len() * width);
        for (i, (query, found)) in queries.iter().zip(&found).enumerate() {
            let radius = f64::from(query.radius);
            let direction = query.direction.map(f64::from);
            // A query evaluates an interval as long as its sphere is wide, at a distance of the box's longest side from
            // the eye.
            let (t, length) = (space.aabb().longest(), 2.0 * radius);
            let place = SamplePosition { position: space.to_cube(query.point), radius, direction, t, length };
            let expected = exact.features(&place);
            for (found, expected) in features[i * width..].iter().zip(&expected[..width]) {
                let apart = (f64::from(*found) - expected).abs();
                assert!(
                    apart <= 2e-3 * expected.abs().max(0.1),
                    "query {i}: feature {found}, not {expected}"
                );
            }
            let (density, rgb) = exact.radiance(&expected, direction);
            let close =
                |found: f32, expected: f64| (f64::from(found) - expected).abs() <= 2e-3 * expected.max(0.1);
            assert!(
                close(found.density, density) && (0..3).all(|c| close(found.rgb[c], rgb[c])),
                "{:?}, query {i}: {found:?}, not {density} and {rgb:?}",
                config.encoder.kind
            );
        }
        assert!(trainer.query(&[])?.is_empty() && trainer.features(&[])?.is_empty());
    }
    Ok(())
}
