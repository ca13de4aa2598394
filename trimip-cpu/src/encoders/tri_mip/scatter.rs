//! Adds feature gradients to texel gradients without atomics, bit-identically for any number of threads. Each plane is
//! divided into bands of rows. A sample is listed in every band that it touches, and one worker sums a band in sample
//! order. A row of a level belongs to exactly one band.

use super::division::Division;
use super::extents::Extents;
use crate::buffer::{Buffer, take_mut};
use crate::encoders::bands::{BANDS, Extent};
use crate::reduction_tree::{ReductionTree, halves};
use crate::simd::{Kernel, Lanes, Simd};
use crate::wire::{Reader, put};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;
use std::sync::{Mutex, PoisonError};
use trimip_core::Result;
use trimip_core::engine::batch::Sphere;
use trimip_core::engine::exchange::Rank;
use trimip_core::field::encoders::tri_mip::{CHANNELS, FEATURES, PLANE_AXES, Pyramid, taps};

/// Feature gradients collected from several tiles and, for each plane and band of rows, the samples that touch the
/// band.
pub(crate) struct Gradient {
    /// Position and radius of each sample.
    pub places: Buffer<Place>,
    /// Feature gradient of each sample, [samples, 48].
    pub rows: Buffer<f32>,
    /// Sample indices by plane and band, in sample order.
    pub bands: Vec<Vec<u32>>,
}

/// Position and radius at which a sample reads the planes.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct Place {
    position: [f32; 3],
    /// log2 of the radius. Each band that the sample touches computes the sample's mip levels from it.
    log2_radius: f32,
}

impl From<&Sphere> for Place {
    fn from(sphere: &Sphere) -> Self {
        Self { position: sphere.position, log2_radius: sphere.radius.log2() }
    }
}

/// The rows of one band of one plane, on all levels.
pub struct Band<'a> {
    /// Index of the plane.
    pub plane: usize,
    /// Index of the band in its plane.
    pub band: usize,
    levels: Vec<LevelBand<'a>>,
}

/// The rows of a band that belong to one level.
struct LevelBand<'a> {
    first_row: usize,
    /// Number of floats in a row.
    row: usize,
    texels: &'a mut [f32],
    /// The touched columns of each row.
    extents: &'a mut [Extent],
}

impl LevelBand<'_> {
    /// Sets all gradients to zero.
    fn clear(&mut self) {
        for (row, extent) in self.texels.chunks_exact_mut(self.row).zip(self.extents.iter_mut()) {
            let Range { start, end } = extent.texels();
            row[start * CHANNELS..end * CHANNELS].fill(0.0);
            *extent = Extent::EMPTY;
        }
    }
}

impl<'a> Band<'a> {
    /// Returns the bands of all planes, ordered by plane.
    ///
    /// Shapes:
    /// - `base`: [rows, columns, 16] of each plane, plane by plane: the gradient of level 0
    /// - `derived`: as `base` for each of the levels above, level by level
    pub fn all(
        pyramid: &Pyramid,
        division: &Division,
        base: &'a mut [f32],
        derived: &'a mut [f32],
        touched: &'a mut Extents,
    ) -> Vec<Self> {
        let mut bands: Vec<Self> = (0..3 * BANDS)
            .map(|i| Self { plane: i / BANDS, band: i % BANDS, levels: Vec::with_capacity(pyramid.levels) })
            .collect();
        let mut rest = [base, derived];
        for (level, extents) in touched.iter_mut().enumerate() {
            let mut extents = extents.as_mut_slice();
            let texels = &mut rest[usize::from(level > 0)];
            for band in &mut bands {
                band.take_level(pyramid, division, level, texels, &mut extents);
            }
        }
        bands
    }

