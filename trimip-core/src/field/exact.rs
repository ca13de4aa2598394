//! A model in f64, one ray at a time: the reference for rendering errors. It is slow and takes no shortcuts except the
//! occupancy grid, which is part of the model.

use crate::field::activation::{Color, Density};
use crate::field::encoders::{self, Reference, SamplePosition};
use crate::field::model::{Model, OCCUPANCY};
use crate::field::networks::{
    Network, append_frequencies, color_network, density_network, geometry_width, view,
};
use crate::geometry::camera::apex_distance;
use crate::geometry::occupancy::cell_of;
use crate::scene::cones::Division;
use crate::{Camera, Cone, Config, Layout, Result, Space, math::bits};
use glam::DVec3;

/// Transmittance below which nothing is visible in f64.
const OPAQUE: f64 = 1e-13;

/// A model ready to be evaluated.
pub struct Exact {
    config: Config,
    space: Space<f64>,
    centre: DVec3,
    encoder: Box<dyn Reference>,
    density: Weighted,
    color: Weighted,
    activation: Density,
    color_activation: Color,
    occupancy: Vec<u8>,
    resolution: u32,
    division: Division,
    background: [f64; 3],
    /// Longest side · √3; a marching step is this length divided by the number of steps.
    diagonal: f64,
}

/// A network and its parameters.
struct Weighted {
    network: Network,
    /// Weights [inputs, outputs] and biases of each layer.
    layers: Vec<[Vec<f64>; 2]>,
}

impl Weighted {
    fn new(network: Network, layout: &Layout, values: &[f64]) -> Self {
        let slots: Vec<_> = layout.network(network.name).map(|slot| &values[slot.range.clone()]).collect();
        let layers = match network.biases {
            true => slots.chunks_exact(2).map(|pair| [pair[0].to_vec(), pair[1].to_vec()]).collect(),
            false => slots.iter().map(|weights| [weights.to_vec(), Vec::new()]).collect(),
        };
        Self { network, layers }
    }

    fn run(&self, input: &[f64]) -> Vec<f64> {
        self.network.run(input, |layer| {
            let [weights, biases] = &self.layers[layer];
            (weights, biases)
        })
    }
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
        let encoder = encoders::of(&config).reference(&config, own);
        let resolution = config.occupancy.resolution;
        let cells = (resolution as usize).pow(3);
        let occupancy = model.file.u8("model", OCCUPANCY, &[cells.div_ceil(8)])?.to_vec();
        Ok(Self {
            centre,
            density: Weighted::new(density_network(&config), &layout, &values),
            color: Weighted::new(color_network(&config), &layout, &values),
            activation: Density::new(&config.field),
            color_activation: Color::new(&config),
            config: config.clone(),
            occupancy,
            resolution,
            division: Division::new(&config),
            background: config.data.background.map(f64::from),
            diagonal: space.aabb().longest() * 3_f64.sqrt(),
            space,
            encoder,
        })
    }

    /// Returns the colour of pixel (`x`, `y`) on the configured background: the mean of its cones, each marched with a
    /// step of `diagonal` / `steps`.
    pub fn pixel(&self, camera: &Camera, x: u32, y: u32, steps: u32) -> [f64; 3] {
        let camera = Camera { origin: camera.origin - self.centre, ..*camera };
        let pattern = self.division.pattern(&camera);
        let count = pattern.count();
        let cones = (0..count).map(|i| self.cone(&camera.cone_in(x, y, i, pattern), steps));
        cones.fold([0.0; 3], |sum, rgb| std::array::from_fn(|c| sum[c] + rgb[c] / f64::from(count)))
    }

    /// Returns the colour of one cone, whose apex is relative to the centre of the box.
    fn cone(&self, cone: &Cone<f64>, steps: u32) -> [f64; 3] {
        let parameterisation = self.space.parameterisation(cone.origin, cone.direction);
        let (enter, leave) = parameterisation.range();
        let step = self.diagonal / f64::from(steps);
        let view = view(&self.config, cone.direction);
        let (mut rgb, mut depth) = ([0.0; 3], 0.0_f64);
        // With deferred shading: the weighted sum of the samples' geometry, and the sum of the weights.
        let (mut features, mut opacity) = (Vec::new(), 0.0);
        let count = ((leave - enter) / step + 0.5).floor().max(0.0) as u64;
        for i in 0..count {
            let s = enter + (i as f64 + 0.5) * step;
            let t = parameterisation.distance(s);
            let point = std::array::from_fn(|axis| cone.origin[axis] + t * cone.direction[axis]);
            let position = self.space.to_cube(point);
            if s >= leave || !self.occupied(position) {
                continue;
            }
            let radius = cone.radius_at(t) * self.space.scale(point);
            let length = parameterisation.length(t, step) * self.space.density_scale(point);
            let at = SamplePosition {
                position,
                radius,
                direction: cone.direction,
                t: apex_distance(cone.radius, cone.slope, t),
                length,
            };
            let geometry = self.density.run(&self.features(&at));
            let own = self.activation.value(geometry[0]) * length;
            let before = (-depth).exp();
            depth += own;
            let weight = before * -(-own).exp_m1();
            if self.config.field.deferred {
                features.resize(geometry.len(), 0.0);
                features.iter_mut().zip(&geometry).for_each(|(sum, value)| *sum += weight * value);
                opacity += weight;
            } else if weight > OPAQUE && weight >= self.config.renderer.color_weight.at(1.0) {
                let color = self.color(&view, &geometry);
                (0..3).for_each(|c| rgb[c] += weight * color[c]);
            }
            if before < OPAQUE {
                break;
            }
        }
        if opacity > OPAQUE && opacity >= self.config.renderer.color_weight.at(1.0) {
            let mean: Vec<f64> = features.iter().map(|sum| sum / opacity).collect();
            rgb = self.color(&view, &mean).map(|value| opacity * value);
        }
        let left = (-depth).exp();
        std::array::from_fn(|c| rgb[c] + left * self.background[c])
    }

    fn occupied(&self, position: [f64; 3]) -> bool {
        let cell = cell_of(position.map(|p| p as f32), self.resolution) as usize;
        bits::is_set(&self.occupancy, cell)
    }

    /// Returns the density per world unit and colour of a sample with these features, seen along a unit direction.
    pub fn radiance(&self, features: &[f64], direction: [f64; 3]) -> (f64, [f64; 3]) {
        let geometry = self.density.run(features);
        (self.activation.value(geometry[0]), self.color(&view(&self.config, direction), &geometry))
    }

    fn color(&self, view: &[f64], geometry: &[f64]) -> [f64; 3] {
        if self.color_activation == Color::Clamped {
            return [1, 2, 3].map(|c| self.color_activation.value(geometry[c]));
        }
        let field = &self.config.field;
        let mut shape = geometry[1..].to_vec();
        shape.resize(geometry_width(&self.config), 0.0);
        append_frequencies(&mut shape, field.geometry as usize, field.geometry_frequencies);
        let logits = self.color.run(&[view, &shape].concat());
        [0, 1, 2].map(|c| self.color_activation.value(logits[c]))
    }

    /// Returns the features of a sample, [`width`](crate::field::encoders::Definition::width) numbers.
    pub fn features(&self, at: &SamplePosition) -> Vec<f64> {
        self.encoder.features(at)
    }
}
