//! Passes over a whole ripmap: one pass averages texels from fine to coarse levels, the other adds gradients from
//! coarse to fine levels. Each pass covers one interval of columns per row.

use crate::encoders::bands::Extent;
use crate::simd::{Kernel, Lanes, Simd};
use rayon::prelude::*;
use std::ops::Range;
use trimip_core::field::encoders::rip_map::{CHANNELS, Plane};

/// Returns the unit of intervals, in columns of level 0. Interval ends are rounded to multiples of it, so that
/// intervals halve evenly on every level.
pub fn unit(plane: &Plane<f32>) -> u32 {
    1 << (plane.levels - 1)
}

/// Returns the number of floats of a plane's base.
pub fn base_len(plane: &Plane<f32>) -> usize {
    plane.sides[0] * plane.sides[1] * CHANNELS
}

/// Returns the number of floats of a plane's ripmap.
pub fn map_len(plane: &Plane<f32>) -> usize {
    plane.width() * plane.height() * CHANNELS
}

/// Returns the number of floats of a row of a ripmap.
fn row_len(plane: &Plane<f32>) -> usize {
    plane.width() * CHANNELS
}

/// Rebuilds the part of the ripmap `map` that depends on changed texels of `base`; `changed` has one interval per row
/// of the base.
pub fn average(simd: Simd, plane: &Plane<f32>, base: &[f32], map: &mut [f32], changed: &[Extent]) {
    let row = row_len(plane);
    let mut changed: Vec<Extent> = changed.iter().map(|extent| extent.aligned(unit(plane))).collect();
    for level in 0..plane.levels {
        let (finer, coarser) = map.split_at_mut(plane.row(level) * row);
        let rows = coarser.par_chunks_exact_mut(row).take(plane.sides[1] >> level).zip(&changed);
        let rows = rows.enumerate().with_min_len(4);
        match level {
            0 => rows.for_each(|(r, (out, extent))| {
                let columns = floats(extent.texels());
                let from = &base[r * plane.sides[0] * CHANNELS..];
                out[columns.clone()].copy_from_slice(&from[columns]);
                simd.run(AverageAlong { plane, row: out, extent: *extent });
            }),
            _ => {
                let finer = &finer[plane.row(level - 1) * row..];
                rows.for_each(|(r, (out, extent))| {
                    let columns = floats(extent.texels());
                    let [lower, upper] =
                        [2 * r, 2 * r + 1].map(|r| &finer[r * row..][..row][columns.clone()]);
                    simd.run(Mean { lower, upper, out: &mut out[columns] });
                    simd.run(AverageAlong { plane, row: out, extent: *extent });
                });
            }
        }
        changed = changed.chunks_exact(2).map(|pair| pair[0].union(pair[1])).collect();
    }
}

/// Sums the gradient of the ripmap `map` into the gradient of its base. `touched` has one interval for each row of the
/// map; texels outside the intervals are zero. On return, the intervals of the base's rows are the touched intervals of
/// `base`.
pub fn pull(simd: Simd, plane: &Plane<f32>, map: &mut [f32], base: &mut [f32], touched: &mut [Extent]) {
    let row = row_len(plane);
    touched.iter_mut().for_each(|extent| *extent = extent.aligned(unit(plane)));
    let rows = map.par_chunks_exact_mut(row).zip(&*touched).with_min_len(4);
    rows.for_each(|(row, extent)| simd.run(PullAlong { plane, row, extent: *extent }));
    for level in (1..plane.levels).rev() {
        let (finer, coarser) = map.split_at_mut(plane.row(level) * row);
        let (fine_extents, extents) = touched.split_at_mut(plane.row(level));
        let finer = finer[plane.row(level - 1) * row..].par_chunks_exact_mut(2 * row);
        let finer = finer.zip(fine_extents[plane.row(level - 1)..].par_chunks_exact_mut(2));
        let rows = finer.zip(coarser.par_chunks_exact(row)).zip(&*extents).with_min_len(4);
        rows.for_each(|(((finer, fine_extents), coarse), extent)| {
            let columns = floats(extent.texels());
            let (lower, upper) = finer.split_at_mut(row);
            for fine in [lower, upper] {
                simd.run(AddHalf { coarse: &coarse[columns.clone()], fine: &mut fine[columns.clone()] });
            }
            fine_extents.iter_mut().for_each(|fine| *fine = fine.union(*extent));
        });
    }
    let side = plane.sides[0] * CHANNELS;
    let rows = base.par_chunks_exact_mut(side).zip(map.par_chunks_exact(row)).zip(&*touched);
    rows.with_min_len(4).for_each(|((out, from), extent)| {
        let columns = floats(extent.texels());
        out[columns.clone()].copy_from_slice(&from[columns]);
    });
}

