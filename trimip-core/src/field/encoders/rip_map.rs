//! Ripmaps on planes of several directions (Liu et al. 2024, Rip-NeRF). A sample is a Gaussian (Barron et al. 2021,
//! mip-NeRF). Its projection on each plane reads a ripmap, whose levels halve each axis of the plane independently, so
//! a Gaussian that is long in one direction is not blurred in the other.

use super::definition::{Definition, Reference, SamplePosition};
use super::tri_mip::{LevelBlend, Shape, Taps, taps};
use crate::config::RipMapConfig;
use crate::math::scalar::Real;
use crate::{Aabb, Config, Slot};

/// Features per texel; one cache line of f32.
pub const CHANNELS: usize = 16;

/// Number of floats of a sample's Gaussian, which the forward pass keeps for the backward pass.
pub const CONTEXT: usize = 8;

/// Largest number of levels along an axis.
pub const MOST_LEVELS: u32 = 13;

/// Ripmapped planes as an encoder.
pub struct RipMap;

/// The Gaussian of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gaussian<R> {
    /// Mean, in coordinates of the unit cube.
    pub mean: [R; 3],
    /// Unit direction of the sample's ray.
    pub direction: [R; 3],
    /// Variance across the ray, in square world units.
    pub across: R,
    /// Variance along the ray, in square world units.
    pub along: R,
}

impl<R: Real> Gaussian<R> {
    /// Computes the Gaussian of a conical frustum (mip-NeRF, Eq. 7 and 8). `extent` is the size of the unit cube in
    /// world units, `radius` is the cone's radius at the interval's midpoint `t`, and `length` is the interval's
    /// length.
    #[inline(always)]
    pub fn new(position: [R; 3], extent: [R; 3], radius: R, direction: [R; 3], t: R, length: R) -> Self {
        let number = R::from_f64;
        let half = number(0.5) * length;
        // Square of half the length divided by the distance; at most 1 for an interval in front of the camera.
        let q = if t > R::zero() { (half / t) * (half / t) } else { R::zero() };
        let q = q.min(R::one());
        let sum = number(3.0) + q;
        let shift = number(2.0) * t * q / sum;
        let fourth = number(4.0 / 15.0);
        let along = half * half * (number(1.0 / 3.0) - fourth * q * (number(12.0) - q) / (sum * sum));
        let across = radius * radius * (number(0.25) + number(5.0 / 12.0) * q - fourth * q * q / sum);
        let mean = std::array::from_fn(|axis| position[axis] + shift * direction[axis] / extent[axis]);
        Self { mean, direction, across, along }
    }
}

impl Gaussian<f32> {
    /// Returns the Gaussian as a row: mean, variance across the ray, direction, variance along the ray.
    #[inline(always)]
    pub fn row(&self) -> [f32; CONTEXT] {
        let ([x, y, z], [u, v, w]) = (self.mean, self.direction);
        [x, y, z, self.across, u, v, w, self.along]
    }

    /// Returns the Gaussian of a [`row`](Self::row).
    #[inline(always)]
    pub fn of(&[x, y, z, across, u, v, w, along]: &[f32; CONTEXT]) -> Self {
        Self { mean: [x, y, z], direction: [u, v, w], across, along }
    }
}

/// A plane and its ripmap. Level (i, j) has `sides[0] >> i` columns and `sides[1] >> j` rows. The ripmap is one rectangle
/// of texels: in each row of level j, the columns of all levels i lie side by side, and the rows of all levels j follow
/// each other.
#[derive(Clone, Debug, PartialEq)]
pub struct Plane<R> {
    /// Columns and rows of level (0, 0).
    pub sides: [usize; 2],
    /// Number of levels along each axis.
    pub levels: usize,
    /// Unit vectors along a row and across the rows, in world axes.
    pub axes: [[R; 3]; 2],
    /// Factors that map a position in the unit cube to the position along each axis of the plane, in [0, 1].
    pub factors: [[R; 3]; 2],
    /// Position of the cube's origin along each axis of the plane.
    pub offsets: [R; 2],
    /// Half of log2 of the variance at which a Gaussian reads level 0, per axis.
    pub base: [R; 2],
    /// Index of the first texel of level (0, 0) in the parameters.
    pub first: usize,
    /// Index of the first texel in the ripmaps of all planes.
    pub start: usize,
}

/// One bilinear read of one level of a plane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Read<R> {
    /// Levels along the two axes.
    pub levels: [usize; 2],
    /// Weight of the level among the reads.
    pub level_weight: R,
    /// Texels of the level, and their weights.
    pub taps: Taps<R>,
}

