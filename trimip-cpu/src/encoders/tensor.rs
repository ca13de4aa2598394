//! Factored tensors on the CPU; kernels process sixteen components at a time. Line gradients are summed immediately, into arrays of
//! each set of partial gradients. Plane gradients are stored per sample: a sample is listed in each band of rows that it touches, and
//! one worker sums a band in sample order.

use super::bands::{BANDS, first_row, owner};
use super::{Encoding, GradientMemory, Places};
use crate::buffer::{Buffer, take_mut};
use crate::simd::{Kernel, Lanes, Simd, fetch};
use crate::wire::{Reader, put, put_counted};
use rayon::prelude::*;
use std::ops::Range;
use trimip_core::engine::batch::Sphere;
use trimip_core::field::encoders::tensor::{
    KINDS, Kind, LANES, LINE_AXES, PLANE_AXES, Shape, between, slots,
};
use trimip_core::{Config, Result};

/// The shape of the factors, and their ranges in the parameters.
pub(crate) struct Factors {
    simd: Simd,
    /// Shapes at all growth stages; `shape` is the one in use.
    shapes: Vec<Shape>,
    shape: Shape,
    arrays: [Arrays; 2],
}

/// Ranges of a tensor's factors in the parameters.
#[derive(Clone)]
struct Arrays {
    kind: Kind,
    /// Empty if there are no planes.
    planes: Range<usize>,
    lines: Range<usize>,
}

/// Gradients collected from several tiles.
pub(crate) struct Gradient {
    places: Buffer<[f32; 3]>,
    /// Gradient with respect to each plane's value at each sample, [samples, width].
    rows: Buffer<f32>,
    /// For each band of each plane: the samples that touch it, in order.
    bands: Vec<Vec<u32>>,
    /// Gradients of the lines of both tensors.
    lines: [Buffer<f32>; 2],
}

/// A position along an axis: index of the grid point before it, and the interpolation weight of the grid point after
/// it.
type Along = (usize, f32);

impl Factors {
    /// Returns a sample's position along each axis.
    #[inline(always)]
    fn along(shape: &Shape, position: [f32; 3]) -> [Along; 3] {
        std::array::from_fn(|axis| between(shape.sides[axis], position[axis]))
    }

    fn width(&self) -> usize {
        KINDS.iter().map(|kind| self.shape.features(*kind)).sum()
    }

    fn arrays(config: &Config) -> [Arrays; 2] {
        let mut slots = slots(config).into_iter().map(|slot| slot.range);
        let planes = Shape::new(config, 0).planes() > 0;
        KINDS.map(|kind| Arrays {
            kind,
            planes: if planes { slots.next().unwrap_or_default() } else { 0..0 },
            lines: slots.next().unwrap_or_default(),
        })
    }
}

impl Encoding for Factors {
    type Gradient = Gradient;

    fn new(simd: Simd, config: &Config, _training: bool) -> Self {
        let shape = Shape::new(config, 0);
        Self { simd, shapes: Shape::all(config), shape, arrays: Self::arrays(config) }
    }

    fn gradient(&self) -> Gradient {
        Gradient {
            places: Buffer::zeros(0),
            rows: Buffer::zeros(0),
            bands: vec![Vec::new(); 3 * BANDS],
            lines: self.arrays.clone().map(|arrays| Buffer::zeros(arrays.lines.len())),
        }
    }

    fn grow(&mut self, stage: u32) {
        self.shape = self.shapes[stage as usize].clone();
    }

    fn forward(&self, at: Places<'_>, _: &mut [f32], features: &mut [f32], stride: usize) {
        let (Self { shape, arrays, .. }, parameters) = (self, at.parameters);
        let width = self.width();
        for row in features.chunks_exact_mut(stride) {
            row[width..].fill(0.0);
        }
        self.simd.run(Read { shape, arrays, parameters, spheres: at.spheres, features, stride });
    }

