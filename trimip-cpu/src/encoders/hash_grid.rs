//! The hash grid on the CPU. Each level's gradient is summed by a single worker, which gives the same bits for any
//! number of threads.

use super::{Encoding, Left, Places};
use crate::buffer::{Buffer, take_mut};
use crate::simd::{Kernel, Lanes, Simd};
use rayon::prelude::*;
use trimip_core::Config;
use trimip_core::batch::Sphere;
use trimip_core::encoders::hash_grid::{Level, Levels};

/// Levels of the grid and the instruction set.
pub(crate) struct Grid {
    simd: Simd,
    levels: Levels,
}

/// Positions of samples and the gradients of their features, [samples, width].
pub(crate) struct Gradient {
    places: Buffer<[f32; 3]>,
    rows: Buffer<f32>,
}

impl Encoding for Grid {
    type Gradient = Gradient;

    fn new(simd: Simd, config: &Config, _training: bool) -> Self {
        Self { simd, levels: Levels::new(&config.hash_grid) }
    }

    fn gradient(&self) -> Gradient {
        Gradient { places: Buffer::zeros(0), rows: Buffer::zeros(0) }
    }

    fn forward(
        &self,
        parameters: &[f32],
        at: Places<'_>,
        _: &mut [f32],
        features: &mut [f32],
        stride: usize,
    ) {
        let (levels, spheres) = (&self.levels, at.spheres);
        match levels.features {
            1 => self.simd.run(Read::<1> { levels, table: parameters, spheres, features, stride }),
            2 => self.simd.run(Read::<2> { levels, table: parameters, spheres, features, stride }),
            4 => self.simd.run(Read::<4> { levels, table: parameters, spheres, features, stride }),
            _ => self.simd.run(Read::<8> { levels, table: parameters, spheres, features, stride }),
        }
    }

    fn backward(
        &self,
        _: &[f32],
        at: Places<'_>,
        _: &[f32],
        rows: &[f32],
        stride: usize,
        gradient: &mut Gradient,
    ) {
        let spheres = at.spheres;
        let (first, width) = (gradient.places.len(), self.levels.width());
        gradient.places.resize(first + spheres.len());
        gradient.rows.resize((first + spheres.len()) * width);
        let places = gradient.places[first..].iter_mut().zip(spheres);
        places.for_each(|(place, sphere)| *place = sphere.position);
        let own = gradient.rows[first * width..].chunks_exact_mut(width).zip(rows.chunks_exact(stride));
        own.for_each(|(own, row)| own.copy_from_slice(&row[..width]));
    }

    fn flush(&mut self, gradients: &mut [&mut Gradient], parameter_gradient: &mut [f32]) {
        let Self { simd, levels: Levels { levels, features } } = self;
        let (mut rest, width) = (parameter_gradient, levels.len() * *features);
        let tables = levels.iter().map(|level| take_mut(&mut rest, level.entries as usize * *features));
        let work: Vec<(usize, &mut [f32])> = tables.enumerate().collect();
        let from: &[&mut Gradient] = gradients;
        work.into_par_iter().with_max_len(1).for_each(|(index, table)| {
            table.fill(0.0);
            let level = Level { first: 0, ..levels[index] };
            let column = index * *features;
            match *features {
                1 => simd.run(Add::<1> { level, from, column, width, table }),
                2 => simd.run(Add::<2> { level, from, column, width, table }),
                4 => simd.run(Add::<4> { level, from, column, width, table }),
                _ => simd.run(Add::<8> { level, from, column, width, table }),
            }
        });
        for gradient in gradients {
            gradient.places.clear();
            gradient.rows.clear();
        }
    }

    fn left(config: &Config) -> Left {
        let width = Levels::new(&config.hash_grid).width();
        Left { by_sample: width * size_of::<f32>() + size_of::<[f32; 3]>(), by_deposit: 0 }
    }
}

/// Reads every level with trilinear interpolation.
struct Read<'a, const F: usize> {
    levels: &'a Levels,
    table: &'a [f32],
    spheres: &'a [Sphere],
    features: &'a mut [f32],
    stride: usize,
}

impl<const F: usize> Kernel for Read<'_, F> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { levels, table, spheres, features, stride } = self;
        let (entries, _) = table.as_chunks::<F>();
        for (sphere, row) in spheres.iter().zip(features.chunks_exact_mut(stride)) {
            let (read, padding) = row.split_at_mut(levels.width());
            padding.fill(0.0);
            for (level, out) in levels.levels.iter().zip(read.as_chunks_mut::<F>().0) {
                let mut sum = [0.0; F];
                for (entry, weight) in level.corners(sphere.position) {
                    let values = &entries[entry as usize];
                    (0..F).for_each(|i| sum[i] += weight * values[i]);
                }
                *out = sum;
            }
        }
    }
}

/// Adds the gradients of one level, deposit by deposit and sample by sample.
struct Add<'a, const F: usize> {
    level: Level,
    from: &'a [&'a mut Gradient],
    /// Column of the level's first feature in a row.
    column: usize,
    /// Floats in a row.
    width: usize,
    table: &'a mut [f32],
}

impl<const F: usize> Kernel for Add<'_, F> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { level, from, column, width, table } = self;
        let (entries, _) = table.as_chunks_mut::<F>();
        for gradient in from {
            for (place, row) in gradient.places.iter().zip(gradient.rows.chunks_exact(width)) {
                let row = &row[column..column + F];
                for (entry, weight) in level.corners(*place) {
                    let values = &mut entries[entry as usize];
                    (0..F).for_each(|i| values[i] += weight * row[i]);
                }
            }
        }
    }
}
