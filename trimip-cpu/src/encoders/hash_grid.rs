//! The hash grid on the CPU. Each level's gradient is summed by a single worker, which gives the same bits for any
//! number of threads.

use super::{Encoding, GradientMemory, Places};
use crate::buffer::{Buffer, take_mut};
use crate::simd::{Kernel, Lanes, Simd};
use crate::wire::{Reader, put_counted};
use rayon::prelude::*;
use trimip_core::engine::batch::Sphere;
use trimip_core::field::encoders::SamplePosition;
use trimip_core::field::encoders::hash_grid::{Level, Levels, Points};
use trimip_core::{Aabb, Config, Result};

/// Levels of the grid and the instruction set.
pub(crate) struct Grid {
    simd: Simd,
    levels: Levels,
    points: Points<f32>,
}

/// A place in the unit cube, and the standard deviation around it in longest sides of the box.
type Point = [f32; 4];

/// The points of samples and the gradients of their features, [samples, width].
pub(crate) struct Gradient {
    places: Buffer<Point>,
    rows: Buffer<f32>,
}

impl Grid {
    /// The points of a tile's samples, which are the context unless a sample is read at its centre alone.
    fn points<'a>(&self, at: Places<'a>, context: &'a [f32]) -> &'a [Point] {
        if self.points.is_plain() { bytemuck::cast_slice(at.spheres) } else { context.as_chunks().0 }
    }
}

impl Encoding for Grid {
    type Gradient = Gradient;

    fn new(simd: Simd, config: &Config, _training: bool) -> Self {
        let points = Points::new(&config.hash_grid, &Aabb::new(&config.scene));
        Self { simd, levels: Levels::new(&config.hash_grid), points }
    }

    fn gradient(&self) -> Gradient {
        Gradient { places: Buffer::zeros(0), rows: Buffer::zeros(0) }
    }

    fn forward(&self, at: Places<'_>, context: &mut [f32], features: &mut [f32], stride: usize) {
        if !self.points.is_plain() {
            let rows = context.as_chunks_mut::<4>().0.chunks_exact_mut(self.points.count);
            for (((owner, interval), sphere), row) in
                at.owners.iter().zip(at.intervals).zip(at.spheres).zip(rows)
            {
                let Sphere { position, radius } = *sphere;
                let ray = &at.rays[*owner as usize];
                let (direction, t) = (ray.direction, ray.apex_distance(interval.t));
                let place = SamplePosition { position, radius, direction, t, length: interval.length };
                for (j, point) in row.iter_mut().enumerate() {
                    *point = self.points.point(j, &place);
                }
            }
        }
        let (levels, reads, places) = (&self.levels, &self.points, self.points(at, context));
        match levels.features {
            1 => self.simd.run(Read::<1> { levels, reads, table: at.parameters, places, features, stride }),
            2 => self.simd.run(Read::<2> { levels, reads, table: at.parameters, places, features, stride }),
            4 => self.simd.run(Read::<4> { levels, reads, table: at.parameters, places, features, stride }),
            _ => self.simd.run(Read::<8> { levels, reads, table: at.parameters, places, features, stride }),
        }
    }

    fn backward(
        &self,
        at: Places<'_>,
        context: &[f32],
        rows: &[f32],
        stride: usize,
        gradient: &mut Gradient,
    ) {
        let (first, width) = (gradient.rows.len(), self.levels.width());
        gradient.rows.resize(first + at.spheres.len() * width);
        let own = gradient.rows[first..].chunks_exact_mut(width).zip(rows.chunks_exact(stride));
        own.for_each(|(own, row)| own.copy_from_slice(&row[..width]));
        let points = self.points(at, context);
        let first = gradient.places.len();
        gradient.places.resize(first + points.len());
        gradient.places[first..].copy_from_slice(points);
    }