    fn backward(&self, at: Places<'_>, _: &[f32], rows: &[f32], stride: usize, gradient: &mut Gradient) {
        let Self { shape, arrays, .. } = self;
        let (parameters, spheres) = (at.parameters, at.spheres);
        if shape.planes() > 0 {
            let (first, width) = (gradient.places.len(), self.width());
            gradient.places.resize(first + spheres.len());
            gradient.rows.resize((first + spheres.len()) * width);
            for (index, sphere) in (first..).zip(spheres) {
                gradient.places[index] = sphere.position;
                let along = Self::along(shape, sphere.position);
                for plane in 0..3 {
                    let (row, side) = (along[PLANE_AXES[plane][1]].0, shape.plane(plane)[1]);
                    let bands = [row, row + 1].map(|row| owner(row, side));
                    gradient.bands[plane * BANDS + bands[0]].push(index as u32);
                    if bands[1] != bands[0] {
                        gradient.bands[plane * BANDS + bands[1]].push(index as u32);
                    }
                }
            }
        }
        self.simd.run(Pull { shape, arrays, parameters, spheres, rows, stride, gradient });
    }

    fn reduce(&mut self, gradients: &mut [&mut Gradient], parameter_gradient: &mut [f32]) {
        let Self { simd, shape, arrays, .. } = self;
        let (width, from): (usize, &[&mut Gradient]) =
            (KINDS.iter().map(|kind| shape.features(*kind)).sum(), gradients);
        let mut column = 0;
        let mut bands = Vec::new();
        let mut rest = parameter_gradient;
        for (index, arrays) in arrays.iter().enumerate() {
            let components = shape.components(arrays.kind);
            let planes = take_mut(&mut rest, arrays.planes.len());
            if shape.planes() > 0 {
                let mut planes = planes;
                for plane in 0..3 {
                    let [columns, rows] = shape.plane(plane);
                    for band in 0..BANDS {
                        let (first, end) = (first_row(band, rows), first_row(band + 1, rows));
                        let values = take_mut(&mut planes, (end - first) * columns * components);
                        let column = column + plane * components;
                        bands.push(Band { plane, band, first, column, components, values });
                    }
                }
            }
            column += shape.features(arrays.kind);
            let lines = take_mut(&mut rest, arrays.lines.len());
            lines.fill(0.0);
            for gradient in from {
                lines.iter_mut().zip(&*gradient.lines[index]).for_each(|(sum, value)| *sum += value);
            }
        }
        bands.into_par_iter().with_max_len(1).for_each(|band| simd.run(Add { shape, from, width, band }));
        for gradient in gradients {
            gradient.places.clear();
            gradient.rows.clear();
            gradient.bands.iter_mut().for_each(Vec::clear);
            gradient.lines.iter_mut().for_each(|lines| lines.fill(0.0));
        }
    }

    fn put(&self, gradient: &Gradient, out: &mut Vec<u8>) {
        put_counted(out, &gradient.places);
        put_counted(out, &gradient.rows);
        gradient.bands.iter().for_each(|band| put_counted(out, band));
        gradient.lines.iter().for_each(|lines| put(out, lines));
    }

    fn take(&self, from: &mut Reader<'_>, gradient: &mut Gradient) -> Result<()> {
        from.buffer(&mut gradient.places)?;
        from.buffer(&mut gradient.rows)?;
        let (samples, width) = (gradient.places.len(), self.width());
        from.expect("gradients", gradient.rows.len(), samples * width)?;
        gradient.bands.iter_mut().try_for_each(|band| from.indices(band, samples))?;
        gradient.lines.iter_mut().try_for_each(|lines| from.copy(lines))
    }

    fn gradient_memory(config: &Config) -> GradientMemory {
        let shape = Shape::new(config, 0);
        let width: usize = KINDS.iter().map(|kind| shape.features(*kind)).sum();
        let row = width * size_of::<f32>() + size_of::<[f32; 3]>() + 3 * 2 * size_of::<u32>();
        let lines: usize = Self::arrays(config).iter().map(|arrays| arrays.lines.len()).sum();
        GradientMemory {
            by_sample: if shape.planes() > 0 { row } else { 0 },
            by_partial: lines * size_of::<f32>() + 3 * BANDS * size_of::<Vec<u32>>(),
        }
    }
}

