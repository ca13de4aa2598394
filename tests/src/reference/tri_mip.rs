//! The tri-mip encoding written from its equations (Tri-MipRF, Eq. 3 to 5).

use super::sample::{Literal, Sample};
use trimip_core::{
    Config,
    config::{LevelFormula, PlaneShape},
};

/// Channels of a texel.
const CHANNELS: usize = 16;

/// Axes of each plane: the one along a row of texels, then the one across rows.
pub const AXES: [[usize; 2]; 3] = [[1, 2], [0, 2], [0, 1]];

/// The planes and their parameters.
pub struct TriMip {
    config: Config,
    /// Texels of each level: planes YZ, XZ, XY one after the other, each as [rows, columns, 16].
    levels: Vec<Vec<f64>>,
    /// Number of texels along x, y and z at level 0.
    sides: [usize; 3],
}

impl TriMip {
    /// Creates the planes; `base` holds their level 0.
    pub fn new(config: &Config, base: Vec<f64>) -> Self {
        let encoder = &config.encoder;
        let sides = sides(config);
        let mut levels = vec![base];
        for level in 1..if encoder.mipmap { encoder.levels as usize } else { 1 } {
            levels.push(halved(&levels[level - 1], sides.map(|side| side >> level)));
        }
        Self { levels, sides, config: config.clone() }
    }

    /// Returns one channel of a level at (a, b), interpolated between texel centres at (i + 0.5)/N, clamped at the
    /// border.
    fn bilinear(&self, level: usize, plane: usize, a: f64, b: f64, channel: usize) -> f64 {
        let sides = self.sides.map(|side| side >> level);
        let [columns, rows] = AXES[plane].map(|axis| sides[axis]);
        let before: usize = AXES[..plane].iter().map(|&[a, b]| sides[a] * sides[b]).sum();
        let texel = |row: f64, column: f64| {
            let clamp = |i: f64, side: usize| i.clamp(0.0, side as f64 - 1.0) as usize;
            let texel = before + clamp(row, rows) * columns + clamp(column, columns);
            self.levels[level][texel * CHANNELS + channel]
        };
        let (x, y) = (a * columns as f64 - 0.5, b * rows as f64 - 0.5);
        let (column, row) = (x.floor(), y.floor());
        let (u, v) = (x - column, y - row);
        (1.0 - v) * ((1.0 - u) * texel(row, column) + u * texel(row, column + 1.0))
            + v * ((1.0 - u) * texel(row + 1.0, column) + u * texel(row + 1.0, column + 1.0))
    }
}

impl Literal for TriMip {
    /// Returns 48 features: planes YZ, XZ, XY, each trilinear between texels and levels. If `level_input` is set, the
    /// mean level follows, divided by 4 and clamped to ±2.
    fn features(&self, &Sample { position, radius, .. }: &Sample) -> Vec<f64> {
        let (mut features, mut levels) = (Vec::new(), Vec::new());
        for (plane, [a, b]) in AXES.into_iter().enumerate() {
            let scene = &self.config.scene;
            let extent = |axis: usize| f64::from(scene.aabb_max[axis]) - f64::from(scene.aabb_min[axis]);
            // Eq. 5: l = log2(r / r̈) with r̈ = sqrt(extent_a·extent_b / (H·W·π)); the authors' code has r̈ = texel/2.
            let area = extent(a) * extent(b) / (self.sides[a] * self.sides[b]) as f64;
            let base = match self.config.encoder.level {
                LevelFormula::Paper => (area / std::f64::consts::PI).sqrt(),
                LevelFormula::Code => 0.5 * area.sqrt(),
            };
            levels.push((radius / base).log2());
            let level = (radius / base).log2().clamp(0.0, (self.levels.len() - 1) as f64);
            let (lower, fraction) = (level.floor() as usize, level - level.floor());
            let upper = (lower + 1).min(self.levels.len() - 1);
            for channel in 0..CHANNELS {
                let read = |level| self.bilinear(level, plane, position[a], position[b], channel);
                features.push((1.0 - fraction) * read(lower) + fraction * read(upper));
            }
        }
        if self.config.encoder.level_input {
            features.push((levels.iter().sum::<f64>() / 3.0 / 4.0).clamp(-2.0, 2.0));
        }
        features
    }
}

/// Halves the resolution: a texel becomes the mean of 2×2 texels. `sides` are the result's texels along x, y and z.
fn halved(fine: &[f64], sides: [usize; 3]) -> Vec<f64> {
    let mut coarse = Vec::new();
    let mut start = 0;
    for [a, b] in AXES {
        let (columns, rows) = (sides[a], sides[b]);
        for (row, column) in (0..rows * columns).map(|i| (i / columns, i % columns)) {
            for channel in 0..CHANNELS {
                let child = |j: usize, i: usize| {
                    let texel = start + (2 * row + j) * 2 * columns + 2 * column + i;
                    fine[texel * CHANNELS + channel]
                };
                coarse.push((child(0, 0) + child(0, 1) + child(1, 0) + child(1, 1)) / 4.0);
            }
        }
        start += 4 * rows * columns;
    }
    coarse
}

/// Returns the number of texels along the box's axes at level 0: `plane_size` along each axis, or as many square texels
/// as cover the box, in multiples that halve evenly at every level.
pub fn sides(config: &Config) -> [usize; 3] {
    let size = config.encoder.plane_size as usize;
    let extent =
        [0, 1, 2].map(|axis| f64::from(config.scene.aabb_max[axis]) - f64::from(config.scene.aabb_min[axis]));
    let texel = extent.into_iter().fold(0.0, f64::max) / size as f64;
    match config.encoder.shape {
        PlaneShape::Square => [size; 3],
        PlaneShape::Box => extent.map(|side| {
            let enough = (1..).map(|i| i << (config.encoder.levels - 1));
            enough.into_iter().find(|&texels| texels as f64 + 0.02 > side / texel).unwrap_or(size)
        }),
    }
}
