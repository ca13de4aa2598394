//! Multiresolution hash encoding (Müller et al. 2022, instant-ngp). Each level is a grid that is finer than the
//! previous level by a constant factor. Features at the corners of its cells are interpolated trilinearly. On fine
//! levels several corners share an entry through a hash. Radii are used only if several points of a sample read the
//! grid, or if features of cells narrower than the sample are down-weighted (Barron et al. 2023, Zip-NeRF).

mod points;

pub use points::{Points, TURNS, level_weight};

use super::definition::{Definition, Reference, SamplePosition};
use crate::config::HashGridConfig;
use crate::math::scalar::Real;
use crate::{Aabb, Config, Slot};

/// Factors of a corner's coordinates in its hash (instant-ngp, Eq. 4).
pub const PRIMES: [u32; 3] = [1, 2_654_435_761, 805_459_861];

/// The hash grid as an encoder.
///
/// Each stage of growth leaves out one more of the finest levels. A level that is left out has features of zero; once it comes into
/// use, its entries start at zero.
pub struct HashGrid;

/// A level of the grid.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Level {
    /// Number of cells across the box, minus one. Coordinate x maps to x · scale + 1/2.
    pub scale: f32,
    /// Number of corners along a side.
    pub side: u32,
    /// Index of the first entry within all levels.
    pub first: u32,
    /// Number of entries.
    pub entries: u32,
    /// True if corners share entries through the hash; otherwise each corner has its own entry.
    pub hashed: bool,
}

/// All levels, coarse to fine.
#[derive(Clone, Debug, PartialEq)]
pub struct Levels {
    /// The levels.
    pub levels: Vec<Level>,
    /// Number of features per entry.
    pub features: usize,
}

impl Levels {
    /// Creates the levels of a configuration.
    pub fn new(config: &HashGridConfig) -> Self {
        let (count, most) = (config.levels, 1_u64 << config.log2_entries);
        let growth = match count {
            1 => 0.0,
            _ => (f64::from(config.finest) / f64::from(config.coarsest)).ln() / f64::from(count - 1),
        };
        let mut first = 0;
        let levels = (0..count).map(|level| {
            let scale = f64::from(config.coarsest) * (growth * f64::from(level)).exp() - 1.0;
            // A scale that differs from a whole number only by rounding is treated as that number.
            let side = (scale - 1e-6).ceil() as u32 + 1;
            let corners = u64::from(side).pow(3);
            let entries = corners.next_multiple_of(8).min(most) as u32;
            let level = Level { scale: scale as f32, side, first, entries, hashed: corners > most };
            first += entries;
            level
        });
        Self { levels: levels.collect(), features: config.features as usize }
    }

    /// Returns the number of entries of all levels.
    pub fn entries(&self) -> usize {
        self.levels.iter().map(|level| level.entries as usize).sum()
    }

    /// Returns the number of features of a sample.
    pub fn width(&self) -> usize {
        self.levels.len() * self.features
    }

    /// Returns the levels that are in use at growth stage `stage`, coarse to fine: all except the `stage` finest.
    pub fn active(&self, stage: u32) -> &[Level] {
        &self.levels[..self.levels.len().saturating_sub(stage as usize)]
    }
}

impl Level {
    /// Returns the eight entries around a position in the unit cube, as indices within all levels, and their trilinear
    /// weights.
    #[inline(always)]
    pub fn corners<R: Real>(&self, position: [R; 3]) -> [(u32, R); 8] {
        let (half, one) = (R::from_f64(0.5), R::one());
        let place = position.map(|x| x * R::from_f64(self.scale.into()) + half);
        let lower = place.map(R::floor);
        let fraction: [R; 3] = std::array::from_fn(|axis| place[axis] - lower[axis]);
        let lower = lower.map(|x| x.to_u32().unwrap_or(0));
        std::array::from_fn(|corner| {
            let upper = |axis: usize| corner >> axis & 1 == 1;
            let at: [u32; 3] = std::array::from_fn(|axis| lower[axis] + u32::from(upper(axis)));
            let weight = |axis: usize| if upper(axis) { fraction[axis] } else { one - fraction[axis] };
            (self.first + self.entry(at), weight(0) * weight(1) * weight(2))
        })
    }

    /// Returns the index of a corner's entry within the level.
    #[inline(always)]
    pub fn entry(&self, [x, y, z]: [u32; 3]) -> u32 {
        if self.hashed {
            // The number of entries is a power of two.
            let hash = x.wrapping_mul(PRIMES[0]) ^ y.wrapping_mul(PRIMES[1]) ^ z.wrapping_mul(PRIMES[2]);
            hash & (self.entries - 1)
        } else {
            (x + self.side * (y + self.side * z)) % self.entries
        }
    }
}