    /// Adds the band's rows on the next level, which it takes off the front of `texels` and `extents`.
    fn take_level(
        &mut self,
        pyramid: &Pyramid,
        division: &Division,
        level: usize,
        texels: &mut &'a mut [f32],
        extents: &mut &'a mut [Extent],
    ) {
        let row = pyramid.shape(level, self.plane).row();
        let [from, to] = [self.band, self.band + 1].map(|next| division.first_row(self.plane, level, next));
        self.levels.push(LevelBand {
            first_row: from,
            row,
            texels: take_mut(texels, (to - from) * row),
            extents: take_mut(extents, to - from),
        });
    }
}

/// Scratch memory for the sum of one band; all zero between uses.
#[derive(Default)]
pub struct Scratch {
    texels: Buffer<f32>,
    extents: Vec<Extent>,
}

impl Scratch {
    /// Returns a band in this memory that has the same rows as `other`.
    fn like(&mut self, pyramid: &Pyramid, division: &Division, other: &Band<'_>) -> Band<'_> {
        let floats: usize = other.levels.iter().map(|level| level.texels.len()).sum();
        let rows: usize = other.levels.iter().map(|level| level.extents.len()).sum();
        self.texels.resize(floats.max(self.texels.len()));
        self.extents.resize(rows.max(self.extents.len()), Extent::EMPTY);
        let mut band = Band { plane: other.plane, band: other.band, levels: Vec::new() };
        let (mut texels, mut extents) = (&mut self.texels[..], &mut self.extents[..]);
        for level in 0..other.levels.len() {
            band.take_level(pyramid, division, level, &mut texels, &mut extents);
        }
        band
    }
}

/// Returns the two mip levels that a sphere reads on a plane, with their weights. A level of weight 0 is not read.
#[inline(always)]
fn reads(pyramid: &Pyramid, plane: usize, log2_radius: f32) -> [(usize, f32); 2] {
    let blend = pyramid.blend(plane, log2_radius);
    [(blend.lower, 1.0 - blend.fraction), (blend.lower + 1, blend.fraction)]
}

/// Lists each sample in every band that it touches.
pub struct Sort<'a> {
    /// The planes.
    pub pyramid: &'a Pyramid,
    /// Division of the planes into bands.
    pub division: &'a Division,
    /// Position and radius of each sample.
    pub places: &'a [Place],
    /// Index of the first sample.
    pub first: u32,
    /// Sample lists by plane and band.
    pub bands: &'a mut [Vec<u32>],
}

impl Kernel for Sort<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { pyramid, division, places, first, bands } = self;
        for (place, index) in places.iter().zip(first..) {
            for (plane, [a, b]) in PLANE_AXES.into_iter().enumerate() {
                let mut touched = 0_u32;
                for (level, level_weight) in reads(pyramid, plane, place.log2_radius) {
                    if level_weight != 0.0 {
                        let shape = pyramid.shape(level, plane);
                        let [lower, upper] = taps(shape, place.position[a], place.position[b]).rows;
                        let owner = |row| division.owner(plane, level, row);
                        touched |= 1 << owner(lower) | 1 << owner(upper);
                    }
                }
                while touched != 0 {
                    bands[plane * BANDS + touched.trailing_zeros() as usize].push(index);
                    touched &= touched - 1;
                }
            }
        }
    }
}

/// Sums gradients into bands.
pub struct Sums<'a> {
    /// Instruction set.
    pub simd: Simd,
    /// The planes.
    pub pyramid: &'a Pyramid,
    /// Division of the planes into bands.
    pub division: &'a Division,
    /// Pool of unused scratch memory.
    pub scratch: &'a Mutex<Vec<Scratch>>,
}

