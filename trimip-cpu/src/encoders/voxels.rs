//! A grid of densities and spherical harmonics on the CPU. Gradients are stored per sample: a sample is listed in each band
//! of layers (z) that it touches, and one worker sums a band in sample order.

use super::bands::{BANDS, first_row, owner};
use super::{Encoding, GradientMemory, Places};
use crate::buffer::{Buffer, take_mut};
use crate::simd::{Kernel, Lanes, Simd};
use crate::wire::{Reader, put_counted};
use rayon::prelude::*;
use std::ops::Range;
use trimip_core::field::encoders::tensor::between;
use trimip_core::field::encoders::voxels::{Shape, WIDTH, slots};
use trimip_core::math::sh::{COUNT, spherical_harmonics};
use trimip_core::{Config, Result};

/// Maximum number of floats for a grid point's colours.
const MOST: usize = 3 * COUNT;

/// The grid's shape, and the ranges of its values in the parameters.
pub(crate) struct Grid {
    simd: Simd,
    /// Shapes at all growth stages; `shape` is the one in use.
    shapes: Vec<Shape>,
    shape: Shape,
    density: Range<usize>,
    colors: Range<usize>,
}

/// Position and direction with which a sample reads the grid, and the gradient of the sample's features.
#[repr(C)]
#[derive(Clone, Copy, bytemuck::Pod, bytemuck::Zeroable)]
pub(crate) struct Touch {
    position: [f32; 3],
    direction: [f32; 3],
    by_feature: [f32; WIDTH],
}

/// Gradients collected from several tiles.
pub(crate) struct Gradient {
    touches: Buffer<Touch>,
    /// For each band: the samples that touch it, in order.
    bands: Vec<Vec<u32>>,
}

impl Encoding for Grid {
    type Gradient = Gradient;

    fn new(simd: Simd, config: &Config, _training: bool) -> Self {
        let mut slots = slots(config).into_iter().map(|slot| slot.range);
        let mut next = || slots.next().unwrap_or_default();
        let shape = Shape::new(config, 0);
        Self { simd, shapes: Shape::all(config), shape, density: next(), colors: next() }
    }

    fn gradient(&self) -> Gradient {
        Gradient { touches: Buffer::zeros(0), bands: vec![Vec::new(); BANDS] }
    }

    fn grow(&mut self, stage: u32) {
        self.shape = self.shapes[stage as usize].clone();
    }

    fn forward(&self, at: Places<'_>, _: &mut [f32], features: &mut [f32], stride: usize) {
        let [density, colors] = [&self.density, &self.colors].map(|range| &at.parameters[range.clone()]);
        self.simd.run(Read { shape: &self.shape, density, colors, at, features, stride });
    }

    fn backward(&self, at: Places<'_>, _: &[f32], rows: &[f32], stride: usize, gradient: &mut Gradient) {
        let layers = self.shape.sides[2];
        let first = gradient.touches.len();
        gradient.touches.resize(first + at.spheres.len());
        let samples = at.spheres.iter().zip(at.owners).zip(rows.chunks_exact(stride));
        for (index, ((sphere, owned), row)) in (first..).zip(samples) {
            let direction = at.rays[*owned as usize].direction;
            let by_feature = std::array::from_fn(|i| row[i]);
            gradient.touches[index] = Touch { position: sphere.position, direction, by_feature };
            let layer = between(layers, sphere.position[2]).0;
            let bands = [layer, layer + 1].map(|layer| owner(layer, layers));
            gradient.bands[bands[0]].push(index as u32);
            if bands[1] != bands[0] {
                gradient.bands[bands[1]].push(index as u32);
            }
        }
    }