/// Returns the corners of the plane's cell that contains a sample: the index of the first corner, and the weights of
/// all four.
#[inline(always)]
fn corners(shape: &Shape, plane: usize, along: &[Along; 3]) -> (usize, [[f32; 2]; 2]) {
    let [columns, _] = shape.plane(plane);
    let [(column, right), (row, up)] = PLANE_AXES[plane].map(|axis| along[axis]);
    let weights = [[(1.0 - up) * (1.0 - right), (1.0 - up) * right], [up * (1.0 - right), up * right]];
    (shape.plane_start(plane) + row * columns + column, weights)
}

/// Returns sixteen components of a plane, interpolated at a sample.
#[inline(always)]
fn plane_value<L: Lanes>(
    values: &[f32],
    columns: usize,
    width: usize,
    (first, weights): (usize, [[f32; 2]; 2]),
    group: usize,
) -> L {
    let mut sum = L::splat(0.0);
    for (i, weights) in weights.into_iter().enumerate() {
        for (j, weight) in weights.into_iter().enumerate() {
            let at = (first + i * columns + j) * width + group;
            sum = L::splat(weight).mul_add(lanes(values, at), sum);
        }
    }
    sum
}

/// Returns sixteen components of a line, interpolated at a sample.
#[inline(always)]
fn line_value<L: Lanes>(
    values: &[f32],
    start: usize,
    width: usize,
    (lower, upper): Along,
    group: usize,
) -> L {
    let at = (start + lower) * width + group;
    let sum = L::splat(1.0 - upper).times(lanes(values, at));
    L::splat(upper).mul_add(lanes(values, at + width), sum)
}

#[inline(always)]
fn lanes<L: Lanes>(values: &[f32], at: usize) -> L {
    L::of(&values[at..].as_chunks().0[0])
}

/// Computes the features of samples.
struct Read<'a> {
    shape: &'a Shape,
    arrays: &'a [Arrays; 2],
    parameters: &'a [f32],
    spheres: &'a [Sphere],
    features: &'a mut [f32],
    stride: usize,
}

impl Kernel for Read<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { shape, arrays, parameters, spheres, features, stride } = self;
        for (i, (sphere, row)) in spheres.iter().zip(features.chunks_exact_mut(stride)).enumerate() {
            if let Some(next) = spheres.get(i + 1) {
                prefetch(shape, arrays, parameters, next.position);
            }
            let along = Factors::along(shape, sphere.position);
            let mut out = row.as_chunks_mut().0.iter_mut();
            for arrays in arrays {
                let width = shape.components(arrays.kind);
                let (planes, lines) = (&parameters[arrays.planes.clone()], &parameters[arrays.lines.clone()]);
                let line = |l: usize, group| {
                    line_value::<L>(lines, shape.line_start(l), width, along[LINE_AXES[l]], group)
                };
                for plane in 0..shape.planes() {
                    let (corners, [columns, _]) = (corners(shape, plane, &along), shape.plane(plane));
                    for (group, out) in (0..width).step_by(LANES).zip(&mut out) {
                        let value = plane_value::<L>(planes, columns, width, corners, group);
                        value.times(line(plane, group)).put(out);
                    }
                }
                if shape.planes() == 0 {
                    for (group, out) in (0..width).step_by(LANES).zip(&mut out) {
                        line(0, group).times(line(1, group)).times(line(2, group)).put(out);
                    }
                }
            }
        }
    }
}

/// Prefetches the texels of a sample.
#[inline(always)]
fn prefetch(shape: &Shape, arrays: &[Arrays; 2], parameters: &[f32], position: [f32; 3]) {
    let along = Factors::along(shape, position);
    for arrays in arrays {
        let (planes, width) = (&parameters[arrays.planes.clone()], shape.components(arrays.kind));
        for plane in 0..shape.planes() {
            let (first, [columns, _]) = (corners(shape, plane, &along).0, shape.plane(plane));
            for at in [first, first + columns] {
                for line in (0..2 * width).step_by(LANES) {
                    fetch(planes.as_ptr().wrapping_add(at * width + line));
                }
            }
        }
    }
}

/// Adds line gradients to a set of partial gradients, and stores plane gradients per sample.
struct Pull<'a> {
    shape: &'a Shape,
    arrays: &'a [Arrays; 2],
    parameters: &'a [f32],
    spheres: &'a [Sphere],
    rows: &'a [f32],
    stride: usize,
    gradient: &'a mut Gradient,
}

