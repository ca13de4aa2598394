//! Code shared by the encoders that store planes: bands of rows, each of which one worker sums, and the interval of
//! columns that a step touches in a row.

use crate::wire::Reader;
use std::ops::Range;
use trimip_core::{Result, engine::exchange::fault};

/// Bands per plane.
pub const BANDS: usize = 16;

/// Returns the band that owns a row of a plane that has `rows` rows on this level.
#[inline(always)]
pub fn owner(row: usize, rows: usize) -> usize {
    row * BANDS / rows
}

/// Returns the first row of a band.
pub fn first_row(band: usize, rows: usize) -> usize {
    (band * rows).div_ceil(BANDS)
}

/// Columns of a row, as a half-open interval.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Extent {
    start: u32,
    end: u32,
}

impl Extent {
    /// The empty interval.
    pub const EMPTY: Self = Self { start: u32::MAX, end: 0 };

    /// Returns the interval of all columns of a row.
    pub fn whole(columns: usize) -> Self {
        Self { start: 0, end: columns as u32 }
    }

    /// Reads the interval that another rank sent for a row of `columns` columns.
    ///
    /// # Errors
    /// When the message is too short, or the interval ends beyond the row.
    pub fn read(from: &mut Reader<'_>, columns: usize) -> Result<Self> {
        let extent: Self = from.one()?;
        if !extent.is_empty() && extent.end as usize > columns {
            return Err(fault(format_args!("expected columns up to {columns}, found {extent:?}")));
        }
        Ok(extent)
    }

    /// Returns true if the interval has no columns.
    pub fn is_empty(self) -> bool {
        self.start >= self.end
    }

    /// Extends the interval to the columns `first` to `last`, inclusive.
    #[inline(always)]
    pub fn add(&mut self, first: usize, last: usize) {
        self.start = self.start.min(first as u32);
        self.end = self.end.max(last as u32 + 1);
    }

    /// Returns the smallest interval that contains both intervals.
    pub fn union(self, other: Self) -> Self {
        Self { start: self.start.min(other.start), end: self.end.max(other.end) }
    }

    /// Returns the interval on the next finer level that covers the same area.
    pub fn doubled(self) -> Self {
        if self.is_empty() { self } else { Self { start: 2 * self.start, end: 2 * self.end } }
    }

    /// Returns the interval of texels on the next coarser level that cover this interval.
    pub fn halved(self) -> Self {
        if self.is_empty() { self } else { Self { start: self.start / 2, end: self.end.div_ceil(2) } }
    }

    /// Returns the smallest interval around this one whose ends are multiples of `unit`.
    pub fn aligned(self, unit: u32) -> Self {
        if self.is_empty() {
            return self;
        }
        Self { start: self.start / unit * unit, end: self.end.next_multiple_of(unit) }
    }

    /// Returns the columns as a range.
    pub fn texels(self) -> Range<usize> {
        if self.is_empty() { 0..0 } else { self.start as usize..self.end as usize }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn intervals_grow_and_cover_their_parents_and_children() {
        let mut extent = Extent::EMPTY;
        assert!(extent.is_empty() && extent.texels().is_empty() && extent.halved().is_empty());
        extent.add(5, 6);
        extent.add(9, 10);
        assert_eq!(extent.texels(), 5..11);
        assert_eq!(extent.halved().texels(), 2..6);
        assert_eq!(extent.doubled().texels(), 10..22);
        assert_eq!(extent.union(Extent::EMPTY), extent);
        assert_eq!(extent.aligned(4).texels(), 4..12);
        assert!(Extent::EMPTY.aligned(8).is_empty());
    }

    #[test]
    fn every_row_has_one_owner_and_bands_meet() {
        for side in [1, 2, 8, 16, 24, 40, 336, 512] {
            let mut rows = 0;
            for band in 0..BANDS {
                for row in first_row(band, side)..first_row(band + 1, side) {
                    assert_eq!(owner(row, side), band, "row {row} of {side}");
                    rows += 1;
                }
            }
            assert_eq!(rows, side);
        }
    }
}
