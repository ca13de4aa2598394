//! Tests of unbounded space: samples match the literal equations, fog has its known opacity, pictures match the model in f64.

use super::Bench;
use crate::{
    fixtures::{constant, lively, small},
    reference::contraction::{self, Step},
};
use glam::DVec3;
use trimip_core::{
    Backend, Camera, Config, Intrinsics, Layout, Query, Result, Viewer,
    config::Contraction,
    engine::{backend::Occupancy, loaded::LoadedModel},
    field::{
        exact::Exact,
        model::Model,
        tensors::{Tensor, TensorFile},
    },
};

/// Distance to a cell's border, in unit-box coordinates, below which f32 and f64 may decide differently.
const BORDER: f64 = 4e-6;

/// Returns a configuration of unbounded space: a ball of radius 0.75 in the middle of a cube of side 3.
pub fn configuration(resolution: u32) -> Config {
    let mut config = small();
    config.scene.contraction = Contraction::Ball;
    config.occupancy.resolution = resolution;
    config.renderer.steps_per_diagonal = 500;
    config
}

fn model(config: &Config, parameters: &[f32]) -> Result<Model> {
    let mut file = TensorFile::default();
    Layout::new(config).to_tensors(parameters, "", &mut file);
    let bytes = config.occupancy.resolution.pow(3) as usize / 8;
    file.tensors.insert("occupancy".into(), Tensor::u8(&[bytes], vec![0xff; bytes]));
    Ok(Model::new(config.clone(), file))
}

/// Samples have the distances, lengths, positions and radii of the equations. Exactly the occupied steps have a sample, except
/// near the borders of cells.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn as_written<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for (resolution, fraction) in [(32, 0.5), (20, 0.9), (32, 0.02)] {
        let config = configuration(resolution);
        let mut bench = Bench::new(make(), &config, None, &lively(&Layout::new(&config), 1))?;
        let bits = super::marching::bits(resolution, fraction, 5);
        bench.stages.occupancy.restore(&bits, None);
        let rays = super::marching::rays(3);
        let found = super::marching::marched(&mut bench, &rays, None);
        let intervals = bench.backend.read(&bench.workspace.samples.intervals);
        let spheres = bench.backend.read(&bench.workspace.samples.spheres);
        let (mut row, mut total, mut borderline) = (0, 0, 0);
        for (ray, found) in rays.iter().zip(&found) {
            let mut next = 0;
            for Step { sample, length, left } in contraction::march(&config, ray) {
                let scaled = sample.position.map(|p| p * f64::from(resolution));
                let cell = scaled.map(|p| (p as u32).min(resolution - 1));
                let index = cell[0] + resolution * (cell[1] + resolution * cell[2]);
                let expected = bits[index as usize / 8] >> (index % 8) & 1 == 1;
                let there = found.get(next).is_some_and(|&t| (f64::from(t) - sample.t).abs() < 0.1 * length);
                total += usize::from(expected);
                if expected != there {
                    let border =
                        scaled.iter().any(|p| (p - p.round()).abs() < BORDER * f64::from(resolution));
                    assert!(border || left < 1e-5, "{ray:?} at {}: {there}, not {expected}", sample.t);
                    borderline += 1;
                }
                if there {
                    let (interval, sphere) = (intervals[row + next], spheres[row + next]);
                    let close = |found: f32, expected: f64, bound: f64| {
                        let found = f64::from(found);
                        assert!((found - expected).abs() <= bound, "{sample:?}: {found}, not {expected}");
                    };
                    // Ray parameters have an error of a few 1e-7, where a step is 1e-2. Far away, such an error is a large
                    // distance.
                    let off = 1e-4 * length;
                    close(interval.t, sample.t, off);
                    close(interval.length, sample.length, 1e-3 * sample.length);
                    close(sphere.radius, sample.radius, (1e-4 + off / sample.t) * sample.radius);
                    (0..3).for_each(|axis| close(sphere.position[axis], sample.position[axis], 2e-6));
                    next += 1;
                }
            }
            assert!(next + 1 >= found.len(), "{ray:?}: samples that no step has");
            row += found.len();
        }
        assert!(total > 500, "the rays meet {total} occupied steps");
        assert!(f64::from(borderline) < 0.005 * total as f64, "{borderline} of {total} at a border");
    }
    Ok(())
}

