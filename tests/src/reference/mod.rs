//! The model written from its equations in f64, slow and simple: no packing, no skipping, no fused operations. Positions are in
//! the unit box, radii and distances in world units. σ is the density of a sample, δ the length of its interval, T its
//! transmittance, α its opacity.

mod adamw;
pub mod contraction;
mod frequencies;
mod harmonics;
mod hash_grid;
pub mod loss;
mod rip_map;
mod rounded;
mod sample;
mod tensor;
mod tri_mip;
mod voxels;

pub use adamw::{changes, moments};
pub use frequencies::Frequencies;
pub use harmonics::harmonics;
pub use hash_grid::HashGrid;
pub use rip_map::RipMap;
pub use rounded::{Gradient, bf16};
pub use sample::{Literal, Sample, step_length};
pub use tensor::Tensor;
pub use tri_mip::{AXES, TriMip, sides};
pub use voxels::Voxels;

use sample::{apex, radius};
use trimip_core::{
    Config, Layout,
    config::{DensityFunction, EncoderKind, LossRays, ViewEncoding},
    engine::batch::{Ray, Target},
    field::losses::RaySample,
};

/// The model and its parameters.
pub struct Reference {
    config: Config,
    encoder: Box<dyn Literal>,
    density: Vec<Layer>,
    color: Vec<Layer>,
}

/// A linear layer with weights [inputs, outputs]; `biases` is empty if the layer has none.
struct Layer {
    outputs: usize,
    weights: Vec<f64>,
    biases: Vec<f64>,
}

/// A cone and its kept samples.
pub type KeptCone = (Ray, Vec<Sample>);

/// A composited ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Composited {
    /// Colour on the background.
    pub rgb: [f64; 3],
    /// Σ w.
    pub opacity: f64,
    /// Σ w·t·cosθ.
    pub depth: f64,
}

impl Reference {
    /// Creates the model of a configuration from flat parameters.
    pub fn new(config: &Config, layout: &Layout, parameters: &[f64]) -> Self {
        let mut own = layout.encoder().iter().map(|slot| parameters[slot.range.clone()].to_vec());
        let all: Vec<Vec<f64>> = own.by_ref().collect();
        let first = all.first().cloned().unwrap_or_default();
        let encoder: Box<dyn Literal> = match config.encoder.kind {
            EncoderKind::TriMip => Box::new(TriMip::new(config, first)),
            EncoderKind::HashGrid => Box::new(HashGrid::new(config, first)),
            EncoderKind::RipMap => Box::new(RipMap::new(config, first)),
            EncoderKind::Tensor => Box::new(Tensor::new(config, all)),
            EncoderKind::Frequencies => Box::new(Frequencies::new(config)),
            EncoderKind::Voxels => Box::new(Voxels::new(config, all)),
        };
        let network = |name: &str| {
            let mut layers: Vec<Layer> = Vec::new();
            for slot in layout.network(name) {
                let values = parameters[slot.range.clone()].to_vec();
                match layers.last_mut() {
                    Some(layer) if slot.name.ends_with("bias") => layer.biases = values,
                    _ => layers.push(Layer { outputs: slot.shape[1], weights: values, biases: Vec::new() }),
                }
            }
            layers
        };
        Self { encoder, density: network("density"), color: network("color"), config: config.clone() }
    }

    /// Returns the features of a sample.
    pub fn features(&self, sample: &Sample) -> Vec<f64> {
        self.encoder.features(sample)
    }

    /// Returns the density network's outputs: the logit, then the geometry features.
    pub fn geometry(&self, features: &[f64]) -> Vec<f64> {
        if self.config.encoder.kind == EncoderKind::Tensor {
            // TensoRF: σ is a function of the sum of the density features; a matrix maps the colour features.
            let (density, color) = features.split_at(Tensor::density_features(&self.config));
            return [vec![density.iter().sum()], network(&self.density, color, None)].concat();
        }
        if self.config.encoder.kind == EncoderKind::Voxels {
            return features.to_vec();
        }
        let joined = self.config.field.joined as usize;
        network(&self.density, features, (joined > 0).then_some(joined))
    }

    /// Returns the density that follows from the logit, the first of `geometry`.
    pub fn density(&self, geometry: &[f64]) -> f64 {
        let field = &self.config.field;
        let x = geometry[0] - f64::from(field.density_shift);
        f64::from(field.density_scale)
            * match field.density {
                DensityFunction::Exp => x.exp(),
                DensityFunction::Softplus => (1.0 + x.exp()).ln(),
                DensityFunction::Relu => x.max(0.0),
            }
    }

