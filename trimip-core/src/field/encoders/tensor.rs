//! Factored feature tensors (Chen et al. 2022, TensoRF). A feature is a product of interpolated factors: of a plane and
//! the line perpendicular to it (VM), or of three lines (CP). The density logit is the sum of the density features; a
//! linear map of the colour features is the input of the colour network. Radii are not used.

use super::definition::{Definition, Reference, SamplePosition};
use crate::config::Decomposition;
use crate::field::slot::{Slot, in_sequence};
use crate::math::scalar::Real;
use crate::{Aabb, Config};

/// Number of features in a vector register. The number of components is a multiple of this number.
pub const LANES: usize = 16;

/// Axes (a, b) of each plane; a runs along a row of texels. The line of a plane runs along the third axis.
pub const PLANE_AXES: [[usize; 2]; 3] = [[0, 1], [0, 2], [1, 2]];

/// Axis of the line of each plane.
pub const LINE_AXES: [usize; 3] = [2, 1, 0];

/// Factored tensors as an encoder.
pub struct Tensors;

/// The two tensors, in the order of their features.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Features whose sum is the density logit.
    Density,
    /// Features that become the input of the colour network.
    Color,
}

/// Both tensors.
pub const KINDS: [Kind; 2] = [Kind::Density, Kind::Color];

/// Sizes of the factors at a stage of growth.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Shape {
    /// How features decompose into products.
    pub decomposition: Decomposition,
    /// Number of grid points along the box's axes.
    pub sides: [usize; 3],
    /// Number of components of the density tensor and of the colour tensor.
    pub components: [usize; 2],
}

impl Shape {
    /// Computes the sizes of the factors of a configuration at a stage of growth.
    pub fn new(config: &Config, stage: u32) -> Self {
        let tensor = &config.tensor;
        let sides: Vec<f64> = tensor.sides.values().collect();
        let side = sides[sides.len().saturating_sub(1 + stage as usize)];
        let extent = Aabb::<f64>::new(&config.scene).extent();
        // Cells are cubes, side³ of them in the whole box (TensoRF's code).
        let cell = extent.iter().product::<f64>().cbrt() / side;
        Self {
            decomposition: tensor.decomposition,
            sides: extent.map(|length| ((length / cell + 1e-6) as usize).max(2)),
            components: [tensor.density_components as usize, tensor.color_components as usize],
        }
    }

    /// Returns the sizes of the factors at every stage of growth, indexed by the stage.
    pub fn all(config: &Config) -> Vec<Self> {
        (0..config.tensor.sides.values().count() as u32).map(|stage| Self::new(config, stage)).collect()
    }

    /// Returns the number of planes: 3 for VM, 0 for CP.
    pub fn planes(&self) -> usize {
        match self.decomposition {
            Decomposition::Vm => 3,
            Decomposition::Cp => 0,
        }
    }

    /// Returns the numbers of columns and rows of a plane.
    #[inline(always)]
    pub fn plane(&self, plane: usize) -> [usize; 2] {
        PLANE_AXES[plane].map(|axis| self.sides[axis])
    }

    /// Returns the index of a plane's first grid point among those of all planes. For plane 3, this is the total number
    /// of grid points of planes.
    #[inline(always)]
    pub fn plane_start(&self, plane: usize) -> usize {
        (0..plane).map(|p| self.plane(p).iter().product::<usize>()).sum()
    }

    /// Returns the index of a line's first grid point among those of all lines. For line 3, this is the total number of
    /// grid points of lines.
    #[inline(always)]
    pub fn line_start(&self, line: usize) -> usize {
        (0..line).map(|l| self.sides[LINE_AXES[l]]).sum()
    }

    /// Returns the number of components of a tensor.
    pub fn components(&self, kind: Kind) -> usize {
        self.components[kind as usize]
    }

    /// Returns the number of features of a tensor: one per component and plane, or one per component.
    pub fn features(&self, kind: Kind) -> usize {
        self.components(kind) * self.planes().max(1)
    }

