//! Rules of the binary occupancy grid (instant-ngp, Appendix C): the choice of the cells to update, the decay of their
//! densities, and the threshold. At resolution R, cells are numbered x + R·(y + R·z). Positions are in the unit box.

use crate::{
    config::OccupancyConfig,
    math::{
        bits,
        rng::{Draws, Random, Sequence, unit},
    },
};

/// Returns the cell of a position in the unit box; for a position outside, the nearest cell.
#[inline]
pub fn cell_of(position: [f32; 3], resolution: u32) -> u32 {
    let [x, y, z] = position.map(|p| ((p * resolution as f32) as u32).min(resolution - 1));
    x + resolution * (y + resolution * z)
}

/// Returns the integer coordinates of a cell.
#[inline]
pub fn coordinates(cell: u32, resolution: u32) -> [u32; 3] {
    [cell % resolution, cell / resolution % resolution, cell / (resolution * resolution)]
}

/// Returns a random point of a cell, in the unit box.
#[inline]
pub fn point_in(cell: u32, resolution: u32, random: &Random, step: u64) -> [f32; 3] {
    let offset = random.uniform(Sequence::Point, step, cell);
    let corner = coordinates(cell, resolution);
    std::array::from_fn(|axis| (corner[axis] as f32 + offset[axis]) / resolution as f32)
}

/// Returns a unit direction from 32 random bits, uniform on the sphere. The upper half of the bits gives the height, the
/// lower half the angle.
#[inline]
pub fn direction_of(bits: u32) -> [f32; 3] {
    let part = |half: u32| (half as f32 + 0.5) / 65_536.0;
    let height = 2.0 * part(bits >> 16) - 1.0;
    let (sine, cosine) = (std::f32::consts::TAU * part(bits & 0xffff)).sin_cos();
    let radius = (1.0 - height * height).sqrt();
    [radius * cosine, radius * sine, height]
}

/// The cells of one update. A hash of each cell decides whether the cell is drawn. A share `fraction` of all cells is drawn
/// uniformly, and occupied cells are drawn in addition, up to the same share of the grid. No cell is drawn twice.
#[derive(Clone, Copy, Debug)]
pub struct Choice {
    draws: Draws,
    fraction: f32,
    occupied_probability: f32,
}

impl Choice {
    /// Chooses a `fraction` of all `cells` with the random numbers `draws` of a step; `occupied` is the number of occupied
    /// cells.
    pub fn new(draws: Draws, fraction: f32, occupied: usize, cells: usize) -> Self {
        let occupied_probability = fraction * cells as f32 / occupied.max(1) as f32;
        Self { draws, fraction, occupied_probability }
    }

    /// Returns true if `cell` is updated.
    #[inline]
    pub fn includes(&self, cell: u32, occupied: bool) -> bool {
        if self.fraction >= 1.0 {
            return true;
        }
        let [first, second, ..] = self.draws.bits(cell);
        unit(first) < self.fraction || (occupied && unit(second) < self.occupied_probability)
    }
}

/// Returns a cell's running maximum of density·step after an update: max(decay·old, new).
#[inline]
pub fn decayed(old: f32, new: f32, decay: f32) -> f32 {
    (decay * old).max(new)
}

/// Returns the mean of `densities`, one per cell, over all cells that are not [`OUTSIDE`].
pub fn mean(densities: &[f32]) -> f64 {
    let inside = || densities.iter().filter(|density| **density >= 0.0);
    inside().map(|&density| f64::from(density)).sum::<f64>() / inside().count().max(1) as f64
}

/// Returns the occupancy threshold: the mean over the grid, but at most the configured `threshold`. Cells above it are
/// occupied.
pub fn threshold(mean: f64, config: &OccupancyConfig) -> f32 {
    (mean as f32).min(config.threshold)
}

/// Density of a cell outside of the visual hull: it is never probed and never occupied.
pub const OUTSIDE: f32 = -1.0;

/// Returns the bits of a grid of half the `resolution`, which must be even. A coarse cell is occupied if any of its eight
/// children is. Both sets have one bit per cell, in the order of the cells' numbers and in the form of [`bits`].
pub fn coarsened(bits: &[u8], resolution: u32) -> Vec<u8> {
    let half = resolution / 2;
    let mut coarse = vec![0; (half as usize).pow(3).div_ceil(8)];
    for cell in 0..resolution.pow(3) {
        if bits::is_set(bits, cell as usize) {
            let [x, y, z] = coordinates(cell, resolution).map(|c| c / 2);
            let parent = x + half * (y + half * z);
            bits::set(&mut coarse, parent as usize);
        }
    }
    coarse
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Config;

    #[test]
    fn a_coarser_grid_holds_what_the_finer_one_held() {
        let random = Random::new(5);
        for resolution in [4_u32, 6, 10] {
            let cells = resolution.pow(3);
            let occupied = |cell: u32| random.bits(Sequence::Cell, 0, cell)[0].is_multiple_of(9);
            let bits = bits::of(cells as usize, |cell| occupied(cell as u32));
            let coarse = coarsened(&bits, resolution);
            let half = resolution / 2;
            for parent in 0..half.pow(3) {
                let corner = coordinates(parent, half).map(|c| 2 * c);
                let any = (0..8).any(|child| {
                    let [x, y, z] = [0, 1, 2].map(|axis| corner[axis] + (child >> axis & 1));
                    occupied(x + resolution * (y + resolution * z))
                });
                assert_eq!(bits::is_set(&coarse, parent as usize), any, "{resolution}: {parent}");
            }
        }
    }

    #[test]
    fn a_point_of_a_cell_lies_in_that_cell() {
        let random = Random::new(3);
        for resolution in [4, 20, 128] {
            for cell in (0..resolution * resolution * resolution).step_by(97) {
                assert_eq!(cell_of(point_in(cell, resolution, &random, 9), resolution), cell);
            }
        }
        assert_eq!(cell_of([-1.0, 2.0, f32::NAN], 4), 12);
    }

    #[test]
    fn an_empty_cell_falls_below_the_threshold_and_a_dense_one_stays() {
        let config = Config::default().occupancy;
        let mut occ = 1.0;
        for _ in 0..200 {
            occ = decayed(occ, 1e-6, config.decay);
        }
        assert!(occ < threshold(1.0, &config));
        assert_eq!(decayed(0.01, 0.7, config.decay), 0.7);
    }
}
