//! Scatters feature gradients to texel gradients, with the same bits for any number of threads and without atomics.
//! Each plane is cut into bands of rows. A sample is listed in every band that it touches, and one worker sums a band
//! in sample order. A row of a level belongs to exactly one band.

use super::Gradient;
use super::division::Division;
use super::extents::Extents;
use crate::buffer::take_mut;
use crate::encoders::bands::{BANDS, Extent};
use crate::simd::{Kernel, Lanes, Simd};
use rayon::prelude::*;
use std::ops::Range;
use trimip_core::batch::Sphere;
use trimip_core::encoders::tri_mip::{CHANNELS, FEATURES, PLANE_AXES, Pyramid, taps};

/// The rows of one band of one plane, on all levels.
pub struct Band<'a> {
    plane: usize,
    band: usize,
    levels: Vec<LevelBand<'a>>,
}

/// The rows of a band that belong to one level.
struct LevelBand<'a> {
    first_row: usize,
    texels: &'a mut [f32],
    /// The touched columns of each row.
    extents: &'a mut [Extent],
}

/// The reads of a sphere on a plane, at most two: level and weight.
#[inline(always)]
fn reads(pyramid: &Pyramid, plane: usize, log2_radius: f32) -> [(usize, f32); 2] {
    let blend = pyramid.blend(plane, log2_radius);
    [(blend.lower, 1.0 - blend.fraction), (blend.lower + 1, blend.fraction)]
}

/// Lists samples in every band that they touch.
pub struct Sort<'a> {
    /// The planes.
    pub pyramid: &'a Pyramid,
    /// Their division.
    pub division: &'a Division,
    /// Position and radius of each sample.
    pub spheres: &'a [Sphere],
    /// Index of the first sample.
    pub first: u32,
    /// Sample lists by plane and band.
    pub bands: &'a mut [Vec<u32>],
}

impl Kernel for Sort<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { pyramid, division, spheres, first, bands } = self;
        for (sphere, index) in spheres.iter().zip(first..) {
            let log2_radius = sphere.radius.log2();
            for (plane, [a, b]) in PLANE_AXES.into_iter().enumerate() {
                let mut touched = 0_u32;
                for (level, share) in reads(pyramid, plane, log2_radius) {
                    if share != 0.0 {
                        let shape = pyramid.shape(level, plane);
                        let [lower, upper] = taps(shape, sphere.position[a], sphere.position[b]).rows;
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

/// Overwrites `base` and `derived` with the sums of all deposits. Both are zero outside of `touched`, before and
/// after. Of the bands of other ranks nothing is touched.
pub fn spread(
    simd: Simd,
    pyramid: &Pyramid,
    division: &Division,
    gradients: &[&mut Gradient],
    base: &mut [f32],
    derived: &mut [f32],
    touched: &mut Extents,
) {
    let mut bands: Vec<Band<'_>> = (0..3 * BANDS)
        .map(|i| Band { plane: i / BANDS, band: i % BANDS, levels: Vec::with_capacity(pyramid.levels) })
        .collect();
    let mut rest = [base, derived];
    for (level, extents) in touched.iter_mut().enumerate() {
        let mut extents = extents.as_mut_slice();
        let texels = &mut rest[usize::from(level > 0)];
        for band in &mut bands {
            let shape = pyramid.shape(level, band.plane);
            let [from, to] =
                [band.band, band.band + 1].map(|next| division.first_row(band.plane, level, next));
            band.levels.push(LevelBand {
                first_row: from,
                texels: take_mut(texels, (to - from) * shape.row()),
                extents: take_mut(&mut extents, to - from),
            });
        }
    }
    let work = bands.into_par_iter().with_max_len(1);
    work.for_each(|band| simd.run(SpreadBand { pyramid, division, gradients, band }));
}

struct SpreadBand<'a> {
    pyramid: &'a Pyramid,
    division: &'a Division,
    gradients: &'a [&'a mut Gradient],
    band: Band<'a>,
}

impl Kernel for SpreadBand<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { division, band: Band { plane, band, mut levels }, .. } = self;
        let is_own = division.is_own(plane, band);
        for (level, LevelBand { texels, extents, .. }) in levels.iter_mut().enumerate() {
            let rows = texels.chunks_exact_mut(self.pyramid.shape(level, plane).row());
            // The gradient of another rank's rows is here on common levels alone.
            let is_here = is_own || division.is_common(plane, level);
            for (row, extent) in rows.zip(extents.iter_mut()) {
                let Range { start, end } = extent.texels();
                if is_here {
                    row[start * CHANNELS..end * CHANNELS].fill(0.0);
                }
                *extent = Extent::EMPTY;
            }
        }
        if !is_own {
            return;
        }
        let [a, b] = PLANE_AXES[plane];
        for gradient in self.gradients {
            for &index in &gradient.bands[plane * BANDS + band] {
                let sphere = &gradient.spheres[index as usize];
                let row = &gradient.rows[index as usize * FEATURES + plane * CHANNELS..];
                let values = L::of(&row.as_chunks().0[0]);
                for (level, share) in reads(self.pyramid, plane, sphere.radius.log2()) {
                    if share == 0.0 {
                        continue;
                    }
                    let shape = self.pyramid.shape(level, plane);
                    let taps = taps(shape, sphere.position[a], sphere.position[b]);
                    let LevelBand { first_row, texels, extents } = &mut levels[level];
                    for i in 0..2 {
                        if division.owner(plane, level, taps.rows[i]) != band {
                            continue;
                        }
                        extents[taps.rows[i] - *first_row].add(taps.columns[0], taps.columns[1]);
                        for j in 0..2 {
                            let row = (taps.rows[i] - *first_row) * shape.columns;
                            let texel = (row + taps.columns[j]) * CHANNELS;
                            let texel = &mut texels[texel..].as_chunks_mut().0[0];
                            let weight = L::splat(share * taps.weights[i][j]);
                            values.mul_add(weight, L::of(texel)).put(texel);
                        }
                    }
                }
            }
        }
    }
}
