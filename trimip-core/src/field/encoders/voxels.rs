//! A dense grid of densities and spherical harmonics (Fridovich-Keil et al. 2022, Plenoxels). The features of a sample are the
//! density logit and the logits of red, green and blue in the direction of its ray, interpolated trilinearly between grid
//! points: there are no networks. Radii are not used.

use super::definition::{Definition, Reference, SamplePosition};
use super::tensor::{between, resample};
use crate::field::slot::{Slot, in_sequence};
use crate::math::scalar::Real;
use crate::math::sh::spherical_harmonics;
use crate::{Aabb, Config};

/// A grid of voxels as an encoder.
pub struct Voxels;

/// Number of features: density, red, green and blue.
pub const WIDTH: usize = 4;

/// The grid at a stage of growth.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Number of grid points along the box's axes; the first and the last point lie on the border of the box. x is
    /// contiguous, z is outermost.
    pub sides: [usize; 3],
    /// Number of spherical harmonics of a colour channel.
    pub harmonics: usize,
}

impl Shape {
    /// Creates the grid of a configuration at a stage of growth.
    pub fn new(config: &Config, stage: u32) -> Self {
        let sides: Vec<f64> = config.voxels.sides.values().collect();
        let side = sides[sides.len().saturating_sub(1 + stage as usize)];
        let extent = Aabb::<f64>::new(&config.scene).extent();
        // Cells are cubes, side³ of them in the whole box.
        let cell = extent.iter().product::<f64>().cbrt() / side;
        Self {
            sides: extent.map(|length| ((length / cell + 1e-6) as usize).max(2)),
            harmonics: (config.voxels.harmonics as usize).pow(2),
        }
    }

    /// Returns the grid at every stage of growth, indexed by the stage.
    pub fn all(config: &Config) -> Vec<Self> {
        (0..config.voxels.sides.values().count() as u32).map(|stage| Self::new(config, stage)).collect()
    }

    /// Returns the number of grid points.
    pub fn points(&self) -> usize {
        self.sides.iter().product()
    }

    /// Returns the number of floats of a grid point's colours: the harmonics of red, then of green and of blue.
    pub fn colors(&self) -> usize {
        3 * self.harmonics
    }

    /// Returns the grid points around a position and their weights; x varies fastest.
    #[inline(always)]
    pub fn corners<R: Real>(&self, place: [R; 3]) -> [(usize, R); 8] {
        let [x, y, z] = std::array::from_fn(|axis| between(self.sides[axis], place[axis]));
        let weight = |(_, upper): (usize, R), is_upper| if is_upper { upper } else { R::one() - upper };
        std::array::from_fn(|corner| {
            let upper = [corner & 1, corner >> 1 & 1, corner >> 2];
            let row = (z.0 + upper[2]) * self.sides[1] + y.0 + upper[1];
            let product = weight(x, upper[0] == 1) * weight(y, upper[1] == 1) * weight(z, upper[2] == 1);
            (row * self.sides[0] + x.0 + upper[0], product)
        })
    }
}

/// Returns the number of floats of a grid point in a slot.
fn width(shape: &Shape, slot: &Slot) -> usize {
    if slot.name.starts_with("density") { 1 } else { shape.colors() }
}

impl Definition for Voxels {
    fn describe(&self, config: &Config) -> String {
        let Shape { sides: [x, y, z], harmonics } = Shape::new(config, 0);
        format!(
            "a grid of {x}×{y}×{z} densities and colours of {harmonics} spherical harmonics, without networks"
        )
    }

    fn width(&self, _: &Config) -> usize {
        WIDTH
    }

    fn direct(&self) -> bool {
        true
    }

    fn slots(&self, config: &Config) -> Vec<Slot> {
        let shape = Shape::new(config, 0);
        let slot = |name: &str, width: usize, rate: f64| Slot {
            rate,
            decay: 0.0,
            precision: config.file.planes,
            group: Some(1),
            grows: true,
            ..Slot::new(name, vec![shape.points(), width], 0.0)
        };
        let voxels = &config.voxels;
        vec![
            slot("density_voxels", 1, voxels.density_rate),
            slot("color_voxels", shape.colors(), voxels.color_rate),
        ]
    }

    fn stage(&self, config: &Config, progress: f64) -> u32 {
        let sides: Vec<f64> = config.voxels.sides.values().collect();
        let now = config.voxels.sides.at(progress);
        sides.iter().rev().position(|side| *side == now).unwrap_or(0) as u32
    }

