//! Geometry of the tri-mip encoding: three square feature planes with their mip levels, the level of a sphere (Eq. 5)
//! and the texels a query reads. Plane 0 is YZ, 1 XZ, 2 XY; (a, b) are a plane's two axes, a along a row of texels.

use crate::{
    Aabb,
    config::{EncoderConfig, LevelFormula},
    scalar::Real,
};

/// Axes (a, b) of each plane.
pub const PLANE_AXES: [[usize; 2]; 3] = [[1, 2], [0, 2], [0, 1]];

/// Features per texel; one cache line of f32.
pub const CHANNELS: usize = 16;

/// Features of a sample: the three planes' channels, concatenated.
pub const FEATURES: usize = 3 * CHANNELS;

/// Sizes and places of the planes' levels. Level 0 of all planes is the parameter `planes`, [3, N, N, 16]; the levels
/// above it are one derived array, level by level, level l being `[3, N >> l, N >> l, 16]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Pyramid {
    /// Texels along a side at level 0.
    pub size: usize,
    /// Number of levels, the base included; 1 without a mipmap.
    pub levels: usize,
    /// log2 of the world radius r̈ that belongs to level 0, per plane.
    pub log2_base_radius: [f64; 3],
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

/// The two levels a query blends: weight 1 − `fraction` on `lower`, `fraction` on `lower + 1`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LevelBlend<R> {
    /// Finer of the two levels.
    pub lower: usize,
    /// Weight of the coarser level; 0 when only `lower` is read.
    pub fraction: R,
}

impl Pyramid {
    /// The configured planes over a box.
    pub fn new(config: &EncoderConfig, aabb: &Aabb<f64>) -> Self {
        let extent = aabb.extent();
        let size = config.plane_size as usize;
        let log2_base_radius = PLANE_AXES.map(|[a, b]| {
            let texel = (extent[a] * extent[b]).sqrt() / size as f64;
            match config.level {
                LevelFormula::Paper => texel / std::f64::consts::PI.sqrt(),
                LevelFormula::Code => texel / 2.0,
            }
            .log2()
        });
        Self { size, levels: if config.mipmap { config.levels as usize } else { 1 }, log2_base_radius }
    }

    /// The same planes with `halvings` times half the texels along a side: the pyramid without its finest levels.
    pub fn halved(&self, halvings: u32) -> Self {
        Self {
            size: self.size >> halvings,
            levels: self.levels.saturating_sub(halvings as usize).max(1),
            log2_base_radius: self.log2_base_radius.map(|radius| radius + f64::from(halvings)),
        }
    }

    /// Texels along a side of `level`.
    #[inline]
    pub fn side(&self, level: usize) -> usize {
        self.size >> level
    }

    /// Floats of level 0 of all planes: the parameters.
    pub fn base_len(&self) -> usize {
        3 * self.size * self.size * CHANNELS
    }

    /// First float of `level` ≥ 1 of `plane` in the derived array.
    #[inline]
    pub fn derived_offset(&self, level: usize, plane: usize) -> usize {
        let texels: usize = (1..level).map(|l| 3 * self.side(l) * self.side(l)).sum();
        (texels + plane * self.side(level) * self.side(level)) * CHANNELS
    }

    /// Floats of all derived levels.
    pub fn derived_len(&self) -> usize {
        self.derived_offset(self.levels, 0)
    }

    /// Levels of a sphere whose radius has the logarithm `log2_radius` (base 2, world units), on `plane` (Eq. 5):
    /// l = log2(r / r̈), clamped to [0, levels − 1]. A zero or NaN radius reads level 0.
    #[inline]
    pub fn blend<R: Real>(&self, plane: usize, log2_radius: R) -> LevelBlend<R> {
        let level = log2_radius - R::from_f64(self.log2_base_radius[plane]);
        let top = R::from_u32(self.levels as u32 - 1);
        // A comparison with NaN is false: level 0.
        if !(level > R::zero()) || self.levels == 1 {
            return LevelBlend { lower: 0, fraction: R::zero() };
        }
        if level >= top {
            return LevelBlend { lower: self.levels - 1, fraction: R::zero() };
        }
        let lower = level.floor();
        LevelBlend { lower: lower.to_usize().unwrap_or(0), fraction: level - lower }
    }
}

