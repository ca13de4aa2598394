//! The texels of the planes that a step touches: one interval of columns in every row of every level. Passes over
//! gradient, moments and mip levels skip the other texels.

use std::ops::Range;
use trimip_core::encoders::tri_mip::{Pyramid, Shape};

/// Columns of a row, as a half-open interval.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    start: u32,
    end: u32,
}

impl Extent {
    /// The empty interval.
    pub const EMPTY: Self = Self { start: u32::MAX, end: 0 };

    /// True if the interval has no columns.
    pub fn is_empty(self) -> bool {
        self.start >= self.end
    }

    /// Extends the interval to the columns `first` to `last`, inclusive.
    #[inline(always)]
    pub fn add(&mut self, first: usize, last: usize) {
        self.start = self.start.min(first as u32);
        self.end = self.end.max(last as u32 + 1);
    }

    /// The smallest interval that contains both.
    pub fn union(self, other: Self) -> Self {
        Self { start: self.start.min(other.start), end: self.end.max(other.end) }
    }

    /// The same texels on the next finer level.
    pub fn doubled(self) -> Self {
        if self.is_empty() { self } else { Self { start: 2 * self.start, end: 2 * self.end } }
    }

    /// The texels on the next coarser level that cover these.
    pub fn halved(self) -> Self {
        if self.is_empty() { self } else { Self { start: self.start / 2, end: self.end.div_ceil(2) } }
    }

    /// The columns as a range.
    pub fn texels(self) -> Range<usize> {
        if self.is_empty() { 0..0 } else { self.start as usize..self.end as usize }
    }
}

/// One extent for each row of the three planes, on every level.
#[derive(Debug, Default)]
pub struct Extents {
    levels: Vec<Vec<Extent>>,
}

impl Extents {
    /// The extents of all texels.
    pub fn whole(pyramid: &Pyramid) -> Self {
        let level = |level| {
            let plane = |plane| {
                let Shape { rows, columns } = pyramid.shape(level, plane);
                std::iter::repeat_n(Extent { start: 0, end: columns as u32 }, rows)
            };
            (0..3).flat_map(plane).collect()
        };
        Self { levels: (0..pyramid.levels).map(level).collect() }
    }

    /// The extents of a level's rows, plane by plane.
    pub fn level(&self, level: usize) -> &[Extent] {
        &self.levels[level]
    }

    /// The extents of every level's rows.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut Vec<Extent>> {
        self.levels.iter_mut()
    }

    /// The extents of the rows of `level`, mutable, and of those of the next coarser level.
    pub fn levels_mut(&mut self, level: usize) -> (&mut [Extent], &[Extent]) {
        let (finer, coarser) = self.levels.split_at_mut(level + 1);
        (&mut finer[level], &coarser[0])
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
    }
}