    /// Returns the colour in a unit direction.
    pub fn color(&self, geometry: &[f64], direction: [f64; 3]) -> [f64; 3] {
        if self.config.encoder.kind == EncoderKind::Voxels {
            return [1, 2, 3].map(|c| (geometry[c] + 0.5).max(0.0));
        }
        let field = &self.config.field;
        let mut input = match (field.directions, field.view) {
            (false, _) => Vec::new(),
            (true, ViewEncoding::Harmonics) => {
                harmonics(direction)[..(field.harmonics as usize).pow(2)].to_vec()
            }
            (true, ViewEncoding::Frequencies) => frequencies(&direction, field.view_frequencies),
            (true, ViewEncoding::Voronoi) => voronoi(direction, field.view_sharpness.into()),
        };
        input.extend(frequencies(&geometry[1..], field.geometry_frequencies));
        let logits = network(&self.color, &input, None);
        [0, 1, 2].map(|c| 1.0 / (1.0 + (-logits[c]).exp()))
    }

    /// Returns the density of each sample of a ray.
    pub fn densities(&self, samples: &[Sample]) -> Vec<f64> {
        let density = |s: &Sample| self.density(&self.geometry(&self.features(s)));
        samples.iter().map(density).collect()
    }

    /// Composites the samples of a ray on the configured background.
    pub fn pixel(&self, ray: &Ray, samples: &[Sample]) -> Composited {
        self.pixel_on(ray, samples, self.config.data.background)
    }

    /// Composites the samples of a ray on a background.
    pub fn pixel_on(&self, ray: &Ray, samples: &[Sample], background: [f32; 3]) -> Composited {
        let direction = ray.direction.map(f64::from);
        let geometry: Vec<_> = samples.iter().map(|sample| self.geometry(&self.features(sample))).collect();
        let radiance = if self.config.field.deferred {
            self.deferred(samples, &geometry, direction)
        } else {
            let radiance = geometry.iter().map(|own| (self.density(own), self.color(own, direction)));
            self.without_faint(samples, radiance.collect())
        };
        composite(samples, &radiance, background.map(f64::from), ray.cosine.into())
    }

    /// Returns the density of each sample of a ray, with the colour of the ray: that of the mean of the samples' geometry,
    /// weighted with T·α (deferred shading). A ray of less opacity than `renderer.color_weight` is black.
    pub fn deferred(
        &self,
        samples: &[Sample],
        geometry: &[Vec<f64>],
        direction: [f64; 3],
    ) -> Vec<(f64, [f64; 3])> {
        let densities: Vec<f64> = geometry.iter().map(|own| self.density(own)).collect();
        let depth = |k: usize| densities[k] * samples[k].length;
        let weight = |i: usize| (-(0..i).map(depth).sum::<f64>()).exp() * -(-depth(i)).exp_m1();
        let weights: Vec<f64> = (0..samples.len()).map(weight).collect();
        let opacity: f64 = weights.iter().sum();
        let rgb = if opacity <= 0.0 || opacity < self.config.renderer.color_weight.at(1.0) {
            [0.0; 3]
        } else {
            let sum = |k: usize| weights.iter().zip(geometry).map(|(w, own)| w * own[k]).sum::<f64>();
            let mean: Vec<f64> = (0..geometry[0].len()).map(|k| sum(k) / opacity).collect();
            self.color(&mean, direction)
        };
        densities.into_iter().map(|density| (density, rgb)).collect()
    }

    /// Replaces the colour of a sample with black where its weight is below `renderer.color_weight`.
    fn without_faint(&self, samples: &[Sample], radiance: Vec<(f64, [f64; 3])>) -> Vec<(f64, [f64; 3])> {
        let least = self.config.renderer.color_weight.at(1.0);
        let depth = |k: usize| radiance[k].0 * samples[k].length;
        let weight = |i: usize| (-(0..i).map(depth).sum::<f64>()).exp() * (1.0 - (-depth(i)).exp());
        let shown = |i: usize| if weight(i) < least { [0.0; 3] } else { radiance[i].1 };
        (0..samples.len()).map(|i| (radiance[i].0, shown(i))).collect()
    }

