//! Tri-mip encoding on the CPU: a texel's 16 channels fill one vector register, and a query sums at most 24 texels.

mod divided;
mod division;
mod extents;
mod scatter;

use self::division::Division;
use self::extents::Extents;
use self::scatter::{Gradient, Place, Scratch, Sort};
use super::bands::{BANDS, Extent};
use super::{Divided, Encoding, GradientMemory, Piece, Places};
use crate::buffer::{Buffer, take, take_mut};
use crate::reduction_tree::ReductionTree;
use crate::simd::{Kernel, Lanes, Simd, fetch};
use crate::wire::{Reader, put_counted};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::Mutex;
use trimip_core::engine::batch::Sphere;
use trimip_core::engine::exchange::Rank;
use trimip_core::field::encoders::tri_mip::{
    CHANNELS, FEATURES, PLANE_AXES, Pyramid, Shape, level_input, taps,
};
use trimip_core::{Aabb, Config, Result};

/// The planes and their mip levels.
pub(crate) struct Planes {
    simd: Simd,
    pyramid: Pyramid,
    /// The pyramid at full resolution; `pyramid` is the one at the current growth stage.
    whole: Pyramid,
    /// Division of the rows of `pyramid` among workers and ranks.
    division: Division,
    /// `train.leaves`.
    leaves: u32,
    /// Pool of unused scratch memory for sums over leaves.
    scratch: Mutex<Vec<Scratch>>,
    /// The texels whose gradient may be non-zero.
    touched: Extents,
    /// Levels above the base, see [`Pyramid::offset`].
    derived: Buffer<f32>,
    /// Gradient of `derived`.
    derived_gradient: Buffer<f32>,
    /// log2 of the sphere radius that corresponds to level 0; `None` unless the level of a sample is one of its
    /// features.
    reference: Option<f32>,
}

impl Encoding for Planes {
    type Gradient = Gradient;

    fn new(simd: Simd, config: &Config, training: bool) -> Self {
        let pyramid = Pyramid::new(&config.encoder, &Aabb::new(&config.scene));
        let derived = Buffer::zeros(pyramid.derived_len());
        let derived_gradient = Buffer::zeros(if training { pyramid.derived_len() } else { 0 });
        let touched = Extents::whole(&pyramid);
        let division = Division::new(&pyramid, Rank::ONLY);
        let reference = config.encoder.level_input.then(|| pyramid.reference() as f32);
        Self {
            simd,
            whole: pyramid.clone(),
            division,
            leaves: config.train.leaves,
            scratch: Mutex::default(),
            pyramid,
            touched,
            derived,
            derived_gradient,
            reference,
        }
    }

    fn gradient(&self) -> Gradient {
        Gradient { places: Buffer::zeros(0), rows: Buffer::zeros(0), bands: vec![Vec::new(); 3 * BANDS] }
    }

    fn grow(&mut self, stage: u32) {
        self.pyramid = self.whole.halved(stage);
        self.division = Division::new(&self.pyramid, self.division.this_rank);
        self.touched = Extents::whole(&self.pyramid);
    }

    fn refresh(&mut self, parameters: &[f32], all: bool) {
        if all {
            return self.average(parameters, &Extents::whole(&self.pyramid));
        }
        let touched = std::mem::take(&mut self.touched);
        self.average(parameters, &touched);
        self.touched = touched;
    }

    fn forward(&self, at: Places<'_>, _: &mut [f32], features: &mut [f32], stride: usize) {
        let Self { pyramid, derived, reference, .. } = self;
        let (base, spheres) = (&at.parameters[..pyramid.base_len()], at.spheres);
        self.simd.run(Gather { pyramid, base, derived, spheres, features, stride });
        if let Some(reference) = *reference {
            for (row, sphere) in features.chunks_exact_mut(stride).zip(spheres) {
                row[FEATURES] = level_input(sphere.radius.log2(), reference);
            }
        }
    }