    fn reduce(&mut self, gradients: &mut [&mut Gradient], parameter_gradient: &mut [f32]) {
        let Self { simd, levels: Levels { levels, features }, points } = self;
        let (mut rest, width) = (parameter_gradient, levels.len() * *features);
        let tables = levels.iter().map(|level| take_mut(&mut rest, level.entries as usize * *features));
        let work: Vec<(usize, &mut [f32])> = tables.enumerate().collect();
        let from: &[&mut Gradient] = gradients;
        work.into_par_iter().with_max_len(1).for_each(|(index, table)| {
            table.fill(0.0);
            let level = Level { first: 0, ..levels[index] };
            let column = index * *features;
            match *features {
                1 => simd.run(Add::<1> { level, points, from, column, width, table }),
                2 => simd.run(Add::<2> { level, points, from, column, width, table }),
                4 => simd.run(Add::<4> { level, points, from, column, width, table }),
                _ => simd.run(Add::<8> { level, points, from, column, width, table }),
            }
        });
        for gradient in gradients {
            gradient.places.clear();
            gradient.rows.clear();
        }
    }

    fn put(&self, gradient: &Gradient, out: &mut Vec<u8>) {
        put_counted(out, &gradient.places);
        put_counted(out, &gradient.rows);
    }

    fn take(&self, from: &mut Reader<'_>, gradient: &mut Gradient) -> Result<()> {
        from.buffer(&mut gradient.places)?;
        from.buffer(&mut gradient.rows)?;
        let points = if self.points.is_plain() { 1 } else { self.points.count };
        from.expect("points", gradient.places.len() * self.levels.width(), gradient.rows.len() * points)
    }

    fn gradient_memory(config: &Config) -> GradientMemory {
        let width = Levels::new(&config.hash_grid).width();
        let points = config.hash_grid.points as usize * size_of::<Point>();
        GradientMemory { by_sample: width * size_of::<f32>() + points, by_partial: 0 }
    }
}

/// Reads every level with trilinear interpolation.
struct Read<'a, const F: usize> {
    levels: &'a Levels,
    reads: &'a Points<f32>,
    table: &'a [f32],
    /// The points of each sample.
    places: &'a [Point],
    features: &'a mut [f32],
    stride: usize,
}

impl<const F: usize> Kernel for Read<'_, F> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { levels, reads, table, places, features, stride } = self;
        let (entries, _) = table.as_chunks::<F>();
        let plain = reads.is_plain();
        for (points, row) in places.chunks_exact(reads.count).zip(features.chunks_exact_mut(stride)) {
            let (read, padding) = row.split_at_mut(levels.width());
            padding.fill(0.0);
            for (level, out) in levels.levels.iter().zip(read.as_chunks_mut::<F>().0) {
                let mut sum = [0.0; F];
                for [x, y, z, deviation] in points {
                    let level_weight = if plain { 1.0 } else { reads.level_weight(level, *deviation) };
                    for (entry, weight) in level.corners([*x, *y, *z]) {
                        let values = &entries[entry as usize];
                        (0..F).for_each(|i| sum[i] += level_weight * weight * values[i]);
                    }
                }
                *out = sum;
            }
        }
    }
}

/// Adds the gradients of one level, set by set and sample by sample.
struct Add<'a, const F: usize> {
    level: Level,
    points: &'a Points<f32>,
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
        let Self { level, points, from, column, width, table } = self;
        let (entries, _) = table.as_chunks_mut::<F>();
        let plain = points.is_plain();
        for gradient in from {
            let samples = gradient.places.chunks_exact(points.count);
            for (places, row) in samples.zip(gradient.rows.chunks_exact(width)) {
                let row = &row[column..column + F];
                for [x, y, z, deviation] in places {
                    let level_weight = if plain { 1.0 } else { points.level_weight(&level, *deviation) };
                    for (entry, weight) in level.corners([*x, *y, *z]) {
                        let values = &mut entries[entry as usize];
                        (0..F).for_each(|i| values[i] += level_weight * weight * row[i]);
                    }
                }
            }
        }
    }
}