    fn reduce(&mut self, gradients: &mut [&mut Gradient], parameter_gradient: &mut [f32]) {
        let Self { simd, shape, density, colors, .. } = self;
        let layer = shape.sides[0] * shape.sides[1];
        let (head, tail) = parameter_gradient.split_at_mut(colors.start);
        let (mut densities, mut rest) = (&mut head[density.clone()], &mut tail[..colors.len()]);
        let work = (0..BANDS).map(|band| {
            let [first, end] = [band, band + 1].map(|band| first_row(band, shape.sides[2]) * layer);
            let density = take_mut(&mut densities, end - first);
            let colors = take_mut(&mut rest, (end - first) * shape.colors());
            (band, first, density, colors)
        });
        let work: Vec<_> = work.collect();
        let from: &[&mut Gradient] = gradients;
        let shape = &*shape;
        work.into_par_iter().with_max_len(1).for_each(|(band, first, density, colors)| {
            density.fill(0.0);
            colors.fill(0.0);
            simd.run(Add { shape, from, band, first, density, colors });
        });
        for gradient in gradients {
            gradient.touches.clear();
            gradient.bands.iter_mut().for_each(Vec::clear);
        }
    }

    fn put(&self, gradient: &Gradient, out: &mut Vec<u8>) {
        put_counted(out, &gradient.touches);
        gradient.bands.iter().for_each(|band| put_counted(out, band));
    }

    fn take(&self, from: &mut Reader<'_>, gradient: &mut Gradient) -> Result<()> {
        from.buffer(&mut gradient.touches)?;
        let samples = gradient.touches.len();
        gradient.bands.iter_mut().try_for_each(|band| from.indices(band, samples))
    }

    fn gradient_memory(_: &Config) -> GradientMemory {
        // Most samples are listed in one band; a sample between two bands is listed in both.
        GradientMemory { by_sample: size_of::<Touch>() + 2 * size_of::<u32>(), by_partial: 0 }
    }
}

/// Reads densities and colours.
struct Read<'a> {
    shape: &'a Shape,
    density: &'a [f32],
    colors: &'a [f32],
    at: Places<'a>,
    features: &'a mut [f32],
    stride: usize,
}

impl Kernel for Read<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { shape, density, colors, at, features, stride } = self;
        let (count, width) = (shape.harmonics, shape.colors());
        let samples = at.spheres.iter().zip(at.owners);
        let (mut last, mut basis) = (None, [0.0; COUNT]);
        for ((sphere, owned), row) in samples.zip(features.chunks_exact_mut(stride)) {
            if last != Some(*owned) {
                last = Some(*owned);
                basis = spherical_harmonics(at.rays[*owned as usize].direction);
            }
            let (mut sum, mut sums) = (0.0, [0.0; MOST]);
            for (point, weight) in shape.corners(sphere.position) {
                sum += weight * density[point];
                let own = &colors[point * width..][..width];
                sums.iter_mut().zip(own).for_each(|(sum, value)| *sum += weight * value);
            }
            row.fill(0.0);
            row[0] = sum;
            for (value, sums) in row[1..WIDTH].iter_mut().zip(sums.chunks_exact(count)) {
                *value = sums.iter().zip(basis).map(|(a, b)| a * b).sum();
            }
        }
    }
}

/// Sums the gradients of a band, one set of partial gradients after the other, in the order of samples.
struct Add<'a> {
    shape: &'a Shape,
    from: &'a [&'a mut Gradient],
    band: usize,
    /// Index of the band's first grid point.
    first: usize,
    density: &'a mut [f32],
    colors: &'a mut [f32],
}

impl Kernel for Add<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { shape, from, band, first, density, colors } = self;
        let (count, width) = (shape.harmonics, shape.colors());
        for gradient in from {
            for &index in &gradient.bands[band] {
                let Touch { position, direction, by_feature } = gradient.touches[index as usize];
                let basis = spherical_harmonics(direction);
                let mut by_color = [0.0; MOST];
                for (c, by_color) in by_color[..width].chunks_exact_mut(count).enumerate() {
                    by_color.iter_mut().zip(basis).for_each(|(g, b)| *g = by_feature[1 + c] * b);
                }
                for (point, weight) in shape.corners(position) {
                    let Some(own) = point.checked_sub(first).filter(|own| *own < density.len()) else {
                        continue;
                    };
                    density[own] += weight * by_feature[0];
                    let values = &mut colors[own * width..][..width];
                    values.iter_mut().zip(&by_color).for_each(|(value, g)| *value += weight * g);
                }
            }
        }
    }
}