impl Sums<'_> {
    /// Overwrites a band with the sum of the leaves `own` of a step. `gradients` are all sets of partial gradients of
    /// the step, in order; `tree` assigns them to leaves.
    pub fn spread(
        &self,
        gradients: &[&mut Gradient],
        tree: ReductionTree,
        own: Range<usize>,
        band: &mut Band<'_>,
    ) {
        band.levels.iter_mut().for_each(LevelBand::clear);
        self.add_leaves(gradients, tree, own, band);
    }

    /// Adds the sum of the leaves `own` to a band that holds zeros.
    fn add_leaves(
        &self,
        gradients: &[&mut Gradient],
        tree: ReductionTree,
        own: Range<usize>,
        band: &mut Band<'_>,
    ) {
        let list = band.plane * BANDS + band.band;
        if own.len() == 1 {
            let leaf = gradients.iter().skip(own.start).step_by(tree.count());
            let Self { pyramid, division, .. } = *self;
            for gradient in leaf.filter(|gradient| !gradient.bands[list].is_empty()) {
                self.simd.run(SpreadBand { pyramid, division, gradient, band });
            }
            return;
        }
        let [left, right] = halves(own);
        self.add_leaves(gradients, tree, left, band);
        self.beside(band, |other| self.add_leaves(gradients, tree, right, other));
    }

    /// Passes a temporary band of zeros to `fill`, then adds the temporary band to `band`. Returns the result of
    /// `fill`.
    fn beside<R>(&self, band: &mut Band<'_>, fill: impl FnOnce(&mut Band<'_>) -> R) -> R {
        let unused = || self.scratch.lock().unwrap_or_else(PoisonError::into_inner);
        let mut scratch = unused().pop().unwrap_or_default();
        let mut other = scratch.like(self.pyramid, self.division, band);
        let filled = fill(&mut other);
        self.simd.run(AddBand { from: &mut other, band });
        unused().push(scratch);
        filled
    }

    /// Adds the sums that the other ranks sent to a band that holds this rank's sum; `from` is indexed by rank. If another
    /// rank owns the band, only the common levels of the band are kept.
    ///
    /// # Errors
    /// When a message is not what [`put`](Self::put) writes for this rank.
    pub fn gather(&self, from: &[&[u8]], band: &mut Band<'_>) -> Result<()> {
        if !self.division.is_own(band.plane, band.band) {
            let plane = band.plane;
            let levels = band.levels.iter_mut().enumerate();
            let foreign = levels.filter(|(level, _)| !self.division.is_common(plane, *level));
            foreign.for_each(|(_, level)| level.clear());
        }
        self.add_ranks(from, 0..from.len(), band)
    }

    /// Adds the sums of `ranks` to a band in the order of the reduction tree. On entry, the band holds this rank's sum if
    /// this rank is among `ranks`, and zeros otherwise.
    fn add_ranks(&self, from: &[&[u8]], ranks: Range<usize>, band: &mut Band<'_>) -> Result<()> {
        let own = self.division.this_rank.id;
        if ranks.len() == 1 {
            return match ranks.start == own {
                true => Ok(()),
                false => self.add_message(from[ranks.start], band),
            };
        }
        // The half with this rank comes first; swapping two summands does not change the bits of their sum.
        let [left, right] = halves(ranks);
        let [here, other] = if right.contains(&own) { [right, left] } else { [left, right] };
        self.add_ranks(from, here, band)?;
        if other.len() == 1 {
            return self.add_message(from[other.start], band);
        }
        self.beside(band, |beside| self.add_ranks(from, other, beside))
    }

    /// Returns the levels of a band that are sent to rank `to`.
    fn levels(&self, to: Rank, band: &Band<'_>) -> Range<usize> {
        let Self { division, pyramid, .. } = self;
        let first_common = (0..pyramid.levels).find(|level| division.is_common(band.plane, *level));
        match division.is_of(to, band.plane, band.band) {
            true => 0..pyramid.levels,
            false => first_common.unwrap_or(pyramid.levels)..pyramid.levels,
        }
    }

    /// Appends the part of this rank's sum that rank `to` needs to the message `out`: for each row, its extent, then the
    /// gradients of its touched texels.
    pub fn put(&self, to: Rank, band: &Band<'_>, out: &mut Vec<u8>) {
        for LevelBand { row, texels, extents, .. } in &band.levels[self.levels(to, band)] {
            for (row, extent) in texels.chunks_exact(*row).zip(extents.iter()) {
                let Range { start, end } = extent.texels();
                put(out, &[*extent]);
                put(out, &row[start * CHANNELS..end * CHANNELS]);
            }
        }
    }

    /// Adds the sum that another rank wrote for this rank.
    fn add_message(&self, message: &[u8], band: &mut Band<'_>) -> Result<()> {
        let levels = self.levels(self.division.this_rank, band);
        let mut reader = Reader::new(message);
        for LevelBand { row, texels, extents, .. } in &mut band.levels[levels] {
            for (row, extent) in texels.chunks_exact_mut(*row).zip(extents.iter_mut()) {
                let other = Extent::read(&mut reader, row.len() / CHANNELS)?;
                let Range { start, end } = other.texels();
                let values = reader.bytes((end - start) * CHANNELS * size_of::<f32>())?;
                let values = values.as_chunks().0.iter().map(|bytes| f32::from_ne_bytes(*bytes));
                let sums = row[start * CHANNELS..end * CHANNELS].iter_mut();
                sums.zip(values).for_each(|(sum, value)| *sum += value);
                *extent = extent.union(other);
            }
        }
        reader.end()
    }
}

