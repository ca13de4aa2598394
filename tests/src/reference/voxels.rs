//! A grid of densities and spherical harmonics from its definition (Fridovich-Keil et al. 2022, Section 3). Densities and
//! coefficients are interpolated trilinearly between grid points; the first and the last grid point lie on the border of the box.
//! A colour is the sum of its coefficients times the basis in the direction of the ray.

use super::harmonics;
use super::sample::{Literal, Sample};
use trimip_core::Config;

/// The grid with its densities and coefficients.
pub struct Voxels {
    /// Number of grid points along x, y and z.
    sides: [usize; 3],
    harmonics: usize,
    density: Vec<f64>,
    colors: Vec<f64>,
}

impl Voxels {
    /// Creates the grid at its full size; `slots` holds the values of the encoder's slots.
    pub fn new(config: &Config, slots: Vec<Vec<f64>>) -> Self {
        let side = config.voxels.sides.values().last().unwrap_or(0.0);
        let length =
            |axis: usize| f64::from(config.scene.aabb_max[axis]) - f64::from(config.scene.aabb_min[axis]);
        // side³ cubic cells fill the box.
        let cell = (length(0) * length(1) * length(2)).cbrt() / side;
        let sides = [0, 1, 2].map(|axis| ((length(axis) / cell + 1e-6).floor() as usize).max(2));
        let mut slots = slots.into_iter();
        let mut next = || slots.next().unwrap_or_default();
        let harmonics = (config.voxels.harmonics as usize).pow(2);
        Self { sides, harmonics, density: next(), colors: next() }
    }
}

impl Literal for Voxels {
    fn features(&self, &Sample { position, direction, .. }: &Sample) -> Vec<f64> {
        let basis = harmonics(direction);
        let mut features = vec![0.0; 4];
        let [x, y, z] = self.sides;
        let hat = |axis: usize, i: usize| {
            let last = self.sides[axis] - 1;
            (1.0 - (position[axis] * last as f64 - i as f64).abs()).max(0.0)
        };
        for (i, j, k) in (0..z).flat_map(|k| (0..y).flat_map(move |j| (0..x).map(move |i| (i, j, k)))) {
            let weight = hat(0, i) * hat(1, j) * hat(2, k);
            let point = (k * y + j) * x + i;
            if weight > 0.0 {
                features[0] += weight * self.density[point];
                for c in 0..3 {
                    for l in 0..self.harmonics {
                        let value = self.colors[point * 3 * self.harmonics + c * self.harmonics + l];
                        features[1 + c] += weight * value * basis[l];
                    }
                }
            }
        }
        features
    }
}