/// Doubles the side of three planes in place: each of the `side`² texels of a plane becomes four like it, so that the
/// levels above them stay what they are. `values` begins with the planes and has room for the result.
pub fn grow<T: Copy>(values: &mut [T], side: usize) {
    let row = side * CHANNELS;
    // From the end: no texel is overwritten before it is read.
    for from in (0..3 * side).rev() {
        let (source, target) = (from * row, 4 * from * row);
        for texel in (0..side).rev() {
            let (source, target) = (source + texel * CHANNELS, target + 2 * texel * CHANNELS);
            for place in [target + 2 * row + CHANNELS, target + 2 * row, target + CHANNELS, target] {
                values.copy_within(source..source + CHANNELS, place);
            }
        }
    }
}

/// Bilinear taps at (`a`, `b`) in [0, 1]² on a square of `side` texels: centres at (i + 0.5)/side, clamped at the border.
#[inline]
pub fn taps<R: Real>(side: usize, a: R, b: R) -> Taps<R> {
    let half = R::from_f64(0.5);
    let along = |coordinate: R| {
        let position = coordinate * R::from_u32(side as u32) - half;
        let lower = position.floor();
        let fraction = position - lower;
        let last = side as i32 - 1;
        let lower = lower.to_i32().unwrap_or(0);
        ([lower.clamp(0, last) as usize, (lower + 1).clamp(0, last) as usize], fraction)
    };
    let (columns, right) = along(a);
    let (rows, up) = along(b);
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
            // The code's r̈ = texel/2 lies log2(2/√π) = 0.17 levels higher.
            let blend = with_formula(512, 8, LevelFormula::Code).blend(2, radius.log2());
            let higher = (2.0 / std::f64::consts::PI.sqrt()).log2();
            assert!((blend.lower as f64 + blend.fraction - expected - higher).abs() < 1e-12);
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
            let t = taps(8, a, b);
            let centre = |i: usize| (i as f64 + 0.5) / 8.0;
            let mut sums = [0.0; 3];
            for i in 0..2 {
                for j in 0..2 {
                    sums[0] += t.weights[i][j];
                    sums[1] += t.weights[i][j] * centre(t.columns[j]);
                    sums[2] += t.weights[i][j] * centre(t.rows[i]);
                }
            }
            assert!(
                (sums[0] - 1.0).abs() < 1e-12 && (sums[1] - a).abs() < 1e-12 && (sums[2] - b).abs() < 1e-12
            );
        }
        let corner = taps(8, 0.0_f32, 1.0);
        assert_eq!((corner.columns, corner.rows), ([0, 0], [7, 7]));
        let outside = taps(8, -5.0_f32, f32::NAN);
        assert!(outside.columns.iter().chain(&outside.rows).all(|&i| i < 8));
    }

    #[test]
    fn halved_planes_are_the_pyramid_without_its_finest_levels() {
        let (whole, halved) = (pyramid(64, 5), pyramid(64, 5).halved(2));
        assert_eq!((halved.size, halved.levels), (16, 3));
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
        let (side, fine) = (4, 8);
        let value = |i: usize| (i as f32 * 0.37).sin();
        let mut values: Vec<f32> = (0..3 * fine * fine * CHANNELS).map(value).collect();
        grow(&mut values, side);
        for plane in 0..3 {
            for (row, column) in (0..fine * fine).map(|i| (i / fine, i % fine)) {
                let texel = ((plane * fine + row) * fine + column) * CHANNELS;
                let parent = ((plane * side + row / 2) * side + column / 2) * CHANNELS;
                for channel in 0..CHANNELS {
                    assert_eq!(values[texel + channel], value(parent + channel), "{plane} {row} {column}");
                }
            }
        }
    }

    #[test]
    fn levels_follow_each_other_without_gap() {
        let pyramid = pyramid(16, 5);
        assert_eq!(pyramid.base_len(), 3 * 256 * 16);
        assert_eq!(pyramid.derived_offset(1, 0), 0);
        assert_eq!(pyramid.derived_offset(2, 0), 3 * 64 * 16);
        assert_eq!(pyramid.derived_offset(2, 1), (3 * 64 + 16) * 16);
        assert_eq!(pyramid.derived_len(), 3 * (64 + 16 + 4 + 1) * 16);
    }
}
