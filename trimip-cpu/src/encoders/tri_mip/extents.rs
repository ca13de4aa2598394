//! The texels of the planes that a step touches: one interval of columns in every row of every level. Passes over
//! gradients, AdamW moments and mip levels skip all other texels.

use crate::encoders::bands::Extent;
use trimip_core::field::encoders::tri_mip::{Pyramid, Shape};

/// One extent for each row of the three planes, on every level.
#[derive(Debug, Default)]
pub struct Extents {
    levels: Vec<Vec<Extent>>,
}

impl Extents {
    /// Creates extents that cover all texels.
    pub fn whole(pyramid: &Pyramid) -> Self {
        let level = |level| {
            let plane = |plane| {
                let Shape { rows, columns } = pyramid.shape(level, plane);
                std::iter::repeat_n(Extent::whole(columns), rows)
            };
            (0..3).flat_map(plane).collect()
        };
        Self { levels: (0..pyramid.levels).map(level).collect() }
    }

    /// Returns the extents of a level's rows, plane by plane.
    pub fn level(&self, level: usize) -> &[Extent] {
        &self.levels[level]
    }

    /// Returns the extent of a row; `row` is its index among the rows of its level on all planes.
    pub fn row_mut(&mut self, level: usize, row: usize) -> &mut Extent {
        &mut self.levels[level][row]
    }

    /// Iterates over the levels: the extents of each level's rows.
    pub fn iter_mut(&mut self) -> impl Iterator<Item = &mut Vec<Extent>> {
        self.levels.iter_mut()
    }

    /// Returns the extents of `level`, mutable, and those of the next coarser level: one per row, plane by plane.
    pub fn levels_mut(&mut self, level: usize) -> (&mut [Extent], &[Extent]) {
        let (finer, coarser) = self.levels.split_at_mut(level + 1);
        (&mut finer[level], &coarser[0])
    }
}
