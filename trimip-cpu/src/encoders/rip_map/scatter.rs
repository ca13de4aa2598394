//! Adds feature gradients to the texels of all levels without atomics, bit-identically for any number of threads. The
//! scheme is that of the tri-mip planes: a sample is listed in each band of rows that it touches, and one worker sums a
//! band in sample order.

use super::passes::{base_len, map_len};
use crate::buffer::{Buffer, take_mut};
use crate::encoders::bands::{BANDS, Extent, first_row, owner};
use crate::simd::{Kernel, Lanes, Simd};
use rayon::prelude::*;
use trimip_core::field::encoders::rip_map::{CHANNELS, CONTEXT, Gaussian, Plane};

/// Feature gradients collected from several tiles and, for each plane and band of rows, the samples that touch the
/// band.
pub(crate) struct Gradient {
    /// The Gaussian of each sample.
    pub gaussians: Buffer<[f32; CONTEXT]>,
    /// Feature gradient of each sample, [samples, planes · 16].
    pub rows: Buffer<f32>,
    /// Sample indices by plane and band, in sample order.
    pub bands: Vec<Vec<u32>>,
}

/// Lists each sample in every band that it touches.
pub struct Sort<'a> {
    /// The planes.
    pub planes: &'a [Plane<f32>],
    /// One per sample.
    pub gaussians: &'a [[f32; CONTEXT]],
    /// Index of the first sample.
    pub first: u32,
    /// Sample lists by plane and band.
    pub bands: &'a mut [Vec<u32>],
}

impl Kernel for Sort<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { planes, gaussians, first, bands } = self;
        for (plane, bands) in planes.iter().zip(bands.chunks_exact_mut(BANDS)) {
            for (gaussian, index) in gaussians.iter().zip(first..) {
                let mut touched = 0_u32;
                for read in plane.reads(&Gaussian::of(gaussian)) {
                    if read.level_weight != 0.0 {
                        let rows = plane.sides[1] >> read.levels[1];
                        read.taps.rows.into_iter().for_each(|row| touched |= 1 << owner(row, rows));
                    }
                }
                while touched != 0 {
                    bands[touched.trailing_zeros() as usize].push(index);
                    touched &= touched - 1;
                }
            }
        }
    }
}

/// A band of one plane: its rows on each row level. A row holds all column levels.
struct Band<'a> {
    plane: usize,
    band: usize,
    /// For each level: the first row, the texels, and the touched columns of each row.
    levels: Vec<(usize, &'a mut [f32], &'a mut [Extent])>,
}

/// Overwrites `maps`, the gradients of all ripmaps, with the sums of all partial gradients. On entry and on return,
/// `maps` are zero outside of `touched`. `base`, the gradient of the parameters, is set to zero.
///
/// Shapes:
/// - `gradients`: one per set of partial gradients, summed in this order
/// - `maps`: [rows, columns, 16] of each plane's ripmap, plane by plane
/// - `touched`: for each plane, one extent per row of its ripmap
/// - `base`: [rows, columns, 16] of each plane's level (0, 0), plane by plane
pub fn spread(
    simd: Simd,
    planes: &[Plane<f32>],
    gradients: &[&mut Gradient],
    maps: &mut [f32],
    touched: &mut [Vec<Extent>],
    base: &mut [f32],
) {
    let (mut maps, mut base) = (maps, base);
    let mut bands = Vec::with_capacity(planes.len() * BANDS);
    for (p, (plane, touched)) in planes.iter().zip(touched).enumerate() {
        let side = plane.sides[0] * CHANNELS;
        let rows = take_mut(&mut base, base_len(plane)).par_chunks_exact_mut(side);
        rows.zip(&*touched).with_min_len(16).for_each(|(row, extent)| {
            let columns = extent.texels();
            row[columns.start * CHANNELS..columns.end * CHANNELS].fill(0.0);
        });
        let first = bands.len();
        bands.extend((0..BANDS).map(|band| Band {
            plane: p,
            band,
            levels: Vec::with_capacity(plane.levels),
        }));
        let (mut texels, mut extents) = (take_mut(&mut maps, map_len(plane)), touched.as_mut_slice());
        for rows in (0..plane.levels).map(|level| plane.sides[1] >> level) {
            for band in &mut bands[first..] {
                let (from, to) = (first_row(band.band, rows), first_row(band.band + 1, rows));
                let texels = take_mut(&mut texels, (to - from) * plane.width() * CHANNELS);
                band.levels.push((from, texels, take_mut(&mut extents, to - from)));
            }
        }
    }
    bands.into_par_iter().with_max_len(1).for_each(|band| simd.run(SpreadBand { planes, gradients, band }));
}

struct SpreadBand<'a> {
    planes: &'a [Plane<f32>],
    gradients: &'a [&'a mut Gradient],
    band: Band<'a>,
}

impl Kernel for SpreadBand<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { planes, gradients, band: Band { plane: p, band, mut levels } } = self;
        let (plane, features) = (&planes[p], planes.len() * CHANNELS);
        for (_, texels, extents) in &mut levels {
            let rows = texels.chunks_exact_mut(plane.width() * CHANNELS);
            for (row, extent) in rows.zip(extents.iter_mut()) {
                let columns = extent.texels();
                for level in 0..plane.levels {
                    let first = plane.column(level);
                    let [from, to] = [columns.start, columns.end].map(|c| (first + (c >> level)) * CHANNELS);
                    row[from..to].fill(0.0);
                }
                *extent = Extent::EMPTY;
            }
        }
        for gradient in gradients {
            for &index in &gradient.bands[p * BANDS + band] {
                let row = &gradient.rows[index as usize * features + p * CHANNELS..];
                let values = L::of(&row.as_chunks().0[0]);
                for read in plane.reads(&Gaussian::of(&gradient.gaussians[index as usize])) {
                    if read.level_weight == 0.0 {
                        continue;
                    }
                    let [i, j] = read.levels;
                    let (first_row, texels, extents) = &mut levels[j];
                    for (row, weights) in read.taps.rows.into_iter().zip(read.taps.weights) {
                        if owner(row, plane.sides[1] >> j) != band {
                            continue;
                        }
                        let row = row - *first_row;
                        let [left, right] = read.taps.columns;
                        extents[row].add(left << i, ((right + 1) << i) - 1);
                        for (column, weight) in [left, right].into_iter().zip(weights) {
                            let texel = (row * plane.width() + plane.column(i) + column) * CHANNELS;
                            let texel = &mut texels[texel..].as_chunks_mut().0[0];
                            values.mul_add(L::splat(read.level_weight * weight), L::of(texel)).put(texel);
                        }
                    }
                }
            }
        }
    }
}
