//! The multiresolution hash grid written from its equations (Müller et al. 2022): per level, the eight corners of the
//! cell around a position, one after the other.

use super::{Literal, Sample};
use trimip_core::{Config, config::HashGridConfig};

/// A hash grid and its parameters.
pub struct HashGrid {
    config: HashGridConfig,
    table: Vec<f64>,
}

impl HashGrid {
    /// `table`: the entries of all levels, coarse to fine, `features` values each.
    pub fn new(config: &Config, table: Vec<f64>) -> Self {
        Self { config: config.hash_grid.clone(), table }
    }

    /// Number of cells across the box minus one, corners along a side, and entries of a level.
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

impl Literal for HashGrid {
    fn features(&self, &Sample { position, .. }: &Sample) -> Vec<f64> {
        let width = self.config.features as usize;
        let mut features = Vec::new();
        let mut first = 0;
        for level in 0..self.config.levels {
            let (scale, side, entries) = self.level(level);
            let mut sum = vec![0.0; width];
            for corner in 0..8_u64 {
                let (mut at, mut weight) = ([0_u64; 3], 1.0);
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
            features.extend(sum);
            first += entries;
        }
        features
    }
}