    fn backward(&self, at: Places<'_>, _: &[f32], rows: &[f32], stride: usize, gradient: &mut Gradient) {
        let (first, count) = (gradient.places.len(), at.spheres.len());
        gradient.places.resize(first + count);
        let places = &mut gradient.places[first..];
        places.iter_mut().zip(at.spheres).for_each(|(place, sphere)| *place = sphere.into());
        gradient.rows.resize((first + count) * FEATURES);
        let kept = gradient.rows[first * FEATURES..].chunks_exact_mut(FEATURES);
        for (kept, row) in kept.zip(rows.chunks_exact(stride)) {
            kept.copy_from_slice(&row[..FEATURES]);
        }
        let Self { pyramid, division, .. } = self;
        let (places, bands) = (&gradient.places[first..], &mut gradient.bands);
        self.simd.run(Sort { pyramid, division, places, first: first as u32, bands });
    }

    fn reduce(&mut self, gradients: &mut [&mut Gradient], parameter_gradient: &mut [f32]) {
        let this_rank = self.division.this_rank;
        let tree = ReductionTree::new(self.leaves, gradients.len());
        let (sums, bands) = self.bands(parameter_gradient);
        let from: &[&mut Gradient] = gradients;
        let work = bands.into_par_iter().with_max_len(1);
        work.for_each(|mut band| sums.spread(from, tree, tree.of(this_rank), &mut band));
        if this_rank == Rank::ONLY {
            self.pull(parameter_gradient);
        }
        for gradient in gradients {
            gradient.places.clear();
            gradient.rows.clear();
            gradient.bands.iter_mut().for_each(Vec::clear);
        }
    }

    fn put(&self, gradient: &Gradient, out: &mut Vec<u8>) {
        put_counted(out, &gradient.places);
        put_counted(out, &gradient.rows);
        gradient.bands.iter().for_each(|band| put_counted(out, band));
    }

    fn take(&self, from: &mut Reader<'_>, gradient: &mut Gradient) -> Result<()> {
        from.buffer(&mut gradient.places)?;
        from.buffer(&mut gradient.rows)?;
        let samples = gradient.places.len();
        from.expect("gradients", gradient.rows.len(), samples * FEATURES)?;
        gradient.bands.iter_mut().try_for_each(|band| from.indices(band, samples))
    }

    fn divided(&mut self) -> Option<&mut dyn Divided> {
        Some(self)
    }

    fn gradient_memory(_: &Config) -> GradientMemory {
        // A sample stores its gradient, its sphere, and its index in the lists of the bands that it touches.
        let by_sample = size_of::<[f32; FEATURES]>() + size_of::<Place>() + 3 * 2 * size_of::<u32>();
        GradientMemory { by_sample, by_partial: 3 * BANDS * size_of::<Vec<u32>>() }
    }

    fn touched(&self) -> Option<Vec<Piece<'_>>> {
        let mut extents = self.touched.level(0);
        let piece = |plane| {
            let shape = self.pyramid.shape(0, plane);
            let rows = take(&mut extents, shape.rows);
            let within = Box::new(|row: usize| {
                let Range { start, end } = rows[row].texels();
                start * CHANNELS..end * CHANNELS
            });
            Piece { length: shape.rows * shape.row(), row: shape.row(), within }
        };
        Some([0, 1, 2].map(piece).into())
    }
}

impl Planes {
    /// Propagates the gradient from coarse to fine levels: each texel gets a quarter of its parent's gradient. Rows of
    /// other ranks are skipped.
    fn pull(&mut self, parameter_gradient: &mut [f32]) {
        let Self { simd, pyramid, division, derived_gradient, touched, .. } = self;
        let base = &mut parameter_gradient[..pyramid.base_len()];
        for level in (1..pyramid.levels).rev() {
            let (derived, coarser) = derived_gradient.split_at_mut(pyramid.offset(level, 0));
            let mut finer =
                if level == 1 { &mut base[..] } else { &mut derived[pyramid.offset(level - 1, 0)..] };
            let mut coarser = &coarser[..];
            let (mut fine_extents, mut extents) = touched.levels_mut(level - 1);
            for plane in 0..3 {
                let Shape { rows, .. } = pyramid.shape(level, plane);
                let row = pyramid.shape(level, plane).row();
                let coarse = take(&mut coarser, rows * row);
                let fine = take_mut(&mut finer, 4 * rows * row).par_chunks_mut(4 * row);
                let fine_rows = fine.zip(take_mut(&mut fine_extents, 2 * rows).par_chunks_mut(2));
                let rows = fine_rows.zip(take(&mut extents, rows)).enumerate().with_min_len(4);
                rows.for_each(|(r, ((fine, fine_extents), extent))| {
                    if extent.is_empty() {
                        return;
                    }
                    let is_here = |row: &usize| {
                        division.is_common(plane, level - 1)
                            || division.is_own(plane, division.owner(plane, level - 1, 2 * r + row))
                    };
                    let half = fine.len() / 2;
                    for own in [0, 1].into_iter().filter(is_here) {
                        let fine = &mut fine[own * half..][..half];
                        let columns = extent.texels();
                        simd.run(PullRow { coarse: &coarse[r * row..][..row], fine, columns });
                        fine_extents[own] = fine_extents[own].union(extent.doubled());
                    }
                });
            }
        }
    }

