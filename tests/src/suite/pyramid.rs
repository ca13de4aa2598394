//! Tests of invariants of the mip pyramid: every level has the mean of its base, gradients reach the base without loss,
//! and the backward pass is the transpose of the forward pass.

use super::{Bench, wide};
use crate::fixtures::{TestRandom, lively, small};
use crate::reference::{AXES, sides};
use trimip_core::{
    Backend, Config, Encoder, Layout, Result,
    config::PlaneShape,
    engine::{
        backend::Field,
        batch::{PartialGradients, Sphere, Tile},
    },
};

/// Largest error of means and sums of several thousand f32 values of order 1, relative to the sum of their magnitudes.
const SUM_TOLERANCE: f64 = 1e-6;

/// Returns configurations with square planes over a cube, and with planes of 48 × 64 × 16 texels over a box of these
/// proportions.
fn configurations() -> [Config; 2] {
    let mut cube = small();
    (cube.encoder.plane_size, cube.encoder.levels) = (32, 6);
    let mut long = small();
    (long.encoder.plane_size, long.encoder.levels) = (64, 5);
    long.encoder.shape = PlaneShape::Box;
    (long.scene.aabb_min, long.scene.aabb_max) = ([-1.0, -2.0, 0.0], [2.0, 2.0, 1.0]);
    [cube, long]
}

/// Returns the world radius whose level is exactly `level`, by the paper's formula.
fn radius(config: &Config, level: f64) -> f32 {
    let texel = f64::from(config.scene.aabb_max[1] - config.scene.aabb_min[1]) / sides(config)[1] as f64;
    (texel / std::f64::consts::PI.sqrt() * level.exp2()) as f32
}

/// The mean over all texels of any level is the mean of the base.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn means<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for config in configurations() {
        means_of(make(), &config)?;
    }
    Ok(())
}

fn means_of<B: Backend>(backend: B, config: &Config) -> Result<()> {
    let parameters = lively(&Layout::new(config), 4);
    let mut bench = Bench::new(backend, config, None, &parameters)?;
    let mut rest = &parameters[..];
    for (plane, [a, b]) in AXES.into_iter().enumerate() {
        let [columns, rows] = [a, b].map(|axis| sides(config)[axis]);
        let base;
        (base, rest) = rest.split_at(columns * rows * 16);
        for level in 0..config.encoder.levels as usize {
            let (columns, rows) = (columns >> level, rows >> level);
            let spheres: Vec<Sphere> = (0..columns * rows)
                .map(|i| {
                    let mut position = [0.5; 3];
                    position[a] = ((i % columns) as f32 + 0.5) / columns as f32;
                    position[b] = ((i / columns) as f32 + 0.5) / rows as f32;
                    Sphere { position, radius: radius(config, level as f64) }
                })
                .collect();
            bench.place(&spheres);
            let features = bench.features();
            for channel in 0..16 {
                let mean = |values: &mut dyn Iterator<Item = f32>, count: usize| {
                    values.map(f64::from).sum::<f64>() / count as f64
                };
                let expected = mean(&mut base.iter().skip(channel).step_by(16).copied(), base.len() / 16);
                let column = plane * 16 + channel;
                let texels = columns * rows;
                let found = mean(&mut (0..texels).map(|i| features[48 * i + column]), texels);
                assert!(
                    (found - expected).abs() < SUM_TOLERANCE,
                    "plane {plane}, level {level}, channel {channel}: mean {found}, not {expected}"
                );
            }
        }
    }
    Ok(())
}

/// From every level, the sum of the features' gradients reaches the base, and ⟨forward(p), g⟩ = ⟨p, backward(g)⟩.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn gradients<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for config in configurations() {
        gradients_of(make(), &config)?;
    }
    Ok(())
}

fn gradients_of<B: Backend>(backend: B, config: &Config) -> Result<()> {
    let layout = Layout::new(config);
    let parameters = lively(&layout, 4);
    let mut bench = Bench::new(backend, config, Some(crate::fixtures::noise(1, 8, 1, 1)), &parameters)?;
    let mut random = TestRandom::new(8);
    let base = layout.slots[0].range.len();
    for level in 0..config.encoder.levels {
        let spheres: Vec<Sphere> = (0..203)
            .map(|_| Sphere {
                position: [0; 3].map(|_| random.between(0.0, 1.0) as f32),
                radius: radius(config, f64::from(level) + random.between(0.0, 1.0)),
            })
            .collect();
        bench.place(&spheres);
        let features = bench.features();
        // Padding rows, if a backend has them, belong to no sample: they must not contribute.
        let upstream: Vec<f32> = features.iter().map(|_| random.between(-1.0, 1.0) as f32).collect();
        let Bench { backend, stages, workspace, parameters: values } = &mut bench;
        backend.write(&mut workspace.feature_gradients, &upstream);
        let mut partials = [PartialGradients {
            field: stages.field.gradient(),
            encoder: stages.encoder.gradient(),
            sums: B::Sums::default(),
        }];
        let (partial, rays, samples) = (&mut partials[0].encoder, &workspace.rays, &workspace.samples);
        let tile = &mut Tile { stream: &mut workspace.stream, parameters: values, rays, samples };
        stages.encoder.backward(tile, &workspace.encoder_context, &workspace.feature_gradients, partial);
        let mut gradient = backend.zeros(layout.len());
        backend.install(|| stages.encoder.reduce(&mut partials, values, &mut gradient));
        let gradient = wide(&backend.read(&gradient)[..base]);

        let counted = 48 * spheres.len();
        for column in 0..48 {
            let (plane, channel) = (column / 16, column % 16);
            let texels = AXES.map(|[a, b]| sides(config)[a] * sides(config)[b]);
            let part = &gradient[texels[..plane].iter().sum::<usize>() * 16..][..texels[plane] * 16];
            let found: f64 = part.iter().skip(channel).step_by(16).sum();
            let deposited = upstream[..counted].iter().skip(column).step_by(48);
            let expected: f64 = deposited.clone().map(|&g| f64::from(g)).sum();
            let size: f64 = deposited.map(|&g| f64::from(g).abs()).sum();
            assert!(
                (found - expected).abs() < SUM_TOLERANCE * size,
                "level {level}, feature {column}: {found} arrived, not {expected}"
            );
        }
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let forward = dot(&wide(&features[..counted]), &wide(&upstream[..counted]));
        let backward = dot(&wide(&parameters[..base]), &gradient);
        // Both are sums of about 10,000 products of order 0.3, each with an error of 1e-6 of random sign.
        assert!((forward - backward).abs() < 1e-3, "level {level}: {forward} forward, {backward} backward");
        // Reducing empties the partial gradients: a second reduce adds nothing.
        let mut again = backend.zeros(layout.len());
        backend.install(|| stages.encoder.reduce(&mut partials, values, &mut again));
        assert!(
            backend.read(&again)[..base].iter().all(|&g| g == 0.0),
            "level {level}: partial gradients are emptied"
        );
    }
    Ok(())
}