/// Adds the gradients of one set of partial gradients, sample by sample, to a band.
struct SpreadBand<'a, 'b> {
    pyramid: &'a Pyramid,
    division: &'a Division,
    gradient: &'a Gradient,
    band: &'a mut Band<'b>,
}

impl Kernel for SpreadBand<'_, '_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { pyramid, division, gradient, band: Band { plane, band, levels } } = self;
        let (plane, band) = (*plane, *band);
        let [a, b] = PLANE_AXES[plane];
        for &index in &gradient.bands[plane * BANDS + band] {
            let place = &gradient.places[index as usize];
            let row = &gradient.rows[index as usize * FEATURES + plane * CHANNELS..];
            let values = L::of(&row.as_chunks().0[0]);
            for (level, level_weight) in reads(pyramid, plane, place.log2_radius) {
                if level_weight == 0.0 {
                    continue;
                }
                let shape = pyramid.shape(level, plane);
                let taps = taps(shape, place.position[a], place.position[b]);
                let LevelBand { first_row, texels, extents, .. } = &mut levels[level];
                for i in 0..2 {
                    if division.owner(plane, level, taps.rows[i]) != band {
                        continue;
                    }
                    extents[taps.rows[i] - *first_row].add(taps.columns[0], taps.columns[1]);
                    for j in 0..2 {
                        let row = (taps.rows[i] - *first_row) * shape.columns;
                        let texel = (row + taps.columns[j]) * CHANNELS;
                        let texel = &mut texels[texel..].as_chunks_mut().0[0];
                        let weight = L::splat(level_weight * taps.weights[i][j]);
                        values.mul_add(weight, L::of(texel)).put(texel);
                    }
                }
            }
        }
    }
}

/// Adds the band `from` to `band`, and sets `from` to zero.
struct AddBand<'a, 'b, 'c> {
    from: &'a mut Band<'b>,
    band: &'a mut Band<'c>,
}

impl Kernel for AddBand<'_, '_, '_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        for (from, to) in self.from.levels.iter_mut().zip(&mut self.band.levels) {
            let rows = from.texels.chunks_exact_mut(from.row).zip(to.texels.chunks_exact_mut(to.row));
            let extents = from.extents.iter_mut().zip(to.extents.iter_mut());
            for ((from, to), (extent, union)) in rows.zip(extents) {
                let Range { start, end } = extent.texels();
                let columns = start * CHANNELS..end * CHANNELS;
                let texels = from[columns.clone()].as_chunks_mut().0.iter_mut();
                for (from, to) in texels.zip(to[columns].as_chunks_mut().0) {
                    L::of(to).add(L::of(from)).put(to);
                    *from = [0.0; CHANNELS];
                }
                *union = union.union(*extent);
                *extent = Extent::EMPTY;
            }
        }
    }
}