    /// Rebuilds the mip levels above the base texels in `changed`.
    fn average(&mut self, parameters: &[f32], changed: &Extents) {
        let Self { simd, pyramid, derived, .. } = self;
        let mut below = changed.level(0).to_vec();
        for level in 1..pyramid.levels {
            let (derived, mut coarser) = derived.split_at_mut(pyramid.offset(level, 0));
            let mut finer = if level == 1 {
                &parameters[..pyramid.base_len()]
            } else {
                &derived[pyramid.offset(level - 1, 0)..]
            };
            // Every plane of the finer level has an even number of rows, so pairs of rows stay within their plane.
            let above: Vec<Extent> =
                below.chunks_exact(2).map(|rows| rows[0].union(rows[1]).halved()).collect();
            let mut extents = &above[..];
            for plane in 0..3 {
                // Row r of this level covers rows 2r and 2r + 1 of the finer one.
                let Shape { rows, .. } = pyramid.shape(level, plane);
                let row = pyramid.shape(level, plane).row();
                let fine = take(&mut finer, 4 * rows * row).par_chunks(4 * row);
                let out = take_mut(&mut coarser, rows * row).par_chunks_mut(row);
                let rows = out.zip(fine).zip(take(&mut extents, rows)).with_min_len(4);
                rows.for_each(|((out, fine), extent)| {
                    simd.run(AverageRow { fine, out, columns: extent.texels() });
                });
            }
            below = above;
        }
    }
}

/// Averages 2×2 texels for some columns of a row; `fine` holds the two rows of the finer level.
struct AverageRow<'a> {
    fine: &'a [f32],
    out: &'a mut [f32],
    columns: Range<usize>,
}

impl Kernel for AverageRow<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let (lower, upper) = self.fine.split_at(self.fine.len() / 2);
        let Range { start, end } = self.columns;
        let below = 2 * CHANNELS * start..2 * CHANNELS * end;
        let (lower, upper) = (lower[below.clone()].as_chunks::<TWO>().0, upper[below].as_chunks::<TWO>().0);
        let out = self.out[CHANNELS * start..CHANNELS * end].as_chunks_mut().0;
        // Explicit vectors, because the compiler would vectorise across texels, with gather instructions.
        for ((lower, upper), out) in lower.iter().zip(upper).zip(out) {
            let pair = |two: &[f32; TWO]| {
                let texels = two.as_chunks().0;
                L::of(&texels[0]).add(L::of(&texels[1]))
            };
            pair(lower).add(pair(upper)).mul_add(L::splat(0.25), L::splat(0.0)).put(out);
        }
    }
}

/// Adds a quarter of each coarse texel's gradient to its two children in a row, for some columns.
struct PullRow<'a> {
    coarse: &'a [f32],
    fine: &'a mut [f32],
    columns: Range<usize>,
}

impl Kernel for PullRow<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Range { start, end } = self.columns;
        let parents = self.coarse[CHANNELS * start..CHANNELS * end].as_chunks().0;
        let children = self.fine[2 * CHANNELS * start..2 * CHANNELS * end].as_chunks_mut::<TWO>().0;
        for (children, parent) in children.iter_mut().zip(parents) {
            let parent = L::of(parent);
            for child in children.as_chunks_mut().0 {
                parent.mul_add(L::splat(0.25), L::of(child)).put(child);
            }
        }
    }
}

