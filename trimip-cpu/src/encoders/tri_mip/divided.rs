//! The planes divided among ranks. A rank gets the samples that touch its bands, sums them, updates its rows, and sends the
//! changed texels. Columns travel as the intervals in which they are touched.

use super::{Gradient, Planes};
use crate::encoders::bands::{BANDS, Extent};
use crate::encoders::tri_mip::division::Division;
use crate::encoders::tri_mip::extents::Extents;
use crate::encoders::{Divided, Encoding, Piece};
use crate::wire::{Reader, put};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;
use trimip_core::encoders::tri_mip::{CHANNELS, FEATURES, PLANE_AXES};
use trimip_core::exchange::Share;

/// A sample on one plane.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct OnPlane {
    index: u32,
    /// Its position along the plane's axes, and its radius.
    at: [f32; 2],
    radius: f32,
    gradient: [f32; CHANNELS],
}

/// Writes the samples of a deposit that touch the bands of rank `to`.
pub fn put_samples(division: &Division, gradient: &Gradient, to: usize, out: &mut Vec<u8>) {
    put(out, &[gradient.spheres.len() as u64]);
    for (plane, band) in division.bands_of(to) {
        let list = &gradient.bands[plane * BANDS + band];
        put(out, &[list.len() as u64]);
        let [a, b] = PLANE_AXES[plane];
        for &index in list {
            let sphere = &gradient.spheres[index as usize];
            let mut values = [0.0; CHANNELS];
            let first = index as usize * FEATURES + plane * CHANNELS;
            values.copy_from_slice(&gradient.rows[first..first + CHANNELS]);
            let at = [sphere.position[a], sphere.position[b]];
            put(out, &[OnPlane { index, at, radius: sphere.radius, gradient: values }]);
        }
    }
}

/// Replaces a deposit by samples that touch this rank's bands. What belongs to other bands is not there.
pub fn take_samples(division: &Division, from: &mut Reader<'_>, gradient: &mut Gradient) {
    let samples = from.one::<u64>() as usize;
    gradient.spheres.resize(samples);
    gradient.rows.resize(samples * FEATURES);
    for (plane, band) in division.bands_of(division.share.rank) {
        let list = &mut gradient.bands[plane * BANDS + band];
        list.clear();
        let [a, b] = PLANE_AXES[plane];
        for _ in 0..from.one::<u64>() {
            let sample: OnPlane = from.one();
            let sphere = &mut gradient.spheres[sample.index as usize];
            (sphere.position[a], sphere.position[b], sphere.radius) =
                (sample.at[0], sample.at[1], sample.radius);
            let first = sample.index as usize * FEATURES + plane * CHANNELS;
            gradient.rows[first..first + CHANNELS].copy_from_slice(&sample.gradient);
            list.push(sample.index);
        }
    }
}

/// A row of a level of a plane.
struct Row {
    plane: usize,
    /// Where its extent stands among those of the level.
    index: usize,
    /// Where its texels begin among the floats of the level.
    first: usize,
}

impl Planes {
    /// The rows of a level in the bands of `rank`.
    fn rows_of(&self, rank: usize, level: usize) -> impl Iterator<Item = Row> + use<> {
        let shapes = [0, 1, 2].map(|plane| self.pyramid.shape(level, plane));
        let bands = self.division.bands_of(rank).map(|(plane, band)| {
            (plane, [band, band + 1].map(|band| self.division.first_row(plane, level, band)))
        });
        bands.collect::<Vec<_>>().into_iter().flat_map(move |(plane, [from, to])| {
            let before = &shapes[..plane];
            let rows: usize = before.iter().map(|shape| shape.rows).sum();
            let floats: usize = before.iter().map(|shape| shape.texels() * CHANNELS).sum();
            let row = shapes[plane].row();
            (from..to).map(move |own| Row { plane, index: rows + own, first: floats + own * row })
        })
    }

    /// The rows of the common levels in the bands of `rank`: level, and the row.
    fn common_rows(&self, rank: usize) -> Vec<(usize, Row)> {
        let levels =
            (1..self.pyramid.levels).flat_map(|level| self.rows_of(rank, level).map(move |row| (level, row)));
        levels.filter(|(level, row)| self.division.is_common(row.plane, *level)).collect()
    }

    /// The touched floats of a row, from the start of its level.
    fn touched_of(&self, level: usize, row: &Row) -> (Extent, Range<usize>) {
        let extent = self.touched.level(level)[row.index];
        let Range { start, end } = extent.texels();
        (extent, row.first + start * CHANNELS..row.first + end * CHANNELS)
    }
}

impl Divided for Planes {
    fn divide(&mut self, share: Share) {
        if share != self.division.share {
            self.division = Division::new(&self.pyramid, share);
            self.touched = Extents::whole(&self.pyramid);
        }
    }

    fn put_common(&self, out: &mut Vec<u8>) {
        for (level, row) in self.common_rows(self.division.share.rank) {
            let (extent, floats) = self.touched_of(level, &row);
            put(out, &[extent]);
            put(out, &self.derived_gradient[self.pyramid.offset(level, 0)..][floats]);
        }
    }

    fn take_common(&mut self, from: &mut Reader<'_>, rank: usize) {
        for (level, row) in self.common_rows(rank) {
            *self.touched.row_mut(level, row.index) = from.one();
            let (_, floats) = self.touched_of(level, &row);
            from.copy(&mut self.derived_gradient[self.pyramid.offset(level, 0)..][floats]);
        }
    }

    fn complete(&mut self, gradient: &mut [f32]) {
        self.pull(gradient);
    }

    fn pieces(&self) -> Option<Vec<Piece<'_>>> {
        self.touched()
    }

    fn put_changed(&self, parameters: &[f32], out: &mut Vec<u8>) {
        for row in self.rows_of(self.division.share.rank, 0) {
            let (extent, floats) = self.touched_of(0, &row);
            put(out, &[extent]);
            put(out, &parameters[floats]);
        }
    }

    fn take_changed(&mut self, from: &mut Reader<'_>, rank: usize, parameters: &mut [f32]) {
        for row in self.rows_of(rank, 0) {
            *self.touched.row_mut(0, row.index) = from.one();
            let (_, floats) = self.touched_of(0, &row);
            from.copy(&mut parameters[floats]);
        }
    }

    fn part(&self, rank: usize) -> Vec<Range<usize>> {
        let row = |row: Row| row.first..row.first + self.pyramid.shape(0, row.plane).row();
        self.rows_of(rank, 0).map(row).collect()
    }

    fn count_touched(&self) -> usize {
        self.touched.level(0).iter().map(|extent| extent.texels().len() * CHANNELS).sum()
    }
}