    /// Returns the loss over pixels with the given cones and kept samples: Σ weight·(photometric term + pixel terms + ray terms),
    /// divided by Σ weight. With `LossRays::Live`, both sums leave out pixels without samples. A pixel is the mean of its cones,
    /// with the edge exponent of its photograph and exposure gains of 1.
    pub fn loss(&self, pixels: &[(Target, Vec<KeptCone>)]) -> f64 {
        let (config, mut loss, mut weights) = (&self.config, 0.0, 0.0);
        let with_rays = loss::has_ray_terms(config);
        for (target, seen) in pixels {
            if config.loss.rays == LossRays::Live && seen.iter().all(|(_, samples)| samples.is_empty()) {
                continue;
            }
            let cones: Vec<_> =
                seen.iter().map(|(ray, samples)| self.pixel_on(ray, samples, target.background)).collect();
            let mean =
                |pick: &dyn Fn(&Composited) -> f64| cones.iter().map(pick).sum::<f64>() / cones.len() as f64;
            let [r, g, b] = [0, 1, 2].map(|c| mean(&|cone| cone.rgb[c]));
            let pixel = [r, g, b, mean(&|cone| cone.opacity)];
            let weight = f64::from(target.weight);
            weights += weight;
            loss += weight * loss::of_pixel(config, pixel, target, [1.0; 3]);
            if with_rays {
                let cones: Vec<_> =
                    seen.iter().map(|(ray, samples)| self.ray_samples(ray, samples)).collect();
                loss += weight * loss::of_cones(config, target, &cones);
            }
        }
        loss / weights
    }

    /// Returns the samples of a ray with their optical depths, in the form that the ray terms of the loss read.
    fn ray_samples(&self, ray: &Ray, samples: &[Sample]) -> Vec<RaySample<f64>> {
        let of = |(sample, density): (&Sample, &f64)| {
            loss::ray_sample(&self.config, ray, sample, density * sample.length)
        };
        samples.iter().zip(&self.densities(samples)).map(of).collect()
    }
}

/// Returns the values x, and the sin and cos of 2^k·x for each k below `count` (NeRF, Eq. 4, without the factor π).
fn frequencies(values: &[f64], count: u32) -> Vec<f64> {
    let mut all = values.to_vec();
    for k in 0..count {
        let angle = |x: &f64| 2_f64.powi(k as i32) * x;
        all.extend(values.iter().map(|x| angle(x).sin()));
        all.extend(values.iter().map(|x| angle(x).cos()));
    }
    all
}

/// Returns exp(τ·s·d) / Σ exp(τ·s·d) for the 16 sites s of a Fibonacci lattice.
fn voronoi(direction: [f64; 3], sharpness: f64) -> Vec<f64> {
    let site = |i: f64| {
        let (z, azimuth) = (1.0 - (2.0 * i + 1.0) / 16.0, i * std::f64::consts::PI * (3.0 - 5_f64.sqrt()));
        let radius = (1.0 - z * z).sqrt();
        [radius * azimuth.cos(), radius * azimuth.sin(), z]
    };
    let cosine = |i| (0..3).map(|k| site(f64::from(i))[k] * direction[k]).sum::<f64>();
    let all: Vec<f64> = (0..16).map(|i| (sharpness * cosine(i)).exp()).collect();
    let sum: f64 = all.iter().sum();
    all.into_iter().map(|value| value / sum).collect()
}

/// Evaluates linear layers with ReLU between them. Layer `joined` also reads the input (a skip connection).
fn network(layers: &[Layer], input: &[f64], joined: Option<usize>) -> Vec<f64> {
    let mut values = input.to_vec();
    for (i, layer) in layers.iter().enumerate() {
        if joined == Some(i) {
            values.extend_from_slice(input);
        }
        let sum = |j: usize| -> f64 {
            let products =
                values.iter().zip(layer.weights.iter().skip(j).step_by(layer.outputs)).map(|(x, w)| x * w);
            products.sum::<f64>() + layer.biases.get(j).unwrap_or(&0.0)
        };
        let outputs = (0..layer.outputs).map(sum).collect::<Vec<_>>();
        let last = i + 1 == layers.len();
        values = outputs.into_iter().map(|x| if last { x } else { x.max(0.0) }).collect();
    }
    values
}

/// Composites samples: C = Σ T·α·c + (1 − Σ T·α)·background with T_i = exp(−Σ_{k<i} σ_k·δ_k), α = 1 − exp(−σ·δ).
pub fn composite(
    samples: &[Sample],
    radiance: &[(f64, [f64; 3])],
    background: [f64; 3],
    cosine: f64,
) -> Composited {
    let mut result = Composited { rgb: [0.0; 3], opacity: 0.0, depth: 0.0 };
    for i in 0..samples.len() {
        let before: f64 = (0..i).map(|k| radiance[k].0 * samples[k].length).sum();
        let weight = (-before).exp() * (1.0 - (-radiance[i].0 * samples[i].length).exp());
        for c in 0..3 {
            result.rgb[c] += weight * radiance[i].1[c];
        }
        result.opacity += weight;
        result.depth += weight * samples[i].t * cosine;
    }
    for c in 0..3 {
        result.rgb[c] += (1.0 - result.opacity) * background[c];
    }
    result
}

