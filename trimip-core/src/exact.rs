//! A model in f64, one ray at a time: what the stages approximate. Slow, and free of all their shortcuts but the occupancy
//! grid, which belongs to the model; made to measure errors by.

use crate::activation::{density, sigmoid};
use crate::model::{Model, OCCUPANCY};
use crate::occupancy::cell_of;
use crate::sh::spherical_harmonics;
use crate::tri_mip::{CHANNELS, FEATURES, PLANE_AXES, Pyramid, taps};
use crate::{Aabb, Camera, Error, Layout, Result};
use glam::DVec3;

/// Transmittance behind which nothing can be seen in f64.
const OPAQUE: f64 = 1e-13;

/// A model ready to be evaluated.
pub struct Exact {
    aabb: Aabb<f64>,
    centre: DVec3,
    pyramid: Pyramid,
    /// Level 0, then the levels above it in one array.
    base: Vec<f64>,
    derived: Vec<f64>,
    density: Vec<Layer>,
    color: Vec<Layer>,
    /// The colour network sees the direction.
    directions: bool,
    occupancy: Vec<u8>,
    resolution: u32,
    background: [f64; 3],
    /// Longest side · √3: what a run's steps divide.
    diagonal: f64,
}

/// Weights [inputs, outputs].
struct Layer {
    outputs: usize,
    weights: Vec<f64>,
}