/// Fog of density σ has the opacity 1 − exp(−σ·(2 − 1/1000)·r), seen from the centre of the ball of radius r to the end of the
/// rays at 1000·r; about half of the optical depth lies within the ball. A query returns the density per world unit: σ within the
/// ball, σ/n² at n radii from its centre.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn fog<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = configuration(8);
    let density = 0.8_f64;
    let parameters = constant(&config, &Layout::new(&config), density, [0.5; 3]);
    let mut model = LoadedModel::new(make(), &model(&config, &parameters)?)?;
    let camera = Camera::look_at(Intrinsics::from_angle(6, 5, 0.9), DVec3::ZERO, DVec3::Y, DVec3::Z);
    let step = crate::reference::step_length(&config);
    for pixel in model.render(&camera)?.pixels {
        let depth = -(1.0 - f64::from(pixel.opacity)).ln();
        let expected = density * 0.75 * (2.0 - 1e-3);
        assert!((depth - expected).abs() < 0.6 * density * step, "{depth}, not {expected}");
    }
    let at = |n: f64| Query {
        point: [0.0, -0.6 * 0.75 * n, 0.8 * 0.75 * n],
        radius: 0.01,
        direction: [0.0, 0.0, 1.0],
    };
    let places = [0.2, 0.99, 1.5, 4.0, 100.0];
    for (n, found) in places.into_iter().zip(model.query(&places.map(at))?) {
        let expected = density / f64::max(n * n, 1.0);
        assert!((f64::from(found.density) / expected - 1.0).abs() < 1e-3, "{n}: {}", found.density);
    }
    Ok(())
}

/// Pictures of a field with varied densities, from within the ball and from outside, match the model in f64.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn exact<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for deferred in [false, true] {
        let mut config = configuration(8);
        config.field.deferred = deferred;
        exact_of(make(), &config)?;
    }
    Ok(())
}

fn exact_of<B: Backend>(backend: B, config: &Config) -> Result<()> {
    let model = model(config, &lively(&Layout::new(config), 7))?;
    let exact = Exact::new(&model)?;
    let mut loaded = LoadedModel::new(backend, &model)?;
    for (from, to) in [
        (DVec3::new(0.2, 0.1, -0.1), DVec3::X),
        (DVec3::new(0.5, -1.9, 0.4), DVec3::ZERO),
        (DVec3::new(3.0, 2.0, 1.0), DVec3::new(4.0, -2.0, 7.0)),
    ] {
        let camera = Camera::look_at(Intrinsics::from_angle(8, 7, 0.9), from, to, DVec3::Z);
        let frame = loaded.render(&camera)?;
        for (i, pixel) in frame.pixels.iter().enumerate() {
            let (x, y) = (i as u32 % 8, i as u32 / 8);
            let expected = exact.pixel(&camera, x, y, config.renderer.steps_per_diagonal);
            for c in 0..3 {
                let off = (f64::from(pixel.rgb[c]) - expected[c]).abs();
                // Rendering stops at a transmittance of 1e-4.
                assert!(off < 3e-4, "{from}: pixel {x}, {y}: {:?}, not {expected:?}", pixel.rgb);
            }
        }
    }
    Ok(())
}

/// A scene and its camera that are moved far from the origin give the same picture.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn shifted<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = configuration(8);
    let parameters = lively(&Layout::new(&config), 7);
    let mut far = config.clone();
    let moved = DVec3::new(1024.0, -512.0, 64.0);
    for axis in 0..3 {
        far.scene.aabb_min[axis] += moved[axis] as f32;
        far.scene.aabb_max[axis] += moved[axis] as f32;
    }
    let camera =
        Camera::look_at(Intrinsics::from_angle(8, 7, 0.9), DVec3::new(0.5, -1.9, 0.4), DVec3::ZERO, DVec3::Z);
    let near = LoadedModel::new(make(), &model(&config, &parameters)?)?.render(&camera)?;
    let camera = Camera { origin: camera.origin + moved, ..camera };
    let other = LoadedModel::new(make(), &model(&far, &parameters)?)?.render(&camera)?;
    for (a, b) in near.pixels.iter().zip(&other.pixels) {
        assert!((0..3).all(|c| (a.rgb[c] - b.rgb[c]).abs() < 1e-5), "{a:?} {b:?}");
    }
    Ok(())
}
