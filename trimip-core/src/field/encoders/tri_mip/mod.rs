//! Geometry of the tri-mip encoding: three feature planes with mip levels, the level of a sphere (Eq. 5), and the
//! texels that a query reads. Plane 0 is YZ, 1 is XZ, 2 is XY. A plane's two axes are (a, b); a runs along a row of
//! texels.

mod definition;

pub use definition::Planes;

use crate::{
    Aabb,
    config::{EncoderConfig, LevelFormula, PlaneShape},
    math::scalar::Real,
};
use std::ops::Range;

/// Axes (a, b) of each plane.
pub const PLANE_AXES: [[usize; 2]; 3] = [[1, 2], [0, 2], [0, 1]];

/// Features per texel; one cache line of f32.
pub const CHANNELS: usize = 16;

/// Features that a sample reads: the three planes' channels, concatenated.
pub const FEATURES: usize = 3 * CHANNELS;

/// Number of levels per unit of the networks' level input: levels 0 to 8 map to inputs 0 to 2.
pub const LEVELS_PER_UNIT: f64 = 4.0;

/// Largest absolute value of the networks' level input.
pub const MOST_LEVEL_INPUT: f64 = 2.0;

/// Sizes and offsets of the planes' levels. Level 0 of the three planes, one after the other, is the parameter
/// `planes`, [texels, 16]. The levels above it are one derived array, level by level, plane by plane. On level l, a
/// plane has `sides[b] >> l` rows of `sides[a] >> l` texels.
#[derive(Clone, Debug, PartialEq)]
pub struct Pyramid {
    /// Number of texels along the box's x, y and z at level 0.
    pub sides: [usize; 3],
    /// Number of levels, including the base; 1 without a mipmap.
    pub levels: usize,
    /// For each plane, log2 of the world radius of level 0: log2 r̈ minus `encoder.level_bias`.
    pub log2_base_radius: [f64; 3],
}

/// Size in texels of one plane on one level.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shape {
    /// Number of texels along axis b.
    pub rows: usize,
    /// Number of texels along axis a.
    pub columns: usize,
}

impl Shape {
    /// Returns the number of texels.
    #[inline(always)]
    pub fn texels(self) -> usize {
        self.rows * self.columns
    }

    /// Returns the number of floats in a row.
    #[inline(always)]
    pub fn row(self) -> usize {
        self.columns * CHANNELS
    }
}

/// One bilinear read of one level: four texels and their weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Taps<R> {
    /// Columns of the left and right texels.
    pub columns: [usize; 2],
    /// Rows of the lower and upper texels.
    pub rows: [usize; 2],
    /// Weight of (row i, column j).
    pub weights: [[R; 2]; 2],
}

/// The two levels that a query blends: weight 1 − `fraction` on `lower`, `fraction` on `lower + 1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelBlend<R> {
    /// Finer of the two levels.
    pub lower: usize,
    /// Weight of the coarser level; 0 when only `lower` is read.
    pub fraction: R,
}

/// Returns the number of texels along the box's axes at level 0: `plane_size` along each axis or, with shape `box`,
/// along the longest axis. The other axes then get the number that makes texels square, rounded up so that it halves
/// evenly on every level.
pub fn sides(config: &EncoderConfig, aabb: &Aabb<f64>) -> [usize; 3] {
    let size = config.plane_size as usize;
    match config.shape {
        PlaneShape::Square => [size; 3],
        PlaneShape::Box => {
            let (unit, texel) = (config.texel_unit() as usize, aabb.longest() / size as f64);
            // A side that differs from a whole number of texels only by rounding keeps that number.
            aabb.extent().map(|side| ((side / texel - 0.01).ceil().max(1.0) as usize).next_multiple_of(unit))
        }
    }
}

impl Pyramid {
    /// Creates the planes of a configuration over the box `aabb`.
    pub fn new(config: &EncoderConfig, aabb: &Aabb<f64>) -> Self {
        let (extent, sides) = (aabb.extent(), sides(config, aabb));
        let log2_base_radius = PLANE_AXES.map(|[a, b]| {
            let texel = (extent[a] / sides[a] as f64 * (extent[b] / sides[b] as f64)).sqrt();
            match config.level {
                LevelFormula::Paper => texel / std::f64::consts::PI.sqrt(),
                LevelFormula::Code => texel / 2.0,
            }
            .log2()
                - f64::from(config.level_bias)
        });
        Self { sides, levels: if config.mipmap { config.levels as usize } else { 1 }, log2_base_radius }
    }