    /// Returns the number of floats of a slot of this shape.
    fn floats(&self, kind: Kind, planes: bool) -> usize {
        let points = if planes { self.plane_start(3) } else { self.line_start(3) };
        points * self.components(kind)
    }
}

/// Returns the grid point before a position along an axis of `side` points, and the weight of the point after it. The
/// corners of the box are the first and the last point.
#[inline(always)]
pub fn between<R: Real>(side: usize, place: R) -> (usize, R) {
    let last = R::from_u32(side as u32 - 1);
    let at = (place * last).max(R::zero()).min(last);
    let lower = at.floor().min(R::from_u32(side as u32 - 2));
    (lower.to_usize().unwrap_or(0), at - lower)
}

/// Returns the tensor of a slot, and true if the slot's factors are planes.
fn part(slot: &Slot) -> (Kind, bool) {
    let kind = if slot.name.starts_with("density") { Kind::Density } else { Kind::Color };
    (kind, slot.name.ends_with("planes"))
}

/// Interpolates rows of `count` points with `width` floats each to `to` points; the first and the last point keep their
/// values.
pub(super) fn resample(values: &[f32], count: usize, width: usize, to: usize) -> Vec<f32> {
    let mut result = Vec::with_capacity(values.len() / count * to);
    for row in values.chunks_exact(count * width) {
        for i in 0..to {
            let (lower, upper) = between(count, i as f32 / (to - 1) as f32);
            let pair = row[lower * width..].iter().zip(&row[(lower + 1) * width..]).take(width);
            result.extend(pair.map(|(a, b)| a + upper * (b - a)));
        }
    }
    result
}

impl Definition for Tensors {
    fn describe(&self, config: &Config) -> String {
        let Shape { sides: [x, y, z], components: [density, color], decomposition } = Shape::new(config, 0);
        let factors = match decomposition {
            Decomposition::Vm => "planes and lines",
            Decomposition::Cp => "lines",
        };
        format!("{factors} of a tensor of {x}×{y}×{z}, {density} components of density and {color} of colour")
    }

    fn width(&self, config: &Config) -> usize {
        let shape = Shape::new(config, 0);
        KINDS.iter().map(|kind| shape.features(*kind)).sum()
    }

    fn summed(&self, config: &Config) -> usize {
        Shape::new(config, 0).features(Kind::Density)
    }

    fn slots(&self, config: &Config) -> Vec<Slot> {
        let (shape, tensor) = (Shape::new(config, 0), &config.tensor);
        let mut slots = Vec::new();
        for (kind, name) in KINDS.into_iter().zip(["density", "color"]) {
            let slot = |factor: &str, points: usize| Slot {
                rate: tensor.rate,
                decay: 0.0,
                normal: true,
                precision: config.file.planes,
                grows: true,
                ..Slot::new(
                    format!("{name}_{factor}"),
                    vec![points, shape.components(kind)],
                    tensor.init_deviation,
                )
            };
            if shape.planes() > 0 {
                slots.push(slot("planes", shape.plane_start(3)));
            }
            slots.push(slot("lines", shape.line_start(3)));
        }
        slots
    }

    fn stage(&self, config: &Config, progress: f64) -> u32 {
        let sides: Vec<f64> = config.tensor.sides.values().collect();
        let now = config.tensor.sides.at(progress);
        sides.iter().rev().position(|side| *side == now).unwrap_or(0) as u32
    }

    fn length(&self, config: &Config, slot: &Slot, stage: u32) -> usize {
        let (kind, planes) = part(slot);
        Shape::new(config, stage).floats(kind, planes)
    }

    fn grow(&self, config: &Config, slot: &Slot, values: &mut [f32], from: u32, to: u32) {
        let (kind, planes) = part(slot);
        let (old, new) = (Shape::new(config, from), Shape::new(config, to));
        let width = old.components(kind);
        let mut grown = Vec::with_capacity(new.floats(kind, planes));
        for i in 0..3 {
            if planes {
                let ([columns, rows], [to_columns, to_rows]) = (old.plane(i), new.plane(i));
                let plane = &values[old.plane_start(i) * width..][..columns * rows * width];
                let wide = resample(plane, columns, width, to_columns);
                grown.extend(resample(&wide, rows, to_columns * width, to_rows));
            } else {
                let (points, to) = (old.sides[LINE_AXES[i]], new.sides[LINE_AXES[i]]);
                let line = &values[old.line_start(i) * width..][..points * width];
                grown.extend(resample(line, points, width, to));
            }
        }
        values[..grown.len()].copy_from_slice(&grown);
    }

