//! Ripmapped planes written from their equations (Liu et al. 2024, Rip-NeRF; Barron et al. 2021, mip-NeRF).

use super::sample::{Literal, Sample};
use trimip_core::Config;

/// Channels of a texel.
const CHANNELS: usize = 16;

/// The planes and their parameters.
pub struct RipMap {
    config: Config,
    planes: Vec<Plane>,
}

struct Plane {
    axes: [[f64; 3]; 2],
    /// World width of the plane along each axis, around the middle of the box.
    widths: [f64; 2],
    /// Number of columns and of rows.
    sides: [usize; 2],
    /// Texels at level (0, 0), as [rows, columns, 16].
    texels: Vec<f64>,
}

/// Returns the normals of the planes; they are not of unit length.
fn normals(planes: u32) -> Vec<[f64; 3]> {
    let phi = (1.0 + 5_f64.sqrt()) / 2.0;
    let inverse = 1.0 / phi;
    match planes {
        3 => vec![[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        4 => vec![[1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0], [1.0, -1.0, -1.0]],
        6 => vec![
            [0.0, 1.0, phi],
            [phi, 0.0, 1.0],
            [1.0, phi, 0.0],
            [0.0, 1.0, -phi],
            [-phi, 0.0, 1.0],
            [1.0, -phi, 0.0],
        ],
        _ => vec![
            [1.0, 1.0, 1.0],
            [1.0, 1.0, -1.0],
            [1.0, -1.0, 1.0],
            [1.0, -1.0, -1.0],
            [0.0, phi, inverse],
            [inverse, 0.0, phi],
            [phi, inverse, 0.0],
            [0.0, phi, -inverse],
            [-inverse, 0.0, phi],
            [phi, -inverse, 0.0],
        ],
    }
}

fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

fn unit(a: [f64; 3]) -> [f64; 3] {
    let length = a.iter().map(|x| x * x).sum::<f64>().sqrt();
    a.map(|x| x / length)
}

impl RipMap {
    /// Creates the planes; `base` holds their level (0, 0), one plane after the other.
    pub fn new(config: &Config, base: Vec<f64>) -> Self {
        let extent = extent(config);
        let texel = extent.into_iter().fold(0.0, f64::max) / f64::from(config.rip_map.size);
        let mut rest = &base[..];
        let plane = |normal: [f64; 3]| {
            let z = [0.0, 0.0, 1.0];
            let axes = match unit(normal) {
                n if n == z => [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]],
                n => [unit(cross(z, n)), unit(cross(n, cross(z, n)))],
            };
            // A plane covers the projection of the box, with a number of texels that halves evenly at every level.
            let widths = axes.map(|axis| (0..3).map(|k| axis[k].abs() * extent[k]).sum::<f64>());
            let sides = widths.map(|width| {
                let enough = (1..).map(|i: usize| i << (config.rip_map.levels - 1));
                enough.into_iter().find(|&texels| texels as f64 + 0.02 > width / texel).unwrap_or(1)
            });
            let (own, others) = rest.split_at(sides[0] * sides[1] * CHANNELS);
            rest = others;
            Plane { axes, widths, sides, texels: own.to_vec() }
        };
        Self {
            planes: normals(config.rip_map.planes).into_iter().map(plane).collect(),
            config: config.clone(),
        }
    }
}

fn extent(config: &Config) -> [f64; 3] {
    [0, 1, 2].map(|axis| f64::from(config.scene.aabb_max[axis]) - f64::from(config.scene.aabb_min[axis]))
}

impl Plane {
    /// Returns a texel of level (i, j): the mean of 2^i by 2^j texels of the base. Coordinates are clamped at the
    /// border.
    fn texel(&self, [i, j]: [usize; 2], column: f64, row: f64, channel: usize) -> f64 {
        let clamp = |at: f64, side: usize| at.clamp(0.0, side as f64 - 1.0) as usize;
        let (column, row) = (clamp(column, self.sides[0] >> i), clamp(row, self.sides[1] >> j));
        let mut sum = 0.0;
        for r in row << j..(row + 1) << j {
            for c in column << i..(column + 1) << i {
                sum += self.texels[(r * self.sides[0] + c) * CHANNELS + channel];
            }
        }
        sum / f64::from(1 << (i + j))
    }

    /// Returns one channel of a level at a position in [0, 1]².
    fn bilinear(&self, levels: [usize; 2], at: [f64; 2], channel: usize) -> f64 {
        let [x, y] = [0, 1].map(|a| at[a] * (self.sides[a] >> levels[a]) as f64 - 0.5);
        let (column, row) = (x.floor(), y.floor());
        let (u, v) = (x - column, y - row);
        let texel = |c, r| self.texel(levels, column + c, row + r, channel);
        (1.0 - v) * ((1.0 - u) * texel(0.0, 0.0) + u * texel(1.0, 0.0))
            + v * ((1.0 - u) * texel(0.0, 1.0) + u * texel(1.0, 1.0))
    }
}

impl Literal for RipMap {
    fn features(&self, sample: &Sample) -> Vec<f64> {
        let (t, half, d) = (sample.apex, sample.length / 2.0, sample.direction);
        let extent = extent(&self.config);
        // mip-NeRF, Eq. 7, with the cone's radius at t instead of at distance 1.
        let (mut mean, mut along, mut across) = (0.0, half * half / 3.0, sample.radius.powi(2) / 4.0);
        if t > 0.0 {
            let sum = 3.0 * t * t + half * half;
            mean = 2.0 * t * half * half / sum;
            along -= 4.0 / 15.0 * half.powi(4) * (12.0 * t * t - half * half) / (sum * sum);
            let slope = sample.radius / t;
            across =
                slope * slope * (t * t / 4.0 + 5.0 / 12.0 * half * half - 4.0 / 15.0 * half.powi(4) / sum);
        }
        let mut features = Vec::new();
        for plane in &self.planes {
            let (mut at, mut levels) = ([0.0; 2], [0.0; 2]);
            for a in 0..2 {
                let axis = plane.axes[a];
                let dot = |v: [f64; 3]| (0..3).map(|k| axis[k] * v[k]).sum::<f64>();
                let from_middle: [f64; 3] =
                    std::array::from_fn(|k| (sample.position[k] - 0.5) * extent[k] + mean * d[k]);
                at[a] = dot(from_middle) / plane.widths[a] + 0.5;
                // Σ = across (I − d dᵀ) + along d dᵀ; a level is log2(4σ / texel), with σ² the variance along the axis.
                let variance = across * (1.0 - dot(d).powi(2)) + along * dot(d).powi(2);
                let texel = plane.widths[a] / plane.sides[a] as f64;
                let level =
                    (4.0 * variance.sqrt() / texel).log2() + f64::from(self.config.rip_map.level_bias);
                levels[a] = level.clamp(0.0, f64::from(self.config.rip_map.levels - 1));
            }
            let lower = levels.map(|level| level.floor() as usize);
            let top = self.config.rip_map.levels as usize - 1;
            for channel in 0..CHANNELS {
                let mut sum = 0.0;
                for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                    let level_weight = |a: usize, upper: usize| {
                        let fraction = levels[a] - lower[a] as f64;
                        if upper == 1 { fraction } else { 1.0 - fraction }
                    };
                    let level = [(lower[0] + i).min(top), (lower[1] + j).min(top)];
                    sum += level_weight(0, i) * level_weight(1, j) * plane.bilinear(level, at, channel);
                }
                features.push(sum);
            }
        }
        features
    }
}
