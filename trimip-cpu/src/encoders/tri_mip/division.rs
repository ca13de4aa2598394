//! Divides the rows of the planes into bands, each of which one worker sums, and the bands among ranks.

use crate::encoders::bands::{BANDS, first_row, owner};
use trimip_core::engine::exchange::Rank;
use trimip_core::field::encoders::tri_mip::Pyramid;

/// Minimum number of row groups that a plane is divided into. More groups do not balance the work better.
const LEAST_UNITS: usize = 64;

/// Maximum number of levels above the base whose bands are nested.
const MOST_NESTED: u32 = 3;

/// The division of a pyramid. The bands of a plane are nested on its finest levels: a band covers the same area on each of
/// them, so that one rank can propagate a row's gradient to the base. Coarser levels have few texels, and every rank gets the
/// gradients of all of them.
pub struct Division {
    /// The rank of this process, which determines its bands.
    pub this_rank: Rank,
    rows: [usize; 3],
    /// The coarsest nested level of each plane.
    nested: [u32; 3],
}

impl Division {
    /// Divides `pyramid` among ranks; `this_rank` is the rank of this process.
    pub fn new(pyramid: &Pyramid, this_rank: Rank) -> Self {
        let rows = [0, 1, 2].map(|plane| pyramid.shape(0, plane).rows);
        let nested = rows.map(|rows| {
            let most = rows.trailing_zeros().min(MOST_NESTED).min(pyramid.levels as u32 - 1);
            (0..=most).rev().find(|nested| rows >> nested >= LEAST_UNITS).unwrap_or(0)
        });
        Self { this_rank, rows, nested }
    }

    /// Returns log2 of the number of rows that form a group on a level.
    #[inline(always)]
    fn shift(&self, plane: usize, level: usize) -> u32 {
        self.nested[plane].saturating_sub(level as u32)
    }

    /// Returns the band that owns a row.
    #[inline(always)]
    pub fn owner(&self, plane: usize, level: usize, row: usize) -> usize {
        let shift = self.shift(plane, level);
        owner(row >> shift, self.rows[plane] >> level >> shift)
    }

    /// Returns the first row of a band.
    pub fn first_row(&self, plane: usize, level: usize, band: usize) -> usize {
        let shift = self.shift(plane, level);
        first_row(band, self.rows[plane] >> level >> shift) << shift
    }

    /// Returns true if the rank `this_rank` sums this band.
    #[inline(always)]
    pub fn is_of(&self, this_rank: Rank, plane: usize, band: usize) -> bool {
        this_rank.has(plane * BANDS + band)
    }

    /// Returns true if this process sums this band.
    #[inline(always)]
    pub fn is_own(&self, plane: usize, band: usize) -> bool {
        self.is_of(self.this_rank, plane, band)
    }

    /// Returns true if every rank needs the gradient of this level.
    #[inline(always)]
    pub fn is_common(&self, plane: usize, level: usize) -> bool {
        level as u32 > self.nested[plane]
    }

    /// Returns the bands of `rank`: for each, its plane and its index in the plane.
    pub fn bands_of(&self, rank: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
        let this_rank = Rank { id: rank, size: self.this_rank.size };
        (0..3 * BANDS).filter(move |band| this_rank.has(*band)).map(|band| (band / BANDS, band % BANDS))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bands_meet_and_lie_under_each_other() {
        for sides in [[512_usize; 3], [336, 448, 768], [24, 40, 8], [64, 128, 320], [2, 2, 2]] {
            for levels in 1..=sides.iter().map(|side| side.trailing_zeros() as usize + 1).min().unwrap() {
                let pyramid = Pyramid { sides, levels, log2_base_radius: [0.0; 3] };
                let division = Division::new(&pyramid, Rank { id: 1, size: 3 });
                for (plane, level) in (0..3).flat_map(|plane| (0..levels).map(move |level| (plane, level))) {
                    let rows = pyramid.shape(level, plane).rows;
                    let mut next = 0;
                    for band in 0..BANDS {
                        let [from, to] = [band, band + 1].map(|band| division.first_row(plane, level, band));
                        assert_eq!(from, next);
                        (from..to).for_each(|row| assert_eq!(division.owner(plane, level, row), band));
                        next = to;
                    }
                    assert_eq!(next, rows);
                    if level > 0 && !division.is_common(plane, level) {
                        for row in 0..2 * rows {
                            let [child, parent] = [(level - 1, row), (level, row / 2)]
                                .map(|(l, r)| division.owner(plane, l, r));
                            assert_eq!(child, parent, "{sides:?}, plane {plane}, level {level}, row {row}");
                        }
                    }
                }
            }
        }
    }

    #[test]
    fn every_band_has_one_rank() {
        let pyramid = Pyramid { sides: [512; 3], levels: 8, log2_base_radius: [0.0; 3] };
        for of in 1..=5 {
            let division = Division::new(&pyramid, Rank { id: 0, size: of });
            let mut bands: Vec<_> = (0..of).flat_map(|rank| division.bands_of(rank)).collect();
            bands.sort_unstable();
            assert_eq!(bands.len(), 3 * BANDS);
            bands.dedup();
            assert_eq!(bands.len(), 3 * BANDS);
        }
    }
}