    fn restarted(&self, config: &Config, progress: f64) -> Option<f64> {
        Some(config.tensor.sides.since(progress))
    }

    fn sparsity(&self, config: &Config, slot: &Slot, stage: u32) -> f64 {
        let (kind, planes) = part(slot);
        let [first, later] = config.tensor.sparsity.map(f64::from);
        let grown = stage as usize + 1 < config.tensor.sides.values().count();
        let weight = if grown { later } else { first };
        match kind {
            // The term is the sum of the means of the three planes or, in the slot of lines, of the three lines.
            Kind::Density => 3.0 * weight / Shape::new(config, stage).floats(kind, planes) as f64,
            Kind::Color => 0.0,
        }
    }

    fn lowered_by(&self) -> &'static str {
        "lower tensor.sides"
    }

    fn reference(&self, config: &Config, values: Vec<Vec<f64>>) -> Box<dyn Reference> {
        Box::new(TensorTwin { shape: Shape::new(config, 0), values })
    }
}

/// Returns the slots of the encoder with their ranges in the parameters, in order: for each tensor its planes, if there
/// are any, then its lines.
pub fn slots(config: &Config) -> Vec<Slot> {
    in_sequence(Tensors.slots(config))
}

/// The tensors in f64.
struct TensorTwin {
    shape: Shape,
    /// Values of the slots.
    values: Vec<Vec<f64>>,
}

impl TensorTwin {
    /// Returns a component of a line at a position.
    fn line(&self, line: usize, values: &[f64], width: usize, component: usize, at: [f64; 3]) -> f64 {
        let axis = LINE_AXES[line];
        let (lower, upper) = between(self.shape.sides[axis], at[axis]);
        let value = |i: usize| values[(self.shape.line_start(line) + i) * width + component];
        (1.0 - upper) * value(lower) + upper * value(lower + 1)
    }

    /// Returns a component of a plane at a position.
    fn plane(&self, plane: usize, values: &[f64], width: usize, component: usize, at: [f64; 3]) -> f64 {
        let [columns, rows] = self.shape.plane(plane);
        let [a, b] = PLANE_AXES[plane].map(|axis| at[axis]);
        let ((column, right), (row, up)) = (between(columns, a), between(rows, b));
        let value = |i: usize, j: usize| {
            values[(self.shape.plane_start(plane) + (row + i) * columns + column + j) * width + component]
        };
        (1.0 - up) * ((1.0 - right) * value(0, 0) + right * value(0, 1))
            + up * ((1.0 - right) * value(1, 0) + right * value(1, 1))
    }
}

