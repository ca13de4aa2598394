//! Tri-MipRF as its equations, in f64, slow and plain: no packing, no skipping, no fused form. Positions are those of
//! the unit box, radii and distances world units. Letters: σ density, δ interval, T transmittance, α opacity of a sample.

use trimip_core::{
    Config, Layout,
    batch::{Ray, Target},
    config::{LevelFormula, LossRays, PlaneShape},
    sh::spherical_harmonics,
};

/// Channels of a texel.
const CHANNELS: usize = 16;

/// Axes of each plane: along a row of texels, and across.
pub const AXES: [[usize; 2]; 3] = [[1, 2], [0, 2], [0, 1]];

/// The model with parameters of its own.
pub struct Reference {
    config: Config,
    /// Level by level: planes YZ, XZ, XY one after the other, [rows, columns, 16] each.
    levels: Vec<Vec<f64>>,
    /// Texels along x, y and z at level 0.
    sides: [usize; 3],
    density: Vec<Layer>,
    color: Vec<Layer>,
}

/// A linear layer without bias, weights [inputs, outputs].
struct Layer {
    outputs: usize,
    weights: Vec<f64>,
}

/// A sample of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Distance along the ray.
    pub t: f64,
    /// Length of its interval, δ.
    pub length: f64,
    /// Centre of its sphere, unit box.
    pub position: [f64; 3],
    /// Radius of its sphere.
    pub radius: f64,
}

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
    /// The model of a configuration with flat parameters.
    pub fn new(config: &Config, layout: &Layout, parameters: &[f64]) -> Self {
        let encoder = &config.encoder;
        let sides = sides(config);
        let mut levels = vec![parameters[layout.slots[0].range.clone()].to_vec()];
        for level in 1..if encoder.mipmap { encoder.levels as usize } else { 1 } {
            levels.push(halved(&levels[level - 1], sides.map(|side| side >> level)));
        }
        let network = |name: &str| {
            let layer = |slot: &trimip_core::params::Slot| Layer {
                outputs: slot.shape[1],
                weights: parameters[slot.range.clone()].to_vec(),
            };
            layout.network(name).map(layer).collect::<Vec<_>>()
        };
        Self { levels, sides, density: network("density"), color: network("color"), config: config.clone() }
    }

    /// The 48 features of a sphere: planes YZ, XZ, XY, each trilinear between texels and levels.
    pub fn features(&self, position: [f64; 3], radius: f64) -> Vec<f64> {
        let mut features = Vec::new();
        for (plane, [a, b]) in AXES.into_iter().enumerate() {
            let scene = &self.config.scene;
            let extent = |axis: usize| f64::from(scene.aabb_max[axis]) - f64::from(scene.aabb_min[axis]);
            // Eq. 5: l = log2(r / r̈), r̈ = sqrt(extent_a·extent_b / (H·W·π)); the authors' code has r̈ = texel/2.
            let area = extent(a) * extent(b) / (self.sides[a] * self.sides[b]) as f64;
            let base = match self.config.encoder.level {
                LevelFormula::Paper => (area / std::f64::consts::PI).sqrt(),
                LevelFormula::Code => 0.5 * area.sqrt(),
            };
            let level = (radius / base).log2().clamp(0.0, (self.levels.len() - 1) as f64);
            let (lower, fraction) = (level.floor() as usize, level - level.floor());
            let upper = (lower + 1).min(self.levels.len() - 1);
            for channel in 0..CHANNELS {
                let read = |level| self.bilinear(level, plane, position[a], position[b], channel);
                features.push((1.0 - fraction) * read(lower) + fraction * read(upper));
            }
        }
        features
    }

    /// One channel of one level at (a, b): texel centres at (i + 0.5)/N, clamped at the border.
    fn bilinear(&self, level: usize, plane: usize, a: f64, b: f64, channel: usize) -> f64 {
        let sides = self.sides.map(|side| side >> level);
        let [columns, rows] = AXES[plane].map(|axis| sides[axis]);
        let before: usize = AXES[..plane].iter().map(|&[a, b]| sides[a] * sides[b]).sum();
        let texel = |row: f64, column: f64| {
            let clamp = |i: f64, side: usize| i.clamp(0.0, side as f64 - 1.0) as usize;
            let texel = before + clamp(row, rows) * columns + clamp(column, columns);
            self.levels[level][texel * CHANNELS + channel]
        };
        let (x, y) = (a * columns as f64 - 0.5, b * rows as f64 - 0.5);
        let (column, row) = (x.floor(), y.floor());
        let (u, v) = (x - column, y - row);
        (1.0 - v) * ((1.0 - u) * texel(row, column) + u * texel(row, column + 1.0))
            + v * ((1.0 - u) * texel(row + 1.0, column) + u * texel(row + 1.0, column + 1.0))
    }

    /// The density network's outputs: the logit, then 15 geometry features.
    pub fn geometry(&self, features: &[f64]) -> Vec<f64> {
        network(&self.density, features)
    }

    /// Density of a logit.
    pub fn density(&self, geometry: &[f64]) -> f64 {
        (geometry[0] - 1.0).exp()
    }

    /// Colour seen along a unit direction.
    pub fn color(&self, geometry: &[f64], direction: [f64; 3]) -> [f64; 3] {
        let mut input =
            if self.config.field.directions { spherical_harmonics(direction).to_vec() } else { Vec::new() };
        input.extend_from_slice(&geometry[1..]);
        let logits = network(&self.color, &input);
        [0, 1, 2].map(|c| 1.0 / (1.0 + (-logits[c]).exp()))
    }

    /// Density of each of a ray's samples.
    pub fn densities(&self, samples: &[Sample]) -> Vec<f64> {
        let density = |s: &Sample| self.density(&self.geometry(&self.features(s.position, s.radius)));
        samples.iter().map(density).collect()
    }

    /// Composites the samples of a ray on the configured background.
    pub fn pixel(&self, ray: &Ray, samples: &[Sample]) -> Composited {
        self.pixel_on(ray, samples, self.config.data.background)
    }

    /// Composites the samples of a ray on a background.
    pub fn pixel_on(&self, ray: &Ray, samples: &[Sample], background: [f32; 3]) -> Composited {
        let direction = ray.direction.map(f64::from);
        let radiance: Vec<_> = samples
            .iter()
            .map(|sample| {
                let geometry = self.geometry(&self.features(sample.position, sample.radius));
                (self.density(&geometry), self.color(&geometry, direction))
            })
            .collect();
        composite(samples, &radiance, background.map(f64::from), ray.cosine.into())
    }

    /// The loss over rays whose samples (kept ones only) are given: Σ weight·(mean of smooth-L1 + that of opacity), over Σ weight of the
    /// rays that count.
    pub fn loss(&self, rays: &[(Ray, Target, Vec<Sample>)]) -> f64 {
        let (beta, mut loss, mut weights) = (f64::from(self.config.loss.beta), 0.0, 0.0);
        let smooth_l1 = |d: f64| if d < beta { d * d / (2.0 * beta) } else { d - beta / 2.0 };
        for (ray, target, samples) in rays {
            if self.config.loss.rays == LossRays::Live && samples.is_empty() {
                continue;
            }
            let pixel = self.pixel_on(ray, samples, target.background);
            let weight = f64::from(target.weight);
            weights += weight;
            for c in 0..3 {
                let d = (pixel.rgb[c] - f64::from(target.rgb[c])).abs();
                loss += weight / 3.0 * smooth_l1(d);
            }
            let share = f64::from(self.config.loss.opacity);
            loss += weight * share * smooth_l1((pixel.opacity - f64::from(target.opacity)).abs());
        }
        loss / weights
    }
}