    /// Returns the same planes with their sides halved `halvings` times: the pyramid without its finest levels.
    pub fn halved(&self, halvings: u32) -> Self {
        Self {
            sides: self.sides.map(|side| side >> halvings),
            levels: self.levels.saturating_sub(halvings as usize).max(1),
            log2_base_radius: self.log2_base_radius.map(|radius| radius + f64::from(halvings)),
        }
    }

    /// Returns the numbers of rows and columns of `level` of `plane`.
    #[inline(always)]
    pub fn shape(&self, level: usize, plane: usize) -> Shape {
        let [a, b] = PLANE_AXES[plane];
        Shape { rows: self.sides[b] >> level, columns: self.sides[a] >> level }
    }

    /// Returns the number of texels of all planes on `level`.
    pub fn texels(&self, level: usize) -> usize {
        (0..3).map(|plane| self.shape(level, plane).texels()).sum()
    }

    /// Returns the number of floats of level 0 of all planes, which are the parameters.
    pub fn base_len(&self) -> usize {
        self.texels(0) * CHANNELS
    }

    /// Returns the index of the first float of `level` of `plane`: in the parameters for level 0, otherwise in the
    /// derived array.
    #[inline]
    pub fn offset(&self, level: usize, plane: usize) -> usize {
        let below: usize = (1..level).map(|l| self.texels(l)).sum();
        let before: usize = (0..plane).map(|p| self.shape(level, p).texels()).sum();
        (below + before) * CHANNELS
    }

    /// Returns the range of the floats of `level` of `plane`; see [`Pyramid::offset`].
    pub fn range(&self, level: usize, plane: usize) -> Range<usize> {
        let start = self.offset(level, plane);
        start..start + self.shape(level, plane).texels() * CHANNELS
    }

    /// Returns the number of floats of all derived levels.
    pub fn derived_len(&self) -> usize {
        (1..self.levels).map(|l| self.texels(l)).sum::<usize>() * CHANNELS
    }

    /// Returns the levels that a sphere reads on `plane` (Eq. 5): l = log2(r / r̈), clamped to [0, levels − 1].
    /// `log2_radius` is log2 of the radius in world units. A zero or NaN radius reads level 0.
    #[inline]
    pub fn blend<R: Real>(&self, plane: usize, log2_radius: R) -> LevelBlend<R> {
        LevelBlend::new(log2_radius - R::from_f64(self.log2_base_radius[plane]), self.levels)
    }

    /// Returns the mean of log2 r̈ over the planes: the reference of [`level_input`].
    pub fn reference(&self) -> f64 {
        self.log2_base_radius.iter().sum::<f64>() / 3.0
    }
}

impl<R: Real> LevelBlend<R> {
    /// Returns the blend at `level`, clamped to [0, `levels` − 1]. NaN reads level 0.
    #[inline(always)]
    pub fn new(level: R, levels: usize) -> Self {
        let top = R::from_u32(levels as u32 - 1);
        // A comparison with NaN is false.
        if !(level > R::zero()) || levels == 1 {
            return Self { lower: 0, fraction: R::zero() };
        }
        if level >= top {
            return Self { lower: levels - 1, fraction: R::zero() };
        }
        let lower = level.floor();
        Self { lower: lower.to_usize().unwrap_or(0), fraction: level - lower }
    }
}

/// Returns a sphere's level as an input of the networks: a quarter of log2(r / r̈), within ±2. `reference` is log2 r̈.
/// A zero or NaN radius gives −2.
#[inline]
pub fn level_input<R: Real>(log2_radius: R, reference: R) -> R {
    let [unit, most] = [LEVELS_PER_UNIT, MOST_LEVEL_INPUT].map(R::from_f64);
    let input = (log2_radius - reference) / unit;
    // A comparison with NaN is false.
    if !(input > -most) { -most } else { input.min(most) }
}

/// Grows the planes at the front of `values` in place. `whole` is the pyramid of full size; its sides are halved
/// `halvings` times before the growth and `fewer` times after it.
pub fn grow<T: Copy>(values: &mut [T], whole: &Pyramid, halvings: u32, fewer: u32) {
    for halvings in (fewer..halvings).rev() {
        double(values, &whole.halved(halvings + 1));
    }
}

/// Doubles the sides of the planes of `pyramid` in place. Each texel becomes four equal ones, so that the levels
/// above keep their values. `values` starts with the planes and has room for the result.
fn double<T: Copy>(values: &mut [T], pyramid: &Pyramid) {
    // Copies from the end, so that no texel is overwritten before it is read.
    for plane in (0..3).rev() {
        let (shape, start) = (pyramid.shape(0, plane), pyramid.offset(0, plane));
        let row = shape.row();
        for from in (0..shape.rows).rev() {
            let (source, target) = (start + from * row, 4 * (start + from * row));
            for texel in (0..shape.columns).rev() {
                let (source, target) = (source + texel * CHANNELS, target + 2 * texel * CHANNELS);
                for place in [target + 2 * row + CHANNELS, target + 2 * row, target + CHANNELS, target] {
                    values.copy_within(source..source + CHANNELS, place);
                }
            }
        }
    }
}