/// Returns the unit normals of the planes, in world axes. 3, 4, 6 or 10 planes are parallel to the faces of a cube,
/// octahedron, dodecahedron or icosahedron, respectively.
pub fn normals(planes: u32) -> Vec<[f64; 3]> {
    let golden = f64::midpoint(1.0, 5_f64.sqrt());
    let cyclic = |[x, y, z]: [f64; 3]| [[x, y, z], [z, x, y], [y, z, x]];
    let both = |[x, y, z]: [f64; 3]| [cyclic([x, y, z]), cyclic([x, y, -z])].concat();
    let octahedron = vec![[1.0, 1.0, 1.0], [1.0, 1.0, -1.0], [1.0, -1.0, 1.0], [1.0, -1.0, -1.0]];
    let all = match planes {
        3 => cyclic([1.0, 0.0, 0.0]).to_vec(),
        4 => octahedron,
        6 => both([0.0, 1.0, golden]),
        _ => [octahedron, both([0.0, golden, 1.0 / golden])].concat(),
    };
    all.into_iter().map(|normal| normal.map(|x| x / dot(normal, normal).sqrt())).collect()
}

#[inline(always)]
fn dot<R: Real>(a: [R; 3], b: [R; 3]) -> R {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Returns the axes of a plane with normal n: first (−n_y, n_x, 0), normalised, then n × the first axis. For a normal
/// along z they are the world's x and y.
fn axes([x, y, z]: [f64; 3]) -> [[f64; 3]; 2] {
    let flat = x.hypot(y);
    if flat < 1e-9 {
        return [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];
    }
    let first = [-y / flat, x / flat, 0.0];
    [first, [-z * first[1], z * first[0], x * first[1] - y * first[0]]]
}

/// Returns the planes of a configuration. Texels are square, except for rounding, and each plane covers the projection
/// of the box.
pub fn planes(config: &RipMapConfig, aabb: &Aabb<f64>) -> Vec<Plane<f64>> {
    let (extent, levels) = (aabb.extent(), config.levels as usize);
    let texel = aabb.longest() / f64::from(config.size);
    let (mut first, mut start) = (0, 0);
    let plane = |normal| {
        let axes = axes(normal);
        let widths = axes.map(|axis| (0..3).map(|k| axis[k].abs() * extent[k]).sum::<f64>());
        // A width that differs from a whole number of texels only by rounding keeps that number.
        let sides = widths.map(|width| {
            ((width / texel - 0.01).ceil().max(1.0) as usize).next_multiple_of(1 << (levels - 1))
        });
        let factors = [0, 1].map(|a| std::array::from_fn(|k| axes[a][k] * extent[k] / widths[a]));
        let plane = Plane {
            sides,
            levels,
            axes,
            factors,
            // The middle of the box is the middle of the plane.
            offsets: factors.map(|factors: [f64; 3]| 0.5 - 0.5 * factors.iter().sum::<f64>()),
            // Level 0 is read where four standard deviations are one texel (Rip-NeRF's code).
            base: [0, 1].map(|a| (widths[a] / sides[a] as f64 / 4.0).log2() - f64::from(config.level_bias)),
            first,
            start,
        };
        first += sides[0] * sides[1];
        start += plane.width() * plane.height();
        plane
    };
    normals(config.planes).into_iter().map(plane).collect()
}

/// Returns the number of texels of the planes, and of all their ripmaps.
pub fn texels(config: &RipMapConfig, aabb: &Aabb<f64>) -> [usize; 2] {
    let end = |plane: &Plane<f64>| {
        [plane.first + plane.sides[0] * plane.sides[1], plane.start + plane.width() * plane.height()]
    };
    planes(config, aabb).last().map_or([0; 2], end)
}

impl Plane<f64> {
    /// Converts the plane to another precision.
    pub fn cast<R: Real>(&self) -> Plane<R> {
        let three = |values: [f64; 3]| values.map(R::from_f64);
        Plane {
            sides: self.sides,
            levels: self.levels,
            axes: self.axes.map(three),
            factors: self.factors.map(three),
            offsets: self.offsets.map(R::from_f64),
            base: self.base.map(R::from_f64),
            first: self.first,
            start: self.start,
        }
    }
}

impl<R: Real> Plane<R> {
    /// Returns the number of texels in a row of the ripmap.
    #[inline(always)]
    pub fn width(&self) -> usize {
        self.column(self.levels)
    }

    /// Returns the number of rows of the ripmap.
    #[inline(always)]
    pub fn height(&self) -> usize {
        self.row(self.levels)
    }

    /// Returns the first column of level i along the rows; for i = `levels`, the width.
    #[inline(always)]
    pub fn column(&self, level: usize) -> usize {
        // This is the sum of the finer levels' columns, because sides halve evenly.
        2 * self.sides[0] - ((2 * self.sides[0]) >> level)
    }

    /// Returns the first row of level j along the columns; for j = `levels`, the height.
    #[inline(always)]
    pub fn row(&self, level: usize) -> usize {
        2 * self.sides[1] - ((2 * self.sides[1]) >> level)
    }

    /// Returns the numbers of rows and columns of a level.
    #[inline(always)]
    pub fn shape(&self, [i, j]: [usize; 2]) -> Shape {
        Shape { rows: self.sides[1] >> j, columns: self.sides[0] >> i }
    }

    /// Returns the position of a Gaussian along the two axes, and the levels that it blends along each axis: level
    /// log2(4σ / texel), clamped to [0, levels − 1].
    #[inline(always)]
    pub fn project(&self, gaussian: &Gaussian<R>) -> ([R; 2], [LevelBlend<R>; 2]) {
        let at = [0, 1].map(|a| dot(self.factors[a], gaussian.mean) + self.offsets[a]);
        let blends = [0, 1].map(|a| {
            let cosine = dot(self.axes[a], gaussian.direction);
            let square = cosine * cosine;
            let variance = gaussian.across * (R::one() - square) + gaussian.along * square;
            LevelBlend::new(R::from_f64(0.5) * variance.log2() - self.base[a], self.levels)
        });
        (at, blends)
    }

    /// Returns the reads of a Gaussian, at most four; unused reads have a weight of 0.
    #[inline(always)]
    pub fn reads(&self, gaussian: &Gaussian<R>) -> [Read<R>; 4] {
        let (at, [i, j]) = self.project(gaussian);
        std::array::from_fn(|k| {
            let level_weight = |blend: LevelBlend<R>, upper: bool| {
                if upper { blend.fraction } else { R::one() - blend.fraction }
            };
            let (up_i, up_j) = (k & 1 == 1, k & 2 == 2);
            let level_weight = level_weight(i, up_i) * level_weight(j, up_j);
            // A level beyond the coarsest has no weight and need not exist.
            let levels = match level_weight > R::zero() {
                true => [i.lower + usize::from(up_i), j.lower + usize::from(up_j)],
                false => [0, 0],
            };
            Read { levels, level_weight, taps: taps(self.shape(levels), at[0], at[1]) }
        })
    }

    /// Returns the index of a texel of a level within the plane's ripmap.
    #[inline(always)]
    pub fn texel(&self, [i, j]: [usize; 2], row: usize, column: usize) -> usize {
        (self.row(j) + row) * self.width() + self.column(i) + column
    }
}

fn configured(config: &Config) -> Vec<Plane<f64>> {
    planes(&config.rip_map, &Aabb::new(&config.scene))
}

impl Definition for RipMap {
    fn describe(&self, config: &Config) -> String {
        let (planes, levels) = (configured(config), config.rip_map.levels);
        let most = [0, 1].map(|a| planes.iter().map(|plane| plane.sides[a]).max().unwrap_or(0));
        format!(
            "{} planes of up to {}×{}×{CHANNELS} with {levels}×{levels} rip levels",
            planes.len(),
            most[0],
            most[1]
        )
    }

    fn width(&self, config: &Config) -> usize {
        config.rip_map.planes as usize * CHANNELS
    }

    fn context(&self, _: &Config) -> usize {
        CONTEXT
    }

    fn slots(&self, config: &Config) -> Vec<Slot> {
        let [texels, _] = texels(&config.rip_map, &Aabb::new(&config.scene));
        vec![Slot {
            rate: config.rip_map.rate,
            group: Some(CHANNELS),
            precision: config.file.planes,
            ..Slot::new("planes", vec![texels, CHANNELS], config.rip_map.init_range)
        }]
    }

    fn derived_bytes(&self, config: &Config) -> u64 {
        let [_, texels] = texels(&config.rip_map, &Aabb::new(&config.scene));
        (2 * texels * CHANNELS * size_of::<f32>()) as u64
    }

    fn lowered_by(&self) -> &'static str {
        "lower rip_map.size"
    }

    fn reference(&self, config: &Config, mut values: Vec<Vec<f64>>) -> Box<dyn Reference> {
        let planes = configured(config);
        let base = values.swap_remove(0);
        let maps = planes.iter().map(|plane| ripmap(plane, &base[plane.first * CHANNELS..])).collect();
        Box::new(RipTwin { maps, planes, extent: Aabb::new(&config.scene).extent() })
    }
}