/// Returns the distances at which a ray enters the box (at least 0) and leaves it.
pub fn tile(config: &Config, origin: [f64; 3], direction: [f64; 3]) -> Option<(f64, f64)> {
    let (mut enter, mut leave) = (0.0_f64, f64::INFINITY);
    for axis in 0..3 {
        let below = f64::from(config.scene.aabb_min[axis]) - origin[axis];
        let above = f64::from(config.scene.aabb_max[axis]) - origin[axis];
        if direction[axis] == 0.0 {
            if below > 0.0 || above < 0.0 {
                return None;
            }
            continue;
        }
        let (a, b) = (below / direction[axis], above / direction[axis]);
        enter = enter.max(a.min(b));
        leave = leave.min(a.max(b));
    }
    (enter < leave).then_some((enter, leave))
}

/// Returns the world length of a ray's step: the uniform step times its scale at `progress`, but at least the configured number
/// of sphere radii at the midpoint between entering and leaving the box.
pub fn ray_step(config: &Config, ray: &Ray, progress: f64) -> f64 {
    let uniform = step_length(config) * config.renderer.step_scale.at(progress);
    let (enter, leave) =
        tile(config, ray.origin.map(f64::from), ray.direction.map(f64::from)).unwrap_or((0.0, 0.0));
    let radius = radius(ray, (enter + leave) / 2.0);
    uniform.max(f64::from(config.renderer.step_per_radius) * radius)
}

/// Returns samples at the midpoints of those uniform steps in the box, delayed by `offset` of a step, where `occupied` is true.
pub fn march(config: &Config, ray: &Ray, offset: f64, occupied: impl Fn([f64; 3]) -> bool) -> Vec<Sample> {
    let (origin, direction) = (ray.origin.map(f64::from), ray.direction.map(f64::from));
    let mut samples = Vec::new();
    let Some((enter, leave)) = tile(config, origin, direction) else { return samples };
    let length = ray_step(config, ray, 0.0);
    for i in 0.. {
        let t = enter + (offset + f64::from(i) + 0.5) * length;
        if t >= leave {
            return samples;
        }
        let position = [0, 1, 2].map(|axis| {
            let [low, high] = [config.scene.aabb_min[axis], config.scene.aabb_max[axis]].map(f64::from);
            (origin[axis] + t * direction[axis] - low) / (high - low)
        });
        if occupied(position) {
            let (apex, radius) = (apex(ray, t), radius(ray, t));
            samples.push(Sample { t, apex, length, position, radius, direction });
        }
    }
    samples
}

/// Returns the kept samples of a ray, and the margin of the closest decision: the smallest |ln T − ln T_min| or
/// |ln w − ln w_min|. A sample is kept if the transmittance in front of it and its weight both reach the configured minima; the
/// weight includes the samples that were dropped since the last kept one. A kept sample is returned as its index and the factor
/// by which its length grows to represent those samples.
pub fn visible(config: &Config, samples: &[Sample], densities: &[f64]) -> (Vec<(usize, f64)>, f64) {
    let [least, lightest] =
        [config.renderer.min_transmittance, config.renderer.min_weight].map(|limit| f64::from(limit).ln());
    let (mut log_transmittance, mut margin, mut kept) = (0.0_f64, f64::INFINITY, Vec::new());
    let mut faint = 0.0;
    for (i, (sample, density)) in samples.iter().zip(densities).enumerate() {
        let depth = density * sample.length;
        margin = margin.min((log_transmittance - least).abs());
        if log_transmittance < least {
            break;
        }
        faint += depth;
        let log_weight = log_transmittance + (1.0 - (-faint).exp()).ln();
        margin = margin.min((log_weight - lightest).abs());
        if log_weight >= lightest {
            kept.push((i, faint / depth));
            log_transmittance -= faint;
            faint = 0.0;
        }
    }
    (kept, margin)
}

/// Returns the number of leading samples in front of which the transmittance is at least the configured minimum, and the margin
/// of the decision: the smallest |ln T − ln T_min| over the samples.
pub fn kept(config: &Config, samples: &[Sample], densities: &[f64]) -> (usize, f64) {
    let limit = f64::from(config.renderer.min_transmittance).ln();
    let (mut log_transmittance, mut margin) = (0.0_f64, f64::INFINITY);
    for (i, (sample, density)) in samples.iter().zip(densities).enumerate() {
        margin = margin.min((log_transmittance - limit).abs());
        if log_transmittance < limit {
            return (i, margin);
        }
        log_transmittance -= density * sample.length;
    }
    (samples.len(), margin)
}