impl Reference for TensorTwin {
    fn features(&self, at: &SamplePosition) -> Vec<f64> {
        let mut features = Vec::new();
        let mut slots = self.values.iter();
        for kind in KINDS {
            let width = self.shape.components(kind);
            let planes = if self.shape.planes() > 0 { slots.next() } else { None };
            let Some(lines) = slots.next() else { continue };
            match planes {
                Some(planes) => features.extend((0..3).flat_map(|p| {
                    let product = move |c| {
                        self.plane(p, planes, width, c, at.position)
                            * self.line(p, lines, width, c, at.position)
                    };
                    (0..width).map(product)
                })),
                None => features
                    .extend((0..width).map(|c| {
                        (0..3).map(|l| self.line(l, lines, width, c, at.position)).product::<f64>()
                    })),
            }
        }
        features
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::schedule::Schedule;

    fn config(decomposition: Decomposition) -> Config {
        let mut config = Config::default();
        config.encoder.kind = crate::config::EncoderKind::Tensor;
        let tensor = &mut config.tensor;
        (tensor.decomposition, tensor.density_components, tensor.color_components) = (decomposition, 16, 48);
        config
    }

    #[test]
    fn the_paper_has_its_sizes() {
        let mut config = config(Decomposition::Vm);
        config.tensor.sides = Schedule::new(vec![[0.0, 128.0], [0.5, 300.0]]);
        let shape = Shape::new(&config, 0);
        assert_eq!(shape.sides, [300; 3]);
        assert_eq!((Tensors.width(&config), Tensors.summed(&config)), (192, 48));
        let floats: usize = Tensors.slots(&config).iter().map(|slot| slot.range.len()).sum();
        assert_eq!(floats, 3 * (300 * 300 + 300) * 64);
        assert_eq!(Shape::new(&config, 1).sides, [128; 3]);
        // Cubic cells in a box that is not a cube.
        (config.scene.aabb_min, config.scene.aabb_max) = ([-1.0, -0.5, -0.5], [1.0, 0.5, 0.5]);
        let [x, y, z] = Shape::new(&config, 0).sides;
        assert!(y == z && (2 * y..=2 * y + 1).contains(&x), "{x} {y}");
        assert!(((x * y * z) as f64 / 300_f64.powi(3) - 1.0).abs() < 0.02);
    }

    /// Checks that the sum of the features at any position is the trilinear interpolation of the sums at the grid
    /// points, as for a dense tensor.
    #[test]
    fn features_sum_up_to_the_dense_tensor() {
        for decomposition in [Decomposition::Vm, Decomposition::Cp] {
            let mut config = config(decomposition);
            config.tensor.sides = Schedule::new(vec![[0.0, 5.0]]);
            let values: Vec<Vec<f64>> = Tensors
                .slots(&config)
                .iter()
                .zip(1..)
                .map(|(slot, seed)| {
                    (0..slot.range.len()).map(|i| ((i * seed) as f64 * 0.731).sin()).collect()
                })
                .collect();
            let reference = Tensors.reference(&config, values);
            let sum = |position: [f64; 3]| -> f64 {
                reference.features(&SamplePosition { position, ..SamplePosition::default() })
                    [..Tensors.summed(&config)]
                    .iter()
                    .sum()
            };
            let grid = |i: [usize; 3]| sum(i.map(|i| i as f64 / 4.0));
            for place in [[0.0, 0.0, 0.0], [1.0, 1.0, 1.0], [0.13, 0.51, 0.87], [0.5, 0.25, 0.99]] {
                let at = place.map(|x: f64| between(5, x));
                let mut dense = 0.0;
                for corner in 0..8 {
                    let up = |axis: usize| corner >> axis & 1;
                    let weight = |axis: usize| if up(axis) == 1 { at[axis].1 } else { 1.0 - at[axis].1 };
                    let point = [0, 1, 2].map(|axis| at[axis].0 + up(axis));
                    dense += weight(0) * weight(1) * weight(2) * grid(point);
                }
                assert!((sum(place) - dense).abs() < 1e-12, "{decomposition:?} {place:?}");
            }
        }
    }

    #[test]
    fn growing_from_n_to_2n_minus_1_keeps_the_grid_values() {
        let mut config = config(Decomposition::Vm);
        config.tensor.sides = Schedule::new(vec![[0.0, 4.0], [0.5, 7.0]]);
        for slot in Tensors.slots(&config) {
            let small = Tensors.length(&config, &slot, 1);
            let mut values: Vec<f32> = (0..slot.range.len()).map(|i| (i as f32 * 0.37).sin()).collect();
            let before = values[..small].to_vec();
            Tensors.grow(&config, &slot, &mut values, 1, 0);
            let width = slot.shape[1];
            let planes = slot.name.ends_with("planes");
            let (old, new) = if planes { (16, 49) } else { (4, 7) };
            for i in 0..3 * old {
                let (factor, at) = (i / old, i % old);
                let to = if planes { at / 4 * 2 * 7 + at % 4 * 2 } else { 2 * at };
                for c in 0..width {
                    let found = values[(factor * new + to) * width + c];
                    assert!((found - before[i * width + c]).abs() < 1e-6, "{} {i} {c}", slot.name);
                }
            }
        }
    }
}