/// The planes in f64.
struct RipTwin {
    planes: Vec<Plane<f64>>,
    /// The ripmap of each plane.
    maps: Vec<Vec<f64>>,
    extent: [f64; 3],
}

/// Computes the ripmap of a plane: means of pairs of rows, then means of pairs of columns.
fn ripmap(plane: &Plane<f64>, base: &[f64]) -> Vec<f64> {
    let mut map = vec![0.0; plane.width() * plane.height() * CHANNELS];
    let place = |levels, row, column, channel| plane.texel(levels, row, column) * CHANNELS + channel;
    for (j, i) in (0..plane.levels).flat_map(|j| (0..plane.levels).map(move |i| (j, i))) {
        let Shape { rows, columns } = plane.shape([i, j]);
        for at in 0..rows * columns * CHANNELS {
            let (texel, channel) = (at / CHANNELS, at % CHANNELS);
            let (row, column) = (texel / columns, texel % columns);
            map[place([i, j], row, column, channel)] = match (i, j) {
                (0, 0) => base[at],
                (0, _) => {
                    [0, 1].map(|k| map[place([0, j - 1], 2 * row + k, column, channel)]).iter().sum::<f64>()
                        / 2.0
                }
                _ => {
                    [0, 1].map(|k| map[place([i - 1, j], row, 2 * column + k, channel)]).iter().sum::<f64>()
                        / 2.0
                }
            };
        }
    }
    map
}