struct Gather<'a> {
    pyramid: &'a Pyramid,
    base: &'a [f32],
    derived: &'a [f32],
    spheres: &'a [Sphere],
    /// One row of `stride` floats per sample.
    features: &'a mut [f32],
    stride: usize,
}

/// Number of floats of two texels.
const TWO: usize = 2 * CHANNELS;

/// Number of samples whose texels are prefetched before the first of them is summed.
const AHEAD: usize = 8;

/// Maximum number of levels of a pyramid: planes have at most 4096 texels along a side.
const MOST_LEVELS: usize = 16;

/// One bilinear read: pointers to four texels, and the texels' weights multiplied by the weight of the mip level.
#[derive(Clone, Copy)]
struct Read {
    texels: [*const f32; 4],
    weights: [f32; 4],
}

/// The reads of a sample: one or two mip levels on each plane.
#[derive(Clone, Copy)]
struct Reads {
    reads: [[Read; 2]; 3],
    two: [bool; 3],
}

impl Gather<'_> {
    /// Returns pointers to the first texel of every level and plane.
    #[inline(always)]
    fn places(&self) -> [[*const f32; 3]; MOST_LEVELS] {
        let mut places = [[std::ptr::null(); 3]; MOST_LEVELS];
        for (level, planes) in places.iter_mut().enumerate().take(self.pyramid.levels) {
            for (plane, place) in planes.iter_mut().enumerate() {
                let values = if level == 0 { self.base } else { self.derived };
                *place = values[self.pyramid.range(level, plane)].as_ptr();
            }
        }
        places
    }

    /// Computes the reads of a sample and prefetches their texels.
    #[inline(always)]
    fn find(&self, places: &[[*const f32; 3]; MOST_LEVELS], sphere: &Sphere, to: &mut Reads) {
        let log2_radius = sphere.radius.log2();
        for (plane, [a, b]) in PLANE_AXES.into_iter().enumerate() {
            let blend = self.pyramid.blend(plane, log2_radius);
            to.two[plane] = blend.fraction != 0.0;
            let level_weights = [(blend.lower, 1.0 - blend.fraction), (blend.lower + 1, blend.fraction)];
            for (read, (level, level_weight)) in to.reads[plane].iter_mut().zip(level_weights) {
                if level_weight == 0.0 {
                    continue;
                }
                let shape = self.pyramid.shape(level, plane);
                let taps = taps(shape, sphere.position[a], sphere.position[b]);
                for i in 0..2 {
                    for j in 0..2 {
                        let texel = (taps.rows[i] * shape.columns + taps.columns[j]) * CHANNELS;
                        // SAFETY: `taps` clamps rows and columns to the shape, and the level holds all its texels.
                        let texel = unsafe { places[level][plane].add(texel) };
                        fetch(texel);
                        read.texels[2 * i + j] = texel;
                        read.weights[2 * i + j] = level_weight * taps.weights[i][j];
                    }
                }
            }
        }
    }
}

impl Kernel for Gather<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let places = self.places();
        let nothing = Read { texels: [std::ptr::null(); 4], weights: [0.0; 4] };
        let mut ahead = [Reads { reads: [[nothing; 2]; 3], two: [false; 3] }; AHEAD];
        for (first, spheres) in self.spheres.chunks(AHEAD).enumerate() {
            for (sphere, reads) in spheres.iter().zip(&mut ahead) {
                self.find(&places, sphere, reads);
            }
            let out = &mut self.features[first * AHEAD * self.stride..][..spheres.len() * self.stride];
            for (reads, out) in ahead.iter().zip(out.chunks_exact_mut(self.stride)) {
                for plane in 0..3 {
                    let mut sum = L::splat(0.0);
                    for read in &reads.reads[plane][..1 + usize::from(reads.two[plane])] {
                        for (texel, weight) in read.texels.into_iter().zip(read.weights) {
                            // SAFETY: `find` computed the pointer from texels that this kernel borrows.
                            sum = L::splat(weight).mul_add(unsafe { L::load(texel) }, sum);
                        }
                    }
                    sum.put(&mut out.as_chunks_mut().0[plane]);
                }
            }
        }
    }
}