/// Returns the range of floats of a range of texels.
fn floats(texels: Range<usize>) -> Range<usize> {
    texels.start * CHANNELS..texels.end * CHANNELS
}

/// Returns those floats of a row on `level`, and on `level` + 1, that lie within an interval.
fn neighbours<'a>(
    plane: &Plane<f32>,
    row: &'a mut [f32],
    extent: Extent,
    level: usize,
) -> (&'a mut [f32], &'a mut [f32]) {
    let (fine, coarse) = row.split_at_mut(plane.column(level + 1) * CHANNELS);
    let fine = &mut fine[plane.column(level) * CHANNELS..];
    let Range { start, end } = extent.texels();
    (
        &mut fine[floats(start >> level..end >> level)],
        &mut coarse[floats(start >> (level + 1)..end >> (level + 1))],
    )
}

/// Number of floats of two texels.
const TWO: usize = 2 * CHANNELS;

/// Computes all levels of a row from its first level, as means of pairs of texels.
struct AverageAlong<'a> {
    plane: &'a Plane<f32>,
    row: &'a mut [f32],
    extent: Extent,
}

impl Kernel for AverageAlong<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        for level in 0..self.plane.levels - 1 {
            let (fine, coarse) = neighbours(self.plane, self.row, self.extent, level);
            let half = L::splat(0.5);
            for (out, pair) in coarse.as_chunks_mut().0.iter_mut().zip(fine.as_chunks::<TWO>().0) {
                let texels = pair.as_chunks().0;
                let second = L::of(&texels[1]).mul_add(half, L::splat(0.0));
                L::of(&texels[0]).mul_add(half, second).put(out);
            }
        }
    }
}

/// Adds half of each texel's gradient to its two finer texels, from the coarsest level of a row to its first.
struct PullAlong<'a> {
    plane: &'a Plane<f32>,
    row: &'a mut [f32],
    extent: Extent,
}

impl Kernel for PullAlong<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        if self.extent.is_empty() {
            return;
        }
        for level in (0..self.plane.levels - 1).rev() {
            let (fine, coarse) = neighbours(self.plane, self.row, self.extent, level);
            for (parent, pair) in coarse.as_chunks().0.iter().zip(fine.as_chunks_mut::<TWO>().0) {
                let parent = L::of(parent);
                for child in pair.as_chunks_mut().0 {
                    parent.mul_add(L::splat(0.5), L::of(child)).put(child);
                }
            }
        }
    }
}

/// Computes the mean of two rows.
struct Mean<'a> {
    lower: &'a [f32],
    upper: &'a [f32],
    out: &'a mut [f32],
}

impl Kernel for Mean<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let rows = self.lower.iter().zip(self.upper).zip(self.out);
        rows.for_each(|((lower, upper), out)| *out = 0.5 * lower + 0.5 * upper);
    }
}

/// Adds half of one row to another row.
struct AddHalf<'a> {
    coarse: &'a [f32],
    fine: &'a mut [f32],
}

impl Kernel for AddHalf<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        self.fine.iter_mut().zip(self.coarse).for_each(|(fine, coarse)| *fine += 0.5 * coarse);
    }
}
