//! The hash grid on the CPU. A single worker sums each level's gradient, so the sums are bit-identical for any number
//! of threads.

use super::{Encoding, GradientMemory, Places};
use crate::buffer::{Buffer, take_mut};
use crate::simd::{Kernel, Lanes, Simd, fetch};
use crate::wire::{Reader, put_counted};
use rayon::prelude::*;
use trimip_core::engine::batch::Sphere;
use trimip_core::field::encoders::SamplePosition;
use trimip_core::field::encoders::hash_grid::{Level, Levels, PRIMES, Points};
use trimip_core::math::rounding::floor;
use trimip_core::{Aabb, Config, Result};

/// The grid's levels, with the instruction set that its kernels use.
pub(crate) struct Grid {
    simd: Simd,
    levels: Levels,
    /// Number of levels in use, coarse to fine.
    active: usize,
    points: Points<f32>,
}

/// A position (x, y, z) in the unit cube, then the standard deviation around it in units of the box's longest side.
type Point = [f32; 4];

/// Number of points whose corners are computed together: one vector register holds one quantity of a block.
const BLOCK: usize = 16;

/// Points at which samples read the grid, and the gradients of the samples' features.
pub(crate) struct Gradient {
    places: Buffer<Point>,
    /// Feature gradients of each level, [samples, features].
    rows: Vec<Buffer<f32>>,
}

impl Grid {
    /// Returns the points of a tile's samples: the context, or the spheres themselves if each sample reads the grid
    /// only at its centre.
    fn points<'a>(&self, at: Places<'a>, context: &'a [f32]) -> &'a [Point] {
        if self.points.is_plain() { bytemuck::cast_slice(at.spheres) } else { context.as_chunks().0 }
    }
}

impl Encoding for Grid {
    type Gradient = Gradient;

    fn new(simd: Simd, config: &Config, _training: bool) -> Self {
        let points = Points::new(&config.hash_grid, &Aabb::new(&config.scene));
        let levels = Levels::new(&config.hash_grid);
        Self { simd, active: levels.levels.len(), levels, points }
    }

    fn gradient(&self) -> Gradient {
        let rows = self.levels.levels.iter().map(|_| Buffer::zeros(0)).collect();
        Gradient { places: Buffer::zeros(0), rows }
    }

