//! Factored tensors from their definition (Chen et al. 2022, Eq. 3 and 8). A VM component is the outer product of a matrix over
//! two axes and a vector over the third; a CP component is the outer product of three vectors. Matrices and vectors are
//! interpolated linearly between grid points. The first and the last grid point lie on the border of the box.

use super::sample::{Literal, Sample};
use trimip_core::Config;
use trimip_core::config::Decomposition;

/// The density tensor and the colour tensor.
pub struct Tensor {
    cp: bool,
    /// Number of grid points along x, y and z.
    sides: [usize; 3],
    /// Matrices and vectors of the density tensor, then of the colour tensor.
    factors: Vec<Factors>,
}

struct Factors {
    components: usize,
    matrices: Vec<f64>,
    vectors: Vec<f64>,
}

impl Tensor {
    /// Creates the tensors at their full size; `slots` holds the values of the encoder's slots.
    pub fn new(config: &Config, slots: Vec<Vec<f64>>) -> Self {
        let cp = config.tensor.decomposition == Decomposition::Cp;
        let side = config.tensor.sides.values().last().unwrap_or(0.0);
        let length =
            |axis: usize| f64::from(config.scene.aabb_max[axis]) - f64::from(config.scene.aabb_min[axis]);
        // side³ cubic cells fill the box.
        let cell = (length(0) * length(1) * length(2)).cbrt() / side;
        let sides = [0, 1, 2].map(|axis| ((length(axis) / cell + 1e-6).floor() as usize).max(2));
        let counts = [config.tensor.density_components, config.tensor.color_components];
        let mut slots = slots.into_iter();
        let factors = counts.map(|count| Factors {
            components: count as usize,
            matrices: if cp { Vec::new() } else { slots.next().unwrap_or_default() },
            vectors: slots.next().unwrap_or_default(),
        });
        Self { cp, sides, factors: factors.into() }
    }

    /// Returns the number of features whose sum is the logit of the density.
    pub fn density_features(config: &Config) -> usize {
        let copies = if config.tensor.decomposition == Decomposition::Cp { 1 } else { 3 };
        copies * config.tensor.density_components as usize
    }

    /// Interpolates along an axis: returns the sum of `value` over grid points, weighted by their hat functions at `place`.
    fn along(&self, axis: usize, place: f64, value: impl Fn(usize) -> f64) -> f64 {
        let last = self.sides[axis] - 1;
        let hat = |i: usize| (1.0 - (place * last as f64 - i as f64).abs()).max(0.0);
        (0..=last).filter(|&i| hat(i) > 0.0).map(|i| hat(i) * value(i)).sum()
    }
}

impl Literal for Tensor {
    fn features(&self, &Sample { position, .. }: &Sample) -> Vec<f64> {
        let [x, y, z] = self.sides;
        let mut features = Vec::new();
        for Factors { components, matrices, vectors } in &self.factors {
            // Vectors are stored in the order z, y, x; matrices in the order xy, xz, yz, with the first axis along a row.
            let vector = |axis: usize, c: usize| {
                let first = [z + y, z, 0][axis];
                self.along(axis, position[axis], |i| vectors[(first + i) * components + c])
            };
            let matrix = |a: usize, b: usize, first: usize, c: usize| {
                self.along(b, position[b], |j| {
                    let row = first + j * self.sides[a];
                    self.along(a, position[a], |i| matrices[(row + i) * components + c])
                })
            };
            if self.cp {
                features.extend((0..*components).map(|c| vector(0, c) * vector(1, c) * vector(2, c)));
            } else {
                features.extend((0..*components).map(|c| matrix(0, 1, 0, c) * vector(2, c)));
                features.extend((0..*components).map(|c| matrix(0, 2, x * y, c) * vector(1, c)));
                features.extend((0..*components).map(|c| matrix(1, 2, x * y + x * z, c) * vector(0, c)));
            }
        }
        features
    }
}