impl Exact {
    /// Takes a model apart.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn new(model: &Model) -> Result<Self> {
        let (config, centre) = model.config.centred();
        let layout = Layout::new(&config);
        let values: Vec<f64> =
            layout.from_tensors(&model.file, "model", "")?.into_iter().map(f64::from).collect();
        let aabb = Aabb::<f64>::new(&config.scene);
        let pyramid = Pyramid::new(&config.encoder, &aabb);
        let base =
            values.get(..pyramid.base_len()).ok_or_else(|| Error::run("a model without planes"))?.to_vec();
        let mut derived = vec![0.0; pyramid.derived_len()];
        for level in 1..pyramid.levels {
            for plane in 0..3 {
                let (shape, to) = (pyramid.shape(level, plane), pyramid.offset(level, plane));
                let from = pyramid.offset(level - 1, plane);
                for i in 0..shape.texels() * CHANNELS {
                    let (texel, channel) = (i / CHANNELS, i % CHANNELS);
                    let (row, column) = (texel / shape.columns, texel % shape.columns);
                    let child = |j: usize, k: usize| {
                        let at = (2 * row + j) * 2 * shape.columns + 2 * column + k;
                        let finer = if level == 1 { &base } else { &derived };
                        finer[from + at * CHANNELS + channel]
                    };
                    let mean = 0.25 * (child(0, 0) + child(0, 1) + child(1, 0) + child(1, 1));
                    derived[to + i] = mean;
                }
            }
        }
        let network = |name: &str| {
            let layer = |slot: &crate::params::Slot| Layer {
                outputs: slot.shape[1],
                weights: values[slot.range.clone()].to_vec(),
            };
            layout.network(name).map(layer).collect::<Vec<_>>()
        };
        let resolution = config.occupancy.resolution;
        let cells = (resolution as usize).pow(3);
        let occupancy = model.file.u8("model", OCCUPANCY, &[cells.div_ceil(8)])?.to_vec();
        Ok(Self {
            centre,
            density: network("density"),
            color: network("color"),
            directions: config.field.directions,
            base,
            derived,
            occupancy,
            resolution,
            background: config.data.background.map(f64::from),
            diagonal: aabb.longest() * 3_f64.sqrt(),
            aabb,
            pyramid,
        })
    }

    /// Colour of pixel (`x`, `y`) on the configured background, marched with `steps` steps along the diagonal.
    pub fn pixel(&self, camera: &Camera, x: u32, y: u32, steps: u32) -> [f64; 3] {
        let camera = Camera { origin: camera.origin - self.centre, ..*camera };
        let cone = camera.cone::<f64>(x, y);
        let (enter, leave) = self.aabb.intersect(cone.origin, cone.direction);
        let (step, extent) = (self.diagonal / f64::from(steps), self.aabb.extent());
        let harmonics = spherical_harmonics(cone.direction);
        let (mut rgb, mut depth) = ([0.0; 3], 0.0_f64);
        let count = ((leave - enter) / step + 0.5).floor().max(0.0) as u64;
        for i in 0..count {
            let t = enter + (i as f64 + 0.5) * step;
            let position: [f64; 3] = std::array::from_fn(|axis| {
                (cone.origin[axis] + t * cone.direction[axis] - self.aabb.min[axis]) / extent[axis]
            });
            if t >= leave || !self.occupied(position) {
                continue;
            }
            let geometry = run(&self.density, self.features(position, cone.slope * t));
            let own = density(geometry[0]) * step;
            let before = (-depth).exp();
            depth += own;
            let weight = before * -(-own).exp_m1();
            if weight > OPAQUE {
                let color = self.color(&harmonics, &geometry);
                (0..3).for_each(|c| rgb[c] += weight * color[c]);
            }
            if before < OPAQUE {
                break;
            }
        }
        let left = (-depth).exp();
        std::array::from_fn(|c| rgb[c] + left * self.background[c])
    }

    fn occupied(&self, position: [f64; 3]) -> bool {
        let cell = cell_of(position.map(|p| p as f32), self.resolution) as usize;
        self.occupancy[cell / 8] >> (cell % 8) & 1 == 1
    }

    /// Density per world unit and colour of a sample with these 48 features, seen along a unit direction.
    pub fn radiance(&self, features: &[f64], direction: [f64; 3]) -> (f64, [f64; 3]) {
        let geometry = run(&self.density, features.to_vec());
        (density(geometry[0]), self.color(&spherical_harmonics(direction), &geometry))
    }

    fn color(&self, harmonics: &[f64], geometry: &[f64]) -> [f64; 3] {
        let mut input = if self.directions { harmonics.to_vec() } else { Vec::new() };
        input.extend_from_slice(&geometry[1..]);
        let logits = run(&self.color, input);
        [0, 1, 2].map(|c| sigmoid(logits[c]))
    }

    /// The 48 features of a sphere: its centre in coordinates of the unit box, its radius in world units.
    pub fn features(&self, position: [f64; 3], radius: f64) -> Vec<f64> {
        let mut features = vec![0.0; FEATURES];
        for (plane, [a, b]) in PLANE_AXES.into_iter().enumerate() {
            let blend = self.pyramid.blend(plane, radius.log2());
            for (level, share) in [(blend.lower, 1.0 - blend.fraction), (blend.lower + 1, blend.fraction)] {
                if share == 0.0 {
                    continue;
                }
                let shape = self.pyramid.shape(level, plane);
                let levels = if level == 0 { &self.base } else { &self.derived };
                let texels = &levels[self.pyramid.range(level, plane)];
                let taps = taps(shape, position[a], position[b]);
                for (row, weights) in taps.rows.into_iter().zip(taps.weights) {
                    for (column, weight) in taps.columns.into_iter().zip(weights) {
                        let texel = &texels[(row * shape.columns + column) * CHANNELS..][..CHANNELS];
                        let out = &mut features[plane * CHANNELS..][..CHANNELS];
                        out.iter_mut().zip(texel).for_each(|(sum, value)| *sum += share * weight * value);
                    }
                }
            }
        }
        features
    }
}

/// Linear layers with ReLU between them.
fn run(layers: &[Layer], mut values: Vec<f64>) -> Vec<f64> {
    for (i, layer) in layers.iter().enumerate() {
        let mut sums = vec![0.0; layer.outputs];
        for (value, weights) in values.iter().zip(layer.weights.chunks_exact(layer.outputs)) {
            sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += value * weight);
        }
        if i + 1 < layers.len() {
            sums.iter_mut().for_each(|sum| *sum = sum.max(0.0));
        }
        values = sums;
    }
    values
}