impl Definition for HashGrid {
    fn describe(&self, config: &Config) -> String {
        let grid = &config.hash_grid;
        let points =
            if grid.points > 1 { format!(", read at {} points", grid.points) } else { String::new() };
        format!(
            "hash grid of {} levels from {}³ to {}³ corners, at most 2^{} entries of {} features each{points}",
            grid.levels, grid.coarsest, grid.finest, grid.log2_entries, grid.features
        )
    }

    fn width(&self, config: &Config) -> usize {
        Levels::new(&config.hash_grid).width()
    }

    fn context(&self, config: &Config) -> usize {
        let points = Points::<f64>::new(&config.hash_grid, &Aabb::new(&config.scene));
        if points.is_plain() { 0 } else { 4 * points.count }
    }

    fn slots(&self, config: &Config) -> Vec<Slot> {
        let levels = Levels::new(&config.hash_grid);
        vec![Slot {
            rate: config.hash_grid.rate,
            decay: 0.0,
            group: Some(levels.features),
            precision: config.file.planes,
            grows: true,
            ..Slot::new("table", vec![levels.entries(), levels.features], config.hash_grid.init_range)
        }]
    }

    fn stage(&self, config: &Config, progress: f64) -> u32 {
        config.hash_grid.levels - config.hash_grid.active_at(progress)
    }

    fn length(&self, config: &Config, _: &Slot, stage: u32) -> usize {
        let levels = Levels::new(&config.hash_grid);
        levels.active(stage).last().map_or(0, |last| (last.first + last.entries) as usize * levels.features)
    }

    fn grow(&self, config: &Config, slot: &Slot, values: &mut [f32], from: u32, to: u32) {
        let [from, to] = [from, to].map(|stage| self.length(config, slot, stage));
        values[from..to].fill(0.0);
    }

    fn lowered_by(&self) -> &'static str {
        "lower hash_grid.log2_entries"
    }

    fn reference(&self, config: &Config, mut values: Vec<Vec<f64>>) -> Box<dyn Reference> {
        Box::new(GridTwin {
            levels: Levels::new(&config.hash_grid),
            points: Points::new(&config.hash_grid, &Aabb::new(&config.scene)),
            table: values.swap_remove(0),
        })
    }
}

/// The hash grid in f64.
struct GridTwin {
    levels: Levels,
    points: Points<f64>,
    table: Vec<f64>,
}