/// Returns the bilinear taps at (`a`, `b`) in [0, 1]² on a rectangle of texels: centres at (i + 0.5)/side, clamped at
/// the border.
#[inline]
pub fn taps<R: Real>(shape: Shape, a: R, b: R) -> Taps<R> {
    let half = R::from_f64(0.5);
    let along = |side: usize, coordinate: R| {
        let position = coordinate * R::from_u32(side as u32) - half;
        let lower = position.floor();
        let fraction = position - lower;
        let last = side as i32 - 1;
        let lower = lower.to_i32().unwrap_or(0);
        ([lower.clamp(0, last) as usize, (lower + 1).clamp(0, last) as usize], fraction)
    };
    let (columns, right) = along(shape.columns, a);
    let (rows, up) = along(shape.rows, b);
    let one = R::one();
    Taps {
        columns,
        rows,
        weights: [[(one - up) * (one - right), (one - up) * right], [up * (one - right), up * right]],
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pyramid(size: u32, levels: u32) -> Pyramid {
        with_formula(size, levels, LevelFormula::Paper)
    }

    fn with_formula(size: u32, levels: u32, level: LevelFormula) -> Pyramid {
        let config = EncoderConfig { plane_size: size, levels, level, ..crate::Config::default().encoder };
        Pyramid::new(&config, &Aabb { min: [-1.5; 3], max: [1.5; 3] })
    }

    #[test]
    fn level_is_equation_5() {
        let pyramid = pyramid(512, 8);
        for radius in [0.004_f64, 0.01, 0.05, 0.2] {
            // r̈ = sqrt(extent_a · extent_b / (H·W·π))
            let base = (3.0 * 3.0 / (512.0 * 512.0 * std::f64::consts::PI)).sqrt();
            let expected = (radius / base).log2();
            let blend = pyramid.blend(2, radius.log2());
            assert!((blend.lower as f64 + blend.fraction - expected).abs() < 1e-12);
            // With r̈ = texel/2, as in the authors' code, the level is higher by log2(2/√π) = 0.17.
            let blend = with_formula(512, 8, LevelFormula::Code).blend(2, radius.log2());
            let higher = (2.0 / std::f64::consts::PI.sqrt()).log2();
            assert!((blend.lower as f64 + blend.fraction - expected - higher).abs() < 1e-12);
        }
    }

    #[test]
    fn a_bias_moves_every_level_by_itself() {
        let biased = |level_bias| {
            let config =
                EncoderConfig { level_bias, plane_size: 64, levels: 6, ..crate::Config::default().encoder };
            Pyramid::new(&config, &Aabb { min: [-1.5; 3], max: [1.5; 3] })
        };
        let level = |bias: f32, radius: f64| {
            let blend = biased(bias).blend(1, radius.log2());
            blend.lower as f64 + blend.fraction
        };
        for radius in [0.1_f64, 0.13, 0.2] {
            for bias in [-1.0_f32, -0.25, 0.5, 1.5] {
                assert!((level(bias, radius) - level(0.0, radius) - f64::from(bias)).abs() < 1e-12);
            }
            // Halving the radius changes the level by one.
            assert!((level(-1.0, radius) - level(0.0, radius / 2.0)).abs() < 1e-12);
        }
    }

    #[test]
    fn no_radius_leaves_the_pyramid() {
        let pyramid = pyramid(64, 4);
        for radius in [0.0_f32, -0.0, f32::NAN, f32::MIN_POSITIVE / 4.0, 1e-30, 1e30, f32::INFINITY] {
            let blend = pyramid.blend(0, radius.log2());
            assert!(blend.lower < 4 && (0.0..1.0).contains(&blend.fraction), "{radius}: {blend:?}");
            assert!(blend.fraction == 0.0 || blend.lower < 3);
        }
    }

    #[test]
    fn taps_reproduce_linear_functions_and_clamp_at_the_border() {
        for (a, b) in [(0.3_f64, 0.7), (0.5, 0.5), (0.07, 0.93), (0.0625, 0.0625)] {
            let t = taps(Shape { rows: 8, columns: 24 }, a, b);
            let centre = |i: usize, side: f64| (i as f64 + 0.5) / side;
            let mut sums = [0.0; 3];
            for i in 0..2 {
                for j in 0..2 {
                    sums[0] += t.weights[i][j];
                    sums[1] += t.weights[i][j] * centre(t.columns[j], 24.0);
                    sums[2] += t.weights[i][j] * centre(t.rows[i], 8.0);
                }
            }
            assert!(
                (sums[0] - 1.0).abs() < 1e-12 && (sums[1] - a).abs() < 1e-12 && (sums[2] - b).abs() < 1e-12
            );
        }
        let square = Shape { rows: 8, columns: 8 };
        let corner = taps(square, 0.0_f32, 1.0);
        assert_eq!((corner.columns, corner.rows), ([0, 0], [7, 7]));
        let outside = taps(square, -5.0_f32, f32::NAN);
        assert!(outside.columns.iter().chain(&outside.rows).all(|&i| i < 8));
    }

    #[test]
    fn halved_planes_are_the_pyramid_without_its_finest_levels() {
        let (whole, halved) = (pyramid(64, 5), pyramid(64, 5).halved(2));
        assert_eq!((halved.sides, halved.levels), ([16; 3], 3));
        for radius in [0.15_f64, 0.3, 0.5, 1.0] {
            let (whole, halved) = (whole.blend(0, radius.log2()), halved.blend(0, radius.log2()));
            assert!(
                (whole.lower as f64 + whole.fraction - 2.0 - halved.lower as f64 - halved.fraction).abs()
                    < 1e-12
            );
        }
    }

    #[test]
    fn grown_planes_average_to_what_they_were() {
        let coarse = Pyramid { sides: [4, 2, 6], levels: 1, log2_base_radius: [0.0; 3] };
        let fine = Pyramid { sides: [8, 4, 12], ..coarse.clone() };
        let value = |i: usize| (i as f32 * 0.37).sin();
        let mut values: Vec<f32> = (0..fine.base_len()).map(value).collect();
        double(&mut values, &coarse);
        for plane in 0..3 {
            let (shape, above) = (fine.shape(0, plane), coarse.shape(0, plane));
            for (row, column) in (0..shape.texels()).map(|i| (i / shape.columns, i % shape.columns)) {
                let texel = fine.offset(0, plane) + (row * shape.columns + column) * CHANNELS;
                let parent = coarse.offset(0, plane) + (row / 2 * above.columns + column / 2) * CHANNELS;
                for channel in 0..CHANNELS {
                    assert_eq!(values[texel + channel], value(parent + channel), "{plane} {row} {column}");
                }
            }
        }
    }

    #[test]
    fn planes_of_a_long_box_have_square_texels_that_halve_evenly() {
        let config = EncoderConfig {
            plane_size: 512,
            levels: 5,
            shape: PlaneShape::Box,
            ..crate::Config::default().encoder
        };
        let long = Aabb { min: [-0.5, -1.0, 0.0], max: [0.5, 1.0, 0.01] };
        let pyramid = Pyramid::new(&config, &long);
        assert_eq!(pyramid.sides, [256, 512, 16]);
        assert_eq!(pyramid.shape(0, 2), Shape { rows: 512, columns: 256 });
        assert_eq!(pyramid.shape(4, 0), Shape { rows: 1, columns: 32 });
        // The paper's r̈, with the texels' own sides.
        let texel = 2.0 / 512.0;
        assert!((pyramid.log2_base_radius[2] - (texel / 2.0_f64).log2()).abs() < 1e-12);
        let square = EncoderConfig { shape: PlaneShape::Square, ..config };
        assert_eq!(Pyramid::new(&square, &long).sides, [512; 3]);
    }

    #[test]
    fn levels_follow_each_other_without_gap() {
        let pyramid = pyramid(16, 5);
        assert_eq!(pyramid.base_len(), 3 * 256 * 16);
        assert_eq!(pyramid.offset(0, 1), 256 * 16);
        assert_eq!(pyramid.offset(1, 0), 0);
        assert_eq!(pyramid.offset(2, 0), 3 * 64 * 16);
        assert_eq!(pyramid.offset(2, 1), (3 * 64 + 16) * 16);
        assert_eq!(pyramid.derived_len(), 3 * (64 + 16 + 4 + 1) * 16);
        let pyramid = Pyramid { sides: [8, 16, 4], levels: 3, log2_base_radius: [0.0; 3] };
        assert_eq!(pyramid.base_len(), (16 * 4 + 8 * 4 + 8 * 16) * 16);
        let ends: Vec<_> = (0..9).map(|i| pyramid.range(i / 3, i % 3)).collect();
        assert!(ends[..3].windows(2).chain(ends[3..].windows(2)).all(|pair| pair[0].end == pair[1].start));
        assert_eq!((ends[0].start, ends[2].end), (0, pyramid.base_len()));
        assert_eq!((ends[3].start, ends[8].end), (0, pyramid.derived_len()));
    }
}
