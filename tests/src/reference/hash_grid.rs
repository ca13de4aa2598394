//! The multiresolution hash grid written from its equations (Müller et al. 2022): each level reads the eight corners of
//! the cell around a position, one after the other.

use super::sample::{Literal, Sample};
use glam::DVec3;
use trimip_core::{Config, config::HashGridConfig};

/// A hash grid and its parameters.
pub struct HashGrid {
    config: HashGridConfig,
    extent: [f64; 3],
    table: Vec<f64>,
}

impl HashGrid {
    /// Creates a hash grid; `table` holds the entries of all levels, coarse to fine, with `features` values each.
    pub fn new(config: &Config, table: Vec<f64>) -> Self {
        let side =
            |axis: usize| f64::from(config.scene.aabb_max[axis]) - f64::from(config.scene.aabb_min[axis]);
        Self { config: config.hash_grid.clone(), extent: [0, 1, 2].map(side), table }
    }

    /// Returns the scale of a level (its resolution minus one), the number of corners along a side, and the number of
    /// entries.
    fn level(&self, level: u32) -> (f64, u64, u64) {
        let HashGridConfig { levels, coarsest, finest, log2_entries, .. } = self.config;
        let growth = if levels > 1 {
            (f64::from(finest) / f64::from(coarsest)).powf(1.0 / f64::from(levels - 1))
        } else {
            1.0
        };
        // The backends store the scale in f32.
        let scale = f64::from((f64::from(coarsest) * growth.powi(level as i32) - 1.0) as f32);
        let side = (scale - 1e-4).ceil() as u64 + 1;
        let entries = (side.pow(3).div_ceil(8) * 8).min(1 << log2_entries);
        (scale, side, entries)
    }
}

/// Returns erf(x): by the Maclaurin series, or by the continued fraction for large x.
fn erf(x: f64) -> f64 {
    let unit = 2.0 / std::f64::consts::PI.sqrt();
    if x < 3.0 {
        let (mut term, mut sum) = (x, x);
        for n in 1..200 {
            term *= -x * x / f64::from(n);
            sum += term / f64::from(2 * n + 1);
        }
        return unit * sum;
    }
    let fraction = (1..60).rev().fold(x, |below, n| x + f64::from(n) / 2.0 / below);
    1.0 - (-x * x).exp() / std::f64::consts::PI.sqrt() / fraction
}

impl HashGrid {
    /// Returns the points at which a sample reads the grid, in the unit cube, and their standard deviations in units of
    /// the box's longest side (Zip-NeRF, Section 2).
    fn points(&self, sample: &Sample) -> Vec<([f64; 3], f64)> {
        let longest = self.extent.into_iter().fold(0.0, f64::max);
        let deviation = |radius: f64| 0.5 * radius / 2_f64.sqrt() / longest;
        if self.config.points == 1 {
            return vec![(sample.position, deviation(sample.radius))];
        }
        let d = DVec3::from(sample.direction);
        // Two directions perpendicular to the ray (Duff et al. 2017): the images of x and y under the rotation that
        // turns z or −z into the ray.
        let sign = if d.z < 0.0 { -1.0 } else { 1.0 };
        let turned = |e: DVec3| {
            let axis = DVec3::Z * sign + d;
            2.0 * axis * axis.dot(e) / axis.length_squared() - e
        };
        let (u, v) = (-turned(DVec3::X), -sign * turned(DVec3::Y));
        let (s, h) = (sample.apex, (0.5 * sample.length).min(sample.apex));
        let (t0, t1) = (s - h, s + h);
        let angles = [0.0, 2.0, 4.0, 3.0, 5.0, 1.0].map(|sixth| sixth * std::f64::consts::PI / 3.0);
        let point = |(j, angle): (usize, &f64)| {
            let root = ((h * h - s * s).powi(2) + 4.0 * s.powi(4)).sqrt();
            let offset = 3.0 / 7_f64.sqrt() * (2.0 * j as f64 / 5.0 - 1.0);
            let z = t0 + h / (h * h + 3.0 * s * s) * (t1 * t1 + 2.0 * s * s + offset * root);
            let radius = sample.radius / s * z;
            let offset = (z - s) * d + radius / 2_f64.sqrt() * (angle.cos() * u + angle.sin() * v);
            let place = [0, 1, 2].map(|i| (sample.position[i] + offset[i] / self.extent[i]).clamp(0.0, 1.0));
            (place, deviation(radius))
        };
        angles.iter().enumerate().map(point).collect()
    }
}

impl Literal for HashGrid {
    fn features(&self, sample: &Sample) -> Vec<f64> {
        let points = self.points(sample);
        let width = self.config.features as usize;
        let mut features = Vec::new();
        let mut first = 0;
        for level in 0..self.config.levels {
            let (scale, side, entries) = self.level(level);
            let mut sum = vec![0.0; width];
            for (position, deviation) in &points {
                let level_weight = match self.config.downweight {
                    true if *deviation > 0.0 => erf(1.0 / (8.0 * (deviation * (scale + 1.0)).powi(2)).sqrt()),
                    _ => 1.0,
                };
                for corner in 0..8_u64 {
                    let (mut at, mut weight) = ([0_u64; 3], level_weight / points.len() as f64);
                    for axis in 0..3 {
                        let place = position[axis] * scale + 0.5;
                        let upper = corner >> axis & 1;
                        at[axis] = place.floor() as u64 + upper;
                        let fraction = place - place.floor();
                        weight *= if upper == 1 { fraction } else { 1.0 - fraction };
                    }
                    let [x, y, z] = at;
                    let entry = if side.pow(3) > 1 << self.config.log2_entries {
                        let times = |a: u64, prime: u64| (a * prime) & 0xffff_ffff;
                        (x ^ times(y, 2_654_435_761) ^ times(z, 805_459_861)) % entries
                    } else {
                        (x + side * y + side * side * z) % entries
                    };
                    for (f, sum) in sum.iter_mut().enumerate() {
                        *sum += weight * self.table[(first + entry) as usize * width + f];
                    }
                }
            }
            features.extend(sum);
            first += entries;
        }
        features
    }
}