    fn length(&self, config: &Config, slot: &Slot, stage: u32) -> usize {
        let shape = Shape::new(config, stage);
        shape.points() * width(&shape, slot)
    }

    fn grow(&self, config: &Config, slot: &Slot, values: &mut [f32], from: u32, to: u32) {
        let (old, new) = (Shape::new(config, from), Shape::new(config, to));
        let width = width(&old, slot);
        let mut grown = values[..old.points() * width].to_vec();
        let mut row = width;
        for axis in 0..3 {
            grown = resample(&grown, old.sides[axis], row, new.sides[axis]);
            row *= new.sides[axis];
        }
        values[..grown.len()].copy_from_slice(&grown);
    }

    fn lowered_by(&self) -> &'static str {
        "lower voxels.sides"
    }

    fn reference(&self, config: &Config, values: Vec<Vec<f64>>) -> Box<dyn Reference> {
        let mut values = values.into_iter();
        let mut next = || values.next().unwrap_or_default();
        Box::new(VoxelTwin { shape: Shape::new(config, 0), density: next(), colors: next() })
    }
}

/// Returns the slots of the densities and of the colours with their ranges in the parameters, in order.
pub fn slots(config: &Config) -> Vec<Slot> {
    in_sequence(Voxels.slots(config))
}

/// The grid in f64.
struct VoxelTwin {
    shape: Shape,
    density: Vec<f64>,
    colors: Vec<f64>,
}

impl Reference for VoxelTwin {
    fn features(&self, at: &SamplePosition) -> Vec<f64> {
        let basis = spherical_harmonics(at.direction);
        let count = self.shape.harmonics;
        let mut features = vec![0.0; WIDTH];
        for (point, weight) in self.shape.corners(at.position) {
            features[0] += weight * self.density[point];
            for c in 0..3 {
                let own = &self.colors[(3 * point + c) * count..][..count];
                features[1 + c] += weight * own.iter().zip(basis).map(|(a, b)| a * b).sum::<f64>();
            }
        }
        features
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{EncoderKind, schedule::Schedule};

    fn config() -> Config {
        let mut config = Config::default();
        config.encoder.kind = EncoderKind::Voxels;
        (config.scene.aabb_min, config.scene.aabb_max) = ([-1.0, -1.5, -0.5], [2.0, 1.5, 0.75]);
        config.voxels.sides = Schedule::new(vec![[0.0, 6.0], [0.5, 11.0]]);
        config.voxels.harmonics = 2;
        config
    }

    #[test]
    fn cells_are_cubes_of_the_box() {
        // 11³ cells of 0.2035 fill a box of 3 by 3 by 1.25.
        assert_eq!(Shape::new(&config(), 0), Shape { sides: [14, 14, 6], harmonics: 4 });
        assert_eq!(Voxels.stage(&config(), 0.49), 1);
        assert_eq!(Voxels.stage(&config(), 0.5), 0);
    }

    #[test]
    fn a_linear_function_is_reproduced_and_survives_growth() {
        let config = config();
        let linear = |[x, y, z]: [f64; 3]| 0.3 + 2.0 * x - y + 0.5 * z;
        let slots = slots(&config);
        let mut values = vec![0.0_f32; slots[0].range.len()];
        let small = Shape::new(&config, 1);
        let [nx, ny, nz] = small.sides;
        for i in 0..small.points() {
            let along = |i: usize, n: usize| i as f64 / (n - 1) as f64;
            let place = [along(i % nx, nx), along(i / nx % ny, ny), along(i / (nx * ny), nz)];
            values[i] = linear(place) as f32;
        }
        Voxels.grow(&config, &slots[0], &mut values, 1, 0);
        let density: Vec<f64> = values.into_iter().map(f64::from).collect();
        let colors = vec![0.0; slots[1].range.len()];
        let reference = Voxels.reference(&config, vec![density, colors]);
        for position in [[0.0; 3], [1.0; 3], [0.21, 0.83, 0.5], [0.999, 0.001, 0.7]] {
            let found = reference.features(&SamplePosition {
                position,
                direction: [0.0, 0.0, 1.0],
                ..SamplePosition::default()
            });
            assert!((found[0] - linear(position)).abs() < 1e-6, "{position:?}: {}", found[0]);
        }
    }
}