    fn grow(&mut self, stage: u32) {
        self.active = self.levels.active(stage).len();
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
        let (levels, reads, places) =
            (&self.levels.levels[..self.active], &self.points, self.points(at, context));
        match self.levels.features {
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
        let width = self.levels.features;
        for (level, own) in gradient.rows.iter_mut().take(self.active).enumerate() {
            let first = own.len();
            own.resize(first + at.spheres.len() * width);
            let pairs = own[first..].chunks_exact_mut(width).zip(rows.chunks_exact(stride));
            pairs.for_each(|(own, row)| own.copy_from_slice(&row[level * width..][..width]));
        }
        let points = self.points(at, context);
        let first = gradient.places.len();
        gradient.places.resize(first + points.len());
        gradient.places[first..].copy_from_slice(points);
    }

    fn reduce(&mut self, gradients: &mut [&mut Gradient], parameter_gradient: &mut [f32]) {
        let Self { simd, levels: Levels { levels, features }, active, points } = self;
        let levels = &levels[..*active];
        let mut rest = parameter_gradient;
        let tables = levels.iter().map(|level| take_mut(&mut rest, level.entries as usize * *features));
        let work: Vec<(usize, &mut [f32])> = tables.enumerate().collect();
        let from: &[&mut Gradient] = gradients;
        // Starts the finest levels first, because their entries are scattered most.
        work.into_par_iter().rev().with_max_len(1).for_each(|(index, table)| {
            table.fill(0.0);
            let level = Level { first: 0, ..levels[index] };
            match *features {
                1 => simd.run(Add::<1> { level, points, from, index, table }),
                2 => simd.run(Add::<2> { level, points, from, index, table }),
                4 => simd.run(Add::<4> { level, points, from, index, table }),
                _ => simd.run(Add::<8> { level, points, from, index, table }),
            }
        });
        for gradient in gradients {
            gradient.places.clear();
            gradient.rows.iter_mut().for_each(Buffer::clear);
        }
    }

    fn put(&self, gradient: &Gradient, out: &mut Vec<u8>) {
        put_counted(out, &gradient.places);
        gradient.rows.iter().for_each(|rows| put_counted(out, rows));
    }

    fn take(&self, from: &mut Reader<'_>, gradient: &mut Gradient) -> Result<()> {
        from.buffer(&mut gradient.places)?;
        let points = if self.points.is_plain() { 1 } else { self.points.count };
        for (level, rows) in gradient.rows.iter_mut().enumerate() {
            from.buffer(rows)?;
            let expected = if level < self.active { gradient.places.len() * self.levels.features } else { 0 };
            from.expect("points", expected, rows.len() * points)?;
        }
        Ok(())
    }

    fn gradient_memory(config: &Config) -> GradientMemory {
        let width = Levels::new(&config.hash_grid).width();
        let points = config.hash_grid.points as usize * size_of::<Point>();
        GradientMemory { by_sample: width * size_of::<f32>() + points, by_partial: 0 }
    }
}

/// The eight entries around each point of a block in one level, and their weights.
struct Corners {
    entries: [[u32; BLOCK]; 8],
    weights: [[f32; BLOCK]; 8],
}

impl Corners {
    /// Computes [`Level::corners`] for a block of positions, [axis, point], and multiplies the weights by
    /// `level_weights`.
    #[inline(always)]
    fn of(level: &Level, places: &[[f32; BLOCK]; 3], level_weights: &[f32; BLOCK]) -> Self {
        let (mut parts, mut fractions) = ([[[0; BLOCK]; 2]; 3], [[[0.0; BLOCK]; 2]; 3]);
        let strides = if level.hashed { PRIMES } else { [1, level.side, level.side * level.side] };
        for axis in 0..3 {
            for i in 0..BLOCK {
                let place = places[axis][i] * level.scale + 0.5;
                let (lower, index) = floor(place);
                let fraction = place - lower;
                fractions[axis][0][i] = 1.0 - fraction;
                fractions[axis][1][i] = fraction;
                parts[axis][0][i] = index.wrapping_mul(strides[axis]);
                parts[axis][1][i] = parts[axis][0][i].wrapping_add(strides[axis]);
            }
        }
        let mut all = Self { entries: [[0; BLOCK]; 8], weights: [[0.0; BLOCK]; 8] };
        for corner in 0..8 {
            let [x, y, z] = [0, 1, 2].map(|axis| corner >> axis & 1);
            let (entries, weights) = (&mut all.entries[corner], &mut all.weights[corner]);
            for i in 0..BLOCK {
                let weight = fractions[0][x][i] * fractions[1][y][i] * fractions[2][z][i];
                weights[i] = level_weights[i] * weight;
                let [a, b, c] = [parts[0][x][i], parts[1][y][i], parts[2][z][i]];
                let entry = match level.hashed {
                    true => (a ^ b ^ c) & (level.entries - 1),
                    false => {
                        // Indices beyond the last entry wrap around. They are less than twice the number of entries.
                        let entry = a + b + c;
                        if entry < level.entries { entry } else { entry - level.entries }
                    }
                };
                entries[i] = level.first + entry;
            }
        }
        all
    }

    /// Prefetches the entries of the first `count` points. If entries are narrow, every second corner suffices, because
    /// corners that are neighbours along the first axis mostly share a cache line.
    #[inline(always)]
    fn fetch<const F: usize>(&self, table: &[[f32; F]], count: usize) {
        for corner in (0..8).step_by(if F < 4 { 2 } else { 1 }) {
            for entry in &self.entries[corner][..count] {
                fetch(table.as_ptr().wrapping_add(*entry as usize));
            }
        }
    }
}

/// A block of points.
struct Block {
    /// [axis, point].
    places: [[f32; BLOCK]; 3],
    deviations: [f32; BLOCK],
    /// Index of each point's sample.
    owners: [usize; BLOCK],
    count: usize,
}

impl Block {
    /// Creates a block of at most [`BLOCK`] points. `first` is the index of its first point among all points; each sample
    /// has `reads.count` points.
    #[inline(always)]
    fn new(points: &[Point], first: usize, reads: &Points<f32>) -> Self {
        let mut block = Self {
            places: [[0.5; BLOCK]; 3],
            deviations: [0.0; BLOCK],
            owners: [0; BLOCK],
            count: points.len(),
        };
        for (i, [x, y, z, deviation]) in points.iter().enumerate() {
            (block.places[0][i], block.places[1][i], block.places[2][i]) = (*x, *y, *z);
            block.deviations[i] = *deviation;
            block.owners[i] = if reads.count == 1 { first + i } else { (first + i) / reads.count };
        }
        block
    }

