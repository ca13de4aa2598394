//! A model in f64, one ray at a time: the reference for errors of rendering. It is slow and takes no shortcuts except the
//! occupancy grid, which is part of the model.

use crate::activation::{density, sigmoid};
use crate::cones::Division;
use crate::encoders::{self, Place, Twin};
use crate::model::{Model, OCCUPANCY};
use crate::occupancy::cell_of;
use crate::params::harmonics;
use crate::sh::spherical_harmonics;
use crate::{Camera, Cone, Layout, Result, Space};
use glam::DVec3;

/// Transmittance below which nothing is visible in f64.
const OPAQUE: f64 = 1e-13;

/// A model ready to be evaluated.
pub struct Exact {
    space: Space<f64>,
    centre: DVec3,
    encoder: Box<dyn Twin>,
    density: Vec<Layer>,
    color: Vec<Layer>,
    /// Spherical harmonics that the colour network sees.
    harmonics: usize,
    occupancy: Vec<u8>,
    resolution: u32,
    division: Division,
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
    /// Prepares a model.
    ///
    /// # Errors
    /// When a tensor is missing or has another shape.
    pub fn new(model: &Model) -> Result<Self> {
        let (config, centre) = model.config.centred();
        let layout = Layout::new(&config);
        let values: Vec<f64> =
            layout.from_tensors(&model.file, "model", "")?.into_iter().map(f64::from).collect();
        let space = Space::<f64>::new(&config.scene);
        let own = layout.encoder().iter().map(|slot| values[slot.range.clone()].to_vec()).collect();
        let encoder = encoders::of(&config).twin(&config, own);
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
            harmonics: harmonics(&config),
            occupancy,
            resolution,
            division: Division::new(&config),
            background: config.data.background.map(f64::from),
            diagonal: space.aabb().longest() * 3_f64.sqrt(),
            space,
            encoder,
        })
    }

    /// Colour of pixel (`x`, `y`) on the configured background, the mean of its cones, each marched with `steps` steps
    /// along the diagonal.
    pub fn pixel(&self, camera: &Camera, x: u32, y: u32, steps: u32) -> [f64; 3] {
        let camera = Camera { origin: camera.origin - self.centre, ..*camera };
        let side = self.division.side(&camera);
        let count = side * side;
        let cones = (0..count).map(|i| self.cone(&camera.cone_in(x, y, i, side), steps));
        cones.fold([0.0; 3], |sum, rgb| std::array::from_fn(|c| sum[c] + rgb[c] / f64::from(count)))
    }

    /// Colour of one cone, its apex relative to the centre of the box.
    fn cone(&self, cone: &Cone<f64>, steps: u32) -> [f64; 3] {
        let course = self.space.course(cone.origin, cone.direction);
        let (enter, leave) = course.range();
        let step = self.diagonal / f64::from(steps);
        let harmonics = spherical_harmonics(cone.direction);
        let (mut rgb, mut depth) = ([0.0; 3], 0.0_f64);
        let count = ((leave - enter) / step + 0.5).floor().max(0.0) as u64;
        for i in 0..count {
            let s = enter + (i as f64 + 0.5) * step;
            let t = course.distance(s);
            let point = std::array::from_fn(|axis| cone.origin[axis] + t * cone.direction[axis]);
            let position = self.space.to_cube(point);
            if s >= leave || !self.occupied(position) {
                continue;
            }
            let radius = cone.slope * t * self.space.scale(point);
            let length = course.length(t, step) * self.space.density_scale(point);
            let at = Place { position, radius, direction: cone.direction, t, length };
            let geometry = run(&self.density, self.features(&at));
            let own = density(geometry[0]) * length;
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

    /// Density per world unit and colour of a sample with these features, seen along a unit direction.
    pub fn radiance(&self, features: &[f64], direction: [f64; 3]) -> (f64, [f64; 3]) {
        let geometry = run(&self.density, features.to_vec());
        (density(geometry[0]), self.color(&spherical_harmonics(direction), &geometry))
    }

    fn color(&self, harmonics: &[f64], geometry: &[f64]) -> [f64; 3] {
        let mut input = harmonics[..self.harmonics].to_vec();
        input.extend_from_slice(&geometry[1..]);
        let logits = run(&self.color, input);
        [0, 1, 2].map(|c| sigmoid(logits[c]))
    }

    /// Features of a sample.
    pub fn features(&self, at: &Place) -> Vec<f64> {
        self.encoder.features(at)
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