/// Every texel the mean of its 2×2 children; `sides` are the result's texels along x, y and z.
fn halved(fine: &[f64], sides: [usize; 3]) -> Vec<f64> {
    let mut coarse = Vec::new();
    let mut start = 0;
    for [a, b] in AXES {
        let (columns, rows) = (sides[a], sides[b]);
        for (row, column) in (0..rows * columns).map(|i| (i / columns, i % columns)) {
            for channel in 0..CHANNELS {
                let child = |j: usize, i: usize| {
                    let texel = start + (2 * row + j) * 2 * columns + 2 * column + i;
                    fine[texel * CHANNELS + channel]
                };
                coarse.push((child(0, 0) + child(0, 1) + child(1, 0) + child(1, 1)) / 4.0);
            }
        }
        start += 4 * rows * columns;
    }
    coarse
}

/// Texels along the box's axes at level 0: `plane_size` along each, or square ones, a multiple of what halves evenly.
pub fn sides(config: &Config) -> [usize; 3] {
    let size = config.encoder.plane_size as usize;
    let extent =
        [0, 1, 2].map(|axis| f64::from(config.scene.aabb_max[axis]) - f64::from(config.scene.aabb_min[axis]));
    let texel = extent.into_iter().fold(0.0, f64::max) / size as f64;
    match config.encoder.shape {
        PlaneShape::Square => [size; 3],
        PlaneShape::Box => extent.map(|side| {
            let enough = (1..).map(|i| i << (config.encoder.levels - 1));
            enough.into_iter().find(|&texels| texels as f64 + 0.02 > side / texel).unwrap_or(size)
        }),
    }
}