    /// Returns the block of a gradient's points that begins with point `first`, and the block's corners; `None` after
    /// the last point.
    #[inline(always)]
    fn of(gradient: &Gradient, first: usize, level: &Level, reads: &Points<f32>) -> Option<(Self, Corners)> {
        let points = gradient.places.get(first..).filter(|points| !points.is_empty())?;
        let block = Self::new(&points[..points.len().min(BLOCK)], first, reads);
        let corners = block.corners(level, reads);
        Some((block, corners))
    }

    #[inline(always)]
    fn corners(&self, level: &Level, reads: &Points<f32>) -> Corners {
        let weights = match reads.is_plain() {
            true => [1.0; BLOCK],
            false if reads.is_within(level, self.deviations.into_iter().fold(0.0, f32::max)) => {
                [reads.level_weight(level, 0.0); BLOCK]
            }
            false => {
                // A separate loop, which the compiler vectorises.
                let mut weights = [0.0; BLOCK];
                for i in 0..BLOCK {
                    weights[i] = reads.level_weight(level, self.deviations[i]);
                }
                weights
            }
        };
        Corners::of(level, &self.places, &weights)
    }
}

/// Reads every level with trilinear interpolation.
struct Read<'a, const F: usize> {
    /// Levels in use.
    levels: &'a [Level],
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
        features[..places.len() / reads.count * stride].fill(0.0);
        for (index, points) in places.chunks(BLOCK).enumerate() {
            let block = Block::new(points, index * BLOCK, reads);
            let mut corners = block.corners(&levels[0], reads);
            for level in 0..levels.len() {
                // Prefetches the entries of the next level while the entries of this level are read.
                let next = levels.get(level + 1).map(|next| block.corners(next, reads));
                if let Some(next) = &next {
                    next.fetch(entries, block.count);
                }
                for i in 0..block.count {
                    let out = &mut features[block.owners[i] * stride + level * F..][..F];
                    let mut sum = [0.0; F];
                    for corner in 0..8 {
                        let values = entries[corners.entries[corner][i] as usize];
                        let weight = corners.weights[corner][i];
                        sum = std::array::from_fn(|f| sum[f] + weight * values[f]);
                    }
                    (0..F).for_each(|f| out[f] += sum[f]);
                }
                if let Some(next) = next {
                    corners = next;
                }
            }
        }
    }
}

/// Adds up the gradients of one level, one set of partial gradients after the other, in the order of samples.
struct Add<'a, const F: usize> {
    level: Level,
    points: &'a Points<f32>,
    from: &'a [&'a mut Gradient],
    /// Index of the level.
    index: usize,
    table: &'a mut [f32],
}

impl<const F: usize> Kernel for Add<'_, F> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { level, points: reads, from, index, table } = self;
        let (entries, _) = table.as_chunks_mut::<F>();
        for gradient in from {
            let (rows, _) = gradient.rows[index].as_chunks::<F>();
            let mut next = Block::of(gradient, 0, &level, reads);
            let mut first = 0;
            while let Some((block, corners)) = next {
                first += BLOCK;
                next = Block::of(gradient, first, &level, reads);
                if let Some((block, next)) = &next {
                    next.fetch(entries, block.count);
                }
                for i in 0..block.count {
                    let row = rows[block.owners[i]];
                    for corner in 0..8 {
                        let place = corners.entries[corner][i] as usize;
                        let weight = corners.weights[corner][i];
                        let before = entries[place];
                        entries[place] = std::array::from_fn(|f| before[f] + weight * row[f]);
                    }
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blocks_have_the_corners_of_their_points() {
        let levels = Levels::new(&trimip_core::config::HashGridConfig {
            log2_entries: 12,
            ..Config::default().hash_grid
        });
        let place = |i: usize, axis: usize| match i {
            0 => 0.0,
            1 => 1.0,
            _ => ((i * 37 + axis * 11) % 101) as f32 / 101.0,
        };
        let places = std::array::from_fn(|axis| std::array::from_fn(|i| place(i, axis)));
        let level_weights = std::array::from_fn(|i| 1.0 / (1 + i) as f32);
        for level in &levels.levels {
            let found = Corners::of(level, &places, &level_weights);
            for i in 0..BLOCK {
                let expected = level.corners::<f32>(std::array::from_fn(|axis| places[axis][i]));
                for (corner, (entry, weight)) in expected.into_iter().enumerate() {
                    assert_eq!(found.entries[corner][i], entry, "{level:?} point {i}");
                    assert_eq!(found.weights[corner][i], level_weights[i] * weight, "{level:?} point {i}");
                }
            }
        }
    }
}