impl Reference for RipTwin {
    fn features(&self, at: &SamplePosition) -> Vec<f64> {
        let gaussian = Gaussian::new(at.position, self.extent, at.radius, at.direction, at.t, at.length);
        let mut features = vec![0.0; self.planes.len() * CHANNELS];
        for ((plane, map), out) in self.planes.iter().zip(&self.maps).zip(features.chunks_exact_mut(CHANNELS))
        {
            for Read { levels, level_weight, taps } in plane.reads(&gaussian) {
                for (row, weights) in taps.rows.into_iter().zip(taps.weights) {
                    for (column, weight) in taps.columns.into_iter().zip(weights) {
                        let texel = &map[plane.texel(levels, row, column) * CHANNELS..][..CHANNELS];
                        out.iter_mut()
                            .zip(texel)
                            .for_each(|(sum, value)| *sum += level_weight * weight * value);
                    }
                }
            }
        }
        features
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(planes: u32, size: u32, levels: u32) -> RipMapConfig {
        RipMapConfig { planes, size, levels, ..Config::default().rip_map }
    }

    const CUBE: Aabb<f64> = Aabb { min: [-1.5; 3], max: [1.5; 3] };

    #[test]
    fn normals_are_unit_and_as_far_apart_as_the_solids_have_them() {
        // For each number of planes, the largest cosine between two of the normals, taken as lines.
        let cases = [(3, 0.0), (4, 1.0 / 3.0), (6, 1.0 / 5_f64.sqrt()), (10, 5_f64.sqrt() / 3.0)];
        for (planes, most) in cases {
            let normals = normals(planes);
            assert_eq!(normals.len(), planes as usize);
            for (i, a) in normals.iter().enumerate() {
                assert!((dot(*a, *a) - 1.0).abs() < 1e-12);
                let [u, v] = axes(*a);
                for (x, y, expected) in [(u, u, 1.0), (v, v, 1.0), (u, v, 0.0), (u, *a, 0.0), (v, *a, 0.0)] {
                    assert!((dot(x, y) - expected).abs() < 1e-12, "{planes} {i}");
                }
                for b in &normals[..i] {
                    assert!(dot(*a, *b).abs() < most + 1e-12, "{planes}: {a:?} {b:?}");
                }
            }
        }
    }

    #[test]
    fn a_frustum_has_the_moments_of_its_volume() {
        // Numerical moments of the frustum 3 <= t <= 5 of a cone of radius 0.2 t.
        let (middle, length, slope) = (4.0, 2.0, 0.2);
        let gaussian =
            Gaussian::<f64>::new([0.5; 3], [1.0; 3], slope * middle, [0.0, 0.0, 1.0], middle, length);
        let steps = 200_000;
        let (mut volume, mut mean, mut square, mut across) = (0.0, 0.0, 0.0, 0.0);
        for i in 0..steps {
            let t = 3.0 + length * (f64::from(i) + 0.5) / f64::from(steps);
            // A disc has the variance r²/4 along each of its axes.
            let (area, disc) = ((slope * t).powi(2), (slope * t).powi(2) / 4.0);
            volume += area;
            mean += area * t;
            square += area * t * t;
            across += area * disc;
        }
        mean /= volume;
        assert!((gaussian.mean[2] - 0.5 - (mean - middle)).abs() < 1e-9);
        assert!((gaussian.along - (square / volume - mean * mean)).abs() < 1e-9);
        assert!((gaussian.across - across / volume).abs() < 1e-9);
    }

    #[test]
    fn no_gaussian_has_a_negative_variance_or_leaves_the_planes() {
        let planes: Vec<Plane<f32>> = planes(&config(10, 64, 4), &CUBE).iter().map(Plane::cast).collect();
        for (radius, t, length) in
            [(0.0, 0.0, 0.0), (1e-3, 0.0, 1.0), (1e-20, 1e-20, 1.0), (1e9, 1.0, 2.0), (0.1, 1e-3, 2e-3)]
        {
            for position in [[0.0; 3], [1.0; 3], [0.3, 0.9, -0.1]] {
                let direction = [0.6, 0.0, 0.8];
                let gaussian = Gaussian::<f32>::new(position, [3.0; 3], radius, direction, t, length);
                assert!(gaussian.along >= 0.0 && gaussian.across >= 0.0);
                for plane in &planes {
                    let reads = plane.reads(&gaussian);
                    let sum: f32 = reads.iter().map(|read| read.level_weight).sum();
                    assert!((sum - 1.0).abs() < 1e-5, "{gaussian:?}");
                    for Read { levels, taps, .. } in reads {
                        assert!(levels.iter().all(|level| *level < 4));
                        let texel = plane.texel(levels, taps.rows[1], taps.columns[1]);
                        assert!(texel < plane.width() * plane.height());
                    }
                }
            }
        }
    }

    #[test]
    fn the_box_fills_every_plane_and_texels_are_square() {
        let aabb = Aabb { min: [-0.7, -1.2, -0.5], max: [0.7, 1.2, 1.1] };
        for plane in planes(&config(10, 512, 5), &aabb) {
            for a in [0, 1] {
                let corner = |k: usize| {
                    let at: [f64; 3] = std::array::from_fn(|axis| (k >> axis & 1) as f64);
                    dot(plane.factors[a], at) + plane.offsets[a]
                };
                let corners: Vec<f64> = (0..8).map(corner).collect();
                assert!((corners.iter().copied().fold(f64::MAX, f64::min)).abs() < 1e-12);
                assert!((corners.iter().copied().fold(f64::MIN, f64::max) - 1.0).abs() < 1e-12);
                let texel = 4.0 * plane.base[a].exp2();
                assert!((texel / (2.4 / 512.0) - 1.0).abs() < 0.05, "{texel}");
            }
        }
        // The paper's three planes of a cube have 512² texels each, and about 4 times as many in a full ripmap.
        let [base, all] = texels(&config(3, 512, 8), &CUBE);
        assert_eq!(base, 3 * 512 * 512);
        assert_eq!(all, 3 * (1024 - 4) * (1024 - 4));
    }

    #[test]
    fn a_level_is_four_standard_deviations_wide() {
        let plane = &planes(&config(3, 512, 8), &CUBE)[2];
        let texel = 3.0 / 512.0;
        // A ray perpendicular to the plane, and a ray along the plane's first axis.
        for (direction, expected) in [([0.0, 0.0, 1.0], [1.0, 1.0]), ([1.0, 0.0, 0.0], [3.0, 1.0])] {
            let gaussian = Gaussian {
                mean: [0.5; 3],
                direction,
                across: (2.0 * texel / 4.0_f64).powi(2),
                along: (8.0 * texel / 4.0_f64).powi(2),
            };
            let (at, blends) = plane.project(&gaussian);
            assert_eq!(at, [0.5; 2]);
            let levels = blends.map(|blend| blend.lower as f64 + blend.fraction);
            assert!((0..2).all(|a| (levels[a] - expected[a]).abs() < 1e-9), "{levels:?} {:?}", plane.axes);
        }
    }
}
