//! Planes that are divided among ranks. A rank sums the gradients of its leaves of a step, receives the other ranks' sums
//! for its bands, updates these bands, and sends the changed texels. Only the touched interval of columns of each row is
//! sent.

use super::Planes;
use super::scatter::{Band, Sums};
use crate::encoders::bands::Extent;
use crate::encoders::tri_mip::division::Division;
use crate::encoders::tri_mip::extents::Extents;
use crate::encoders::{Divided, Encoding, Piece};
use crate::wire::{Reader, put};
use rayon::prelude::*;
use std::ops::Range;
use trimip_core::Result;
use trimip_core::engine::exchange::Rank;
use trimip_core::field::encoders::tri_mip::CHANNELS;

/// A row of a level of a plane.
struct PlaneRow {
    plane: usize,
    /// Index of the row's extent among the extents of its level.
    index: usize,
    /// Index of the row's first float among the floats of its level.
    first: usize,
}

impl Planes {
    /// Returns the bands of all planes, and the [`Sums`] that sums gradients over them.
    pub(super) fn bands<'a>(&'a mut self, gradient: &'a mut [f32]) -> (Sums<'a>, Vec<Band<'a>>) {
        let Self { simd, pyramid, division, derived_gradient, touched, scratch, .. } = self;
        let base = &mut gradient[..pyramid.base_len()];
        let sums = Sums { simd: *simd, pyramid, division, scratch };
        (sums, Band::all(pyramid, division, base, derived_gradient, touched))
    }

    /// Returns the rows of a level that lie in the bands of `rank`.
    fn rows_of(&self, rank: usize, level: usize) -> impl Iterator<Item = PlaneRow> + use<> {
        let shapes = [0, 1, 2].map(|plane| self.pyramid.shape(level, plane));
        let bands = self.division.bands_of(rank).map(|(plane, band)| {
            (plane, [band, band + 1].map(|band| self.division.first_row(plane, level, band)))
        });
        bands.collect::<Vec<_>>().into_iter().flat_map(move |(plane, [from, to])| {
            let before = &shapes[..plane];
            let rows: usize = before.iter().map(|shape| shape.rows).sum();
            let floats: usize = before.iter().map(|shape| shape.texels() * CHANNELS).sum();
            let row = shapes[plane].row();
            (from..to).map(move |own| PlaneRow { plane, index: rows + own, first: floats + own * row })
        })
    }

    /// Returns the touched columns of a row, and the range of their floats relative to the start of the level.
    fn touched_of(&self, level: usize, row: &PlaneRow) -> (Extent, Range<usize>) {
        let extent = self.touched.level(level)[row.index];
        let Range { start, end } = extent.texels();
        (extent, row.first + start * CHANNELS..row.first + end * CHANNELS)
    }
}

impl Divided for Planes {
    fn divide(&mut self, this_rank: Rank) {
        if this_rank != self.division.this_rank {
            self.division = Division::new(&self.pyramid, this_rank);
            self.touched = Extents::whole(&self.pyramid);
        }
    }

    fn put_sums(&mut self, gradient: &mut [f32], to: usize, out: &mut Vec<u8>) {
        let to = Rank { id: to, size: self.division.this_rank.size };
        let (sums, bands) = self.bands(gradient);
        for band in bands {
            // Each band is preceded by its length, so that a reader finds a band without decoding the previous bands.
            let start = out.len();
            put(out, &[0_u64]);
            sums.put(to, &band, out);
            let length = (out.len() - start - size_of::<u64>()) as u64;
            out[start..start + size_of::<u64>()].copy_from_slice(&length.to_ne_bytes());
        }
    }

    fn take_sums(&mut self, from: &[Vec<u8>], gradient: &mut [f32]) -> Result<()> {
        let own = self.division.this_rank.id;
        let mut readers: Vec<Reader<'_>> = from.iter().map(|bytes| Reader::new(bytes)).collect();
        let (sums, bands) = self.bands(gradient);
        let mut work = Vec::new();
        for band in bands {
            // This rank sends itself nothing.
            let of_band = readers.iter_mut().enumerate().map(|(rank, reader)| match rank == own {
                true => Ok(&[][..]),
                false => reader.counted_bytes(),
            });
            work.push((band, of_band.collect::<Result<Vec<_>>>()?));
        }
        readers
            .iter()
            .enumerate()
            .filter(|(rank, _)| *rank != own)
            .try_for_each(|(_, reader)| reader.end())?;
        work.into_par_iter().with_max_len(1).try_for_each(|(mut band, from)| sums.gather(&from, &mut band))
    }

    fn complete(&mut self, gradient: &mut [f32]) {
        self.pull(gradient);
    }

    fn pieces(&self) -> Option<Vec<Piece<'_>>> {
        self.touched()
    }

    fn put_changed(&self, parameters: &[f32], out: &mut Vec<u8>) {
        for row in self.rows_of(self.division.this_rank.id, 0) {
            let (extent, floats) = self.touched_of(0, &row);
            put(out, &[extent]);
            put(out, &parameters[floats]);
        }
    }

    fn take_changed(&mut self, from: &mut Reader<'_>, rank: usize, parameters: &mut [f32]) -> Result<()> {
        for row in self.rows_of(rank, 0) {
            let columns = self.pyramid.shape(0, row.plane).columns;
            *self.touched.row_mut(0, row.index) = Extent::read(from, columns)?;
            let (_, floats) = self.touched_of(0, &row);
            from.copy(&mut parameters[floats])?;
        }
        Ok(())
    }

    fn part(&self, rank: usize) -> Vec<Range<usize>> {
        let row = |row: PlaneRow| row.first..row.first + self.pyramid.shape(0, row.plane).row();
        self.rows_of(rank, 0).map(row).collect()
    }

    fn count_touched(&self) -> usize {
        self.touched.level(0).iter().map(|extent| extent.texels().len() * CHANNELS).sum()
    }
}