impl Kernel for Pull<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { shape, arrays, parameters, spheres, rows, stride, gradient } = self;
        let width_of_all: usize = KINDS.iter().map(|kind| shape.features(*kind)).sum();
        let Gradient { places, rows: kept, lines: line_gradients, .. } = gradient;
        let first = places.len().saturating_sub(spheres.len());
        for (i, (sphere, row)) in spheres.iter().zip(rows.chunks_exact(stride)).enumerate() {
            let along = Factors::along(shape, sphere.position);
            let mut column = 0;
            for (arrays, by_lines) in arrays.iter().zip(&mut *line_gradients) {
                let width = shape.components(arrays.kind);
                let (planes, lines) = (&parameters[arrays.planes.clone()], &parameters[arrays.lines.clone()]);
                let mut add = |l: usize, group: usize, value: L| {
                    let (lower, upper) = along[LINE_AXES[l]];
                    let at = (shape.line_start(l) + lower) * width + group;
                    for (at, weight) in [(at, 1.0 - upper), (at + width, upper)] {
                        let sum = &mut by_lines[at..].as_chunks_mut().0[0];
                        L::splat(weight).mul_add(value, L::of(sum)).put(sum);
                    }
                };
                let line = |l: usize, group| {
                    line_value::<L>(lines, shape.line_start(l), width, along[LINE_AXES[l]], group)
                };
                for plane in 0..shape.planes() {
                    let (corners, [columns, _]) = (corners(shape, plane, &along), shape.plane(plane));
                    for group in (0..width).step_by(LANES) {
                        let by_feature: L = lanes(row, column);
                        add(
                            plane,
                            group,
                            by_feature.times(plane_value(planes, columns, width, corners, group)),
                        );
                        let kept = &mut kept[(first + i) * width_of_all + column..].as_chunks_mut().0[0];
                        by_feature.times(line(plane, group)).put(kept);
                        column += LANES;
                    }
                }
                if shape.planes() == 0 {
                    for group in (0..width).step_by(LANES) {
                        let by_feature: L = lanes(row, column);
                        let [a, b, c] = [0, 1, 2].map(|l| line(l, group));
                        add(0, group, by_feature.times(b).times(c));
                        add(1, group, by_feature.times(a).times(c));
                        add(2, group, by_feature.times(a).times(b));
                        column += LANES;
                    }
                }
            }
        }
    }
}

/// A band of rows of a plane.
struct Band<'a> {
    plane: usize,
    band: usize,
    /// First row.
    first: usize,
    /// Column of the plane's first component in a row of gradients.
    column: usize,
    components: usize,
    values: &'a mut [f32],
}

/// Sums the gradients of a band, one set of partial gradients after the other, in the order of samples.
struct Add<'a> {
    shape: &'a Shape,
    from: &'a [&'a mut Gradient],
    /// Number of floats in a row of gradients.
    width: usize,
    band: Band<'a>,
}

impl Kernel for Add<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { shape, from, width, band: Band { plane, band, first, column, components, values } } = self;
        values.fill(0.0);
        let [columns, rows] = shape.plane(plane);
        for gradient in from {
            for &index in &gradient.bands[plane * BANDS + band] {
                let along = Factors::along(shape, gradient.places[index as usize]);
                let [(left, right), (row, up)] = PLANE_AXES[plane].map(|axis| along[axis]);
                let by_value = &gradient.rows[index as usize * width + column..][..components];
                for (row, up) in [(row, 1.0 - up), (row + 1, up)] {
                    if owner(row, rows) != band {
                        continue;
                    }
                    for (at, right) in [(left, 1.0 - right), (left + 1, right)] {
                        let texel = &mut values[((row - first) * columns + at) * components..][..components];
                        let weight = L::splat(up * right);
                        let pairs = texel.as_chunks_mut().0.iter_mut().zip(by_value.as_chunks().0);
                        for (sum, value) in pairs {
                            weight.mul_add(L::of(value), L::of(sum)).put(sum);
                        }
                    }
                }
            }
        }
    }
}