impl Reference for GridTwin {
    fn features(&self, at: &SamplePosition) -> Vec<f64> {
        let width = self.levels.features;
        let mut features = vec![0.0; self.levels.width()];
        for j in 0..self.points.count {
            let [x, y, z, deviation] = self.points.point(j, at);
            for (level, out) in self.levels.levels.iter().zip(features.chunks_exact_mut(width)) {
                let level_weight = self.points.level_weight(level, deviation);
                for (entry, weight) in level.corners([x, y, z]) {
                    let row = &self.table[entry as usize * width..][..width];
                    out.iter_mut().zip(row).for_each(|(sum, value)| *sum += level_weight * weight * value);
                }
            }
        }
        features
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;
    use crate::config::schedule::Schedule;

    fn levels(log2_entries: u32) -> Levels {
        Levels::new(&HashGridConfig { log2_entries, ..Config::default().hash_grid })
    }

    #[test]
    fn the_paper_has_sixteen_levels_from_16_to_2048() {
        let levels = levels(19);
        let sides: Vec<u32> = levels.levels.iter().map(|level| level.side).collect();
        // b = exp(ln(2048/16)/15) = 1.3819. The scale is 16 b^l − 1; the side is its ceiling plus one.
        let published = [16, 23, 31, 43, 59, 81, 112, 154, 213, 295, 407, 562, 777, 1073, 1483, 2048];
        assert_eq!(sides, published);
        // 59³ corners fit into 2^19 entries, 81³ do not.
        let dense = levels.levels.iter().filter(|level| !level.hashed).count();
        assert_eq!(dense, 5);
        assert!(levels.levels[dense..].iter().all(|level| level.entries == 1 << 19));
        // The published table has 12.2 M features.
        assert_eq!(levels.width(), 32);
        assert_eq!(levels.entries() * levels.features, 12_196_240);
    }

    #[test]
    fn weights_sum_to_one_and_average_to_the_place() {
        let levels = levels(14);
        for position in [[0.0, 0.0, 0.0], [0.3, 0.71, 0.999], [1.0, 1.0, 1.0], [0.5, 0.25, 0.125]] {
            for level in &levels.levels {
                let corners = level.corners::<f64>(position);
                let sum: f64 = corners.iter().map(|(_, weight)| weight).sum();
                assert!((sum - 1.0).abs() < 1e-12);
                for (axis, x) in position.into_iter().enumerate() {
                    let place = x * f64::from(level.scale) + 0.5;
                    let upper: f64 =
                        (0..8).filter(|corner| corner >> axis & 1 == 1).map(|corner| corners[corner].1).sum();
                    assert!((place.floor() + upper - place).abs() < 1e-12, "axis {axis}");
                }
                let range = level.first..level.first + level.entries;
                assert!(corners.iter().all(|(entry, _)| range.contains(entry)));
            }
        }
    }

    #[test]
    fn coarse_levels_share_no_entry_and_fine_ones_hash_as_written() {
        let levels = levels(14);
        let coarse = &levels.levels[0];
        let mut seen = std::collections::HashSet::new();
        for corner in 0..16_u32.pow(3) {
            assert!(seen.insert(coarse.entry([corner % 16, corner / 16 % 16, corner / 256])));
        }
        let published = Levels::new(&Config::default().hash_grid).levels[15];
        for (corner, entry) in
            [([0, 1, 0], 489_905), ([0, 0, 1], 153_493), ([1, 2, 3], 128_476), ([100, 200, 300], 110_768)]
        {
            assert_eq!(published.entry(corner), entry, "{corner:?}");
        }
        let fine = levels.levels[15];
        let [x, y, z] = [1234_u32, 77, 2001];
        let hash = x ^ y.wrapping_mul(2_654_435_761) ^ z.wrapping_mul(805_459_861);
        assert!(fine.hashed && fine.entry([x, y, z]) == hash % (1 << 14));
    }

    #[test]
    fn levels_come_into_use_coarse_to_fine() {
        let mut config = Config::default();
        config.hash_grid = HashGridConfig { levels: 5, log2_entries: 10, ..config.hash_grid };
        let slot = &HashGrid.slots(&config)[0];
        let stage = |config: &Config, progress| HashGrid.stage(config, progress);
        assert_eq!(stage(&config, 0.0), 0, "by default all levels are in use from the start");
        config.hash_grid.inactive_levels = Schedule::new(vec![[0.0, 3.0], [0.25, 1.0], [0.5, 0.0]]);
        assert_eq!([0.0, 0.24, 0.25, 0.49, 0.5, 1.0].map(|at| stage(&config, at)), [3, 3, 1, 1, 0, 0]);
        let more_than_there_are = Schedule::new(vec![[0.0, 9.0], [0.5, 0.0]]);
        let least = HashGridConfig { inactive_levels: more_than_there_are, ..config.hash_grid.clone() };
        assert_eq!(least.active_at(0.0), 1, "one level is always in use");
        let levels = Levels::new(&config.hash_grid);
        for stage in 0..5 {
            let own = levels.active(stage).iter().map(|level| level.entries as usize * levels.features);
            assert_eq!(HashGrid.length(&config, slot, stage), own.sum::<usize>());
        }
        assert_eq!(HashGrid.length(&config, slot, 0), slot.range.len());
        // A level that comes into use begins at zero; levels in use keep their values.
        let mut values = vec![1.0; slot.range.len()];
        HashGrid.grow(&config, slot, &mut values, 3, 1);
        let [before, after] = [3, 1].map(|stage| HashGrid.length(&config, slot, stage));
        assert!(values[..before].iter().chain(&values[after..]).all(|value| *value == 1.0));
        assert!(values[before..after].iter().all(|value| *value == 0.0));
    }

    #[test]
    fn all_levels_are_in_use_at_the_end() {
        for (pieces, valid) in [
            ("[[0.0, 8], [0.5, 0]]", true),
            ("[[0.0, 8]]", false),
            ("[[0.0, 8], [0.5, 8], [0.6, 0]]", false),
            ("[[0.0, 4], [0.2, 8], [0.6, 0]]", false),
            ("[[0.0, 4.5], [0.5, 0]]", false),
            ("[[0.1, 4], [0.5, 0]]", false),
        ] {
            let mut settings = Settings::defaults();
            settings.apply_assignment(&format!("hash_grid.inactive_levels={pieces}")).unwrap();
            settings.apply_assignment("encoder.kind=\"hash-grid\"").unwrap();
            assert_eq!(Config::from_settings(&settings).is_ok(), valid, "{pieces}");
        }
    }
}