/// Linear layers with ReLU between them.
fn network(layers: &[Layer], input: &[f64]) -> Vec<f64> {
    let mut values = input.to_vec();
    for (i, layer) in layers.iter().enumerate() {
        let sum = |j: usize| -> f64 {
            values.iter().zip(layer.weights.iter().skip(j).step_by(layer.outputs)).map(|(x, w)| x * w).sum()
        };
        let outputs = (0..layer.outputs).map(sum).collect::<Vec<_>>();
        let last = i + 1 == layers.len();
        values = outputs.into_iter().map(|x| if last { x } else { x.max(0.0) }).collect();
    }
    values
}

/// C = Σ T·α·c + (1 − Σ T·α)·background with T_i = exp(−Σ_{k<i} σ_k·δ_k), α = 1 − exp(−σ·δ).
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

/// Distances at which a ray enters (not before its origin) and leaves the box.
pub fn span(config: &Config, origin: [f64; 3], direction: [f64; 3]) -> Option<(f64, f64)> {
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

/// World length of a marching step: longest side · √3 / steps.
pub fn step_length(config: &Config) -> f64 {
    let scene = &config.scene;
    let side = |axis: usize| f64::from(scene.aabb_max[axis]) - f64::from(scene.aabb_min[axis]);
    side(0).max(side(1)).max(side(2)) * 3.0_f64.sqrt() / f64::from(config.renderer.steps_per_diagonal)
}

/// World length of a ray's step: the uniform step times its scale at `progress`, and at least so many radii of the
/// sphere (slope · t) in the middle between entering and leaving the box.
pub fn ray_step(config: &Config, ray: &Ray, progress: f64) -> f64 {
    let uniform = step_length(config) * config.renderer.step_scale.at(progress);
    let (enter, leave) =
        span(config, ray.origin.map(f64::from), ray.direction.map(f64::from)).unwrap_or((0.0, 0.0));
    let radius = f64::from(ray.slope) * (enter + leave) / 2.0;
    uniform.max(f64::from(config.renderer.step_per_radius) * radius)
}

/// The middles of all uniform steps in the box, `offset` of a step late; `occupied` is asked at every one of them.
pub fn march(config: &Config, ray: &Ray, offset: f64, occupied: impl Fn([f64; 3]) -> bool) -> Vec<Sample> {
    let (origin, direction) = (ray.origin.map(f64::from), ray.direction.map(f64::from));
    let mut samples = Vec::new();
    let Some((enter, leave)) = span(config, origin, direction) else { return samples };
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
            samples.push(Sample { t, length, position, radius: f64::from(ray.slope) * t });
        }
    }
    samples
}

/// Samples in front of which the transmittance is at least the configured minimum, and how close the decision was: the
/// smallest |ln T − ln T_min| over the samples.
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
