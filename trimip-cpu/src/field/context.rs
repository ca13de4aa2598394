//! The field's context of a tile, kept from the forward to the backward pass: activations, the list of samples that have a
//! colour, and the encoded view directions of rays.

use crate::CpuBackend;
use crate::buffer::Buffer;
use crate::gemm::padded;
use crate::mlp::{Activations, Mlp, Passing, Shared};
use std::ops::Range;
use trimip_core::config::FieldConfig;
use trimip_core::engine::batch::{Radiance, Rays, Samples, Segment};
use trimip_core::field::networks::encode_view;
use trimip_core::math::compositing::is_lit;
use trimip_core::math::deferred::{LEAST_OPACITY, fractions, mean_gradient};

/// Activations and gradients of a tile.
pub struct Context {
    pub(super) density: Activations,
    pub(super) color: Activations,
    pub(super) lit: Lit,
    pub(super) directions: Directions,
    /// Geometry features with their sines and cosines, [samples (padded), `shape`].
    pub(super) shape: Buffer<f32>,
    /// Gradients of the colour logits, of the rows of `shape`, and of the density network's output.
    pub(super) color_gradient: Buffer<f32>,
    pub(super) shape_gradient: Buffer<f32>,
    pub(super) output_gradient: Buffer<f32>,
    pub(super) passing: Passing,
}

impl Context {
    /// Keeps the activations of the samples `drawn` in both networks, and drops all others.
    pub(super) fn keep_drawn(&mut self, drawn: &[u32], [density, color]: [&Mlp; 2], shape: usize) {
        let Self { lit, directions, shape: shapes, .. } = self;
        self.density.keep(density, drawn);
        // For each drawn sample that has a colour, `colors` holds its index among all samples with a colour, and `rows`
        // holds its index among the drawn samples.
        let mut colors = std::mem::take(&mut lit.kept);
        colors.clear();
        if lit.listed {
            let mut lit_rows = lit.rows.iter().zip(0..).peekable();
            let mut rows = std::mem::take(&mut lit.next);
            rows.clear();
            for (new, old) in drawn.iter().enumerate() {
                while lit_rows.next_if(|(row, _)| *row < old).is_some() {}
                if let Some((_, color)) = lit_rows.next_if(|(row, _)| *row == old) {
                    colors.push(color);
                    rows.push(new as u32);
                }
            }
            lit.outputs.keep_rows(&colors, density.outputs());
            lit.outputs.resize(padded(colors.len()) * density.outputs());
            lit.next = std::mem::replace(&mut lit.rows, rows);
        } else {
            colors.extend_from_slice(drawn);
        }
        self.color.keep(color, &colors);
        if shape > 0 {
            shapes.keep_rows(&colors, shape);
            shapes.resize(padded(colors.len()) * shape);
        }
        directions.keep(&colors);
        lit.kept = colors;
    }
}

/// The rows of the colour network. A row belongs to one sample, or with deferred shading to all samples of a ray. Samples and
/// rays that are too faint have no row, and no colour.
#[derive(Default)]
pub struct Lit {
    /// True if `rows` lists the rows; otherwise row i belongs to sample i.
    pub(super) listed: bool,
    /// True if a row belongs to a whole ray.
    pub(super) of_rays: bool,
    /// First sample of each row.
    pub(super) rows: Vec<u32>,
    /// With `of_rays`: the opacity of each row's ray.
    opacities: Vec<f32>,
    /// With `of_rays`: the fraction of each sample in the mean of its ray, and the derivative of the loss with respect to its
    /// optical depth through this mean.
    fractions: Vec<f32>,
    by_depth: Vec<f32>,
    /// With `listed`: the density network's outputs of each row, with padded rows, and the gradient of these outputs.
    pub(super) outputs: Buffer<f32>,
    pub(super) gradient: Buffer<f32>,
    /// Scratch memory of [`Context::keep_drawn`].
    kept: Vec<u32>,
    next: Vec<u32>,
}

impl Lit {
    /// Lists the samples whose compositing weight is at least `least`, or NaN. If `least` is 0, all samples have a
    /// colour. `radiance` has one element per sample.
    pub fn choose(&mut self, samples: &Samples<CpuBackend>, radiance: &[Radiance], least: f32) {
        (self.listed, self.of_rays) = (least > 0.0, false);
        self.rows.clear();
        if !self.listed {
            return;
        }
        for segment in samples.segments.iter() {
            let mut before = 0.0;
            for row in segment.range() {
                let depth = radiance[row].density * samples.intervals[row].length;
                if is_lit(&mut before, depth, least) {
                    self.rows.push(row as u32);
                }
            }
        }
    }

    /// Lists the rays whose opacity is at least `least`, or NaN, and computes the mean of the density network's `outputs`
    /// (`width` values per sample) along each of them.
    pub fn choose_rays(
        &mut self,
        samples: &Samples<CpuBackend>,
        radiance: &[Radiance],
        least: f32,
        outputs: &[f32],
        width: usize,
    ) {
        (self.listed, self.of_rays) = (true, true);
        self.rows.clear();
        self.opacities.clear();
        self.fractions.clear();
        self.fractions.resize(radiance.len(), 0.0);
        // As large as if every ray had a colour.
        self.outputs.resize(samples.segments.len() * width);
        let least = least.max(LEAST_OPACITY as f32);
        for range in samples.segments.iter().map(Segment::range) {
            let depths = range.clone().map(|row| radiance[row].density * samples.intervals[row].length);
            let own = &mut self.fractions[range.clone()];
            let opacity = fractions(depths, own);
            // The comparison is false for NaN: such a ray has a colour, and the step reports it.
            if range.is_empty() || opacity < least {
                continue;
            }
            self.opacities.push(opacity);
            let at = self.rows.len() * width;
            self.rows.push(range.start as u32);
            let mean = &mut self.outputs[at..at + width];
            mean.fill(0.0);
            for (fraction, outputs) in own.iter().zip(outputs[range.start * width..].chunks_exact(width)) {
                mean.iter_mut().zip(outputs).for_each(|(sum, value)| *sum += fraction * value);
            }
        }
        self.outputs.resize(padded(self.rows.len()) * width);
    }

    /// Returns the number of rows; `all` is the number of all samples.
    pub fn count(&self, all: usize) -> usize {
        if self.listed { self.rows.len() } else { all }
    }

    /// Returns the indices of the samples of row `i`; `samples` are those of the tile.
    pub fn samples(&self, i: usize, samples: &Samples<CpuBackend>) -> Range<usize> {
        let first = self.row(i);
        match self.of_rays {
            true => samples.segments[samples.rays[first] as usize].range(),
            false => first..first + 1,
        }
    }

    /// Returns the first sample of row `i`.
    pub fn row(&self, i: usize) -> usize {
        if self.listed { self.rows[i] as usize } else { i }
    }

    /// Returns the density network's outputs of each row, in order, with padded rows and width.
    pub fn of<'a>(&'a self, density: &'a Activations) -> &'a Buffer<f32> {
        if self.listed { &self.outputs } else { density.output() }
    }

    /// Spreads the gradient of a ray's mean over its samples `own`. `by_mean` is the gradient of the geometry features of row
    /// `i`. `outputs`, [samples, `width`], are the outputs of the density network, and `by_outputs` receives the gradients of
    /// their geometry features. `by_depth` keeps the derivatives with respect to the optical depths.
    pub fn spread(
        &mut self,
        i: usize,
        own: Range<usize>,
        tile: (&Samples<CpuBackend>, &[Radiance]),
        by_mean: &[f32],
        (outputs, by_outputs, width): (&[f32], &mut [f32], usize),
    ) {
        let (samples, radiance) = tile;
        let first = own.start;
        let Self { fractions, by_depth, opacities, .. } = self;
        for row in own.clone() {
            let by_own = &mut by_outputs[row * width + 1..][..by_mean.len()];
            by_own.iter_mut().zip(by_mean).for_each(|(to, from)| *to = fractions[row] * from);
        }
        let sample = |i: usize| {
            let row = first + i;
            let depth = radiance[row].density * samples.intervals[row].length;
            let values = outputs[row * width + 1..].iter().zip(by_mean);
            (depth, fractions[row], values.map(|(value, by)| value * by).sum::<f32>())
        };
        mean_gradient(own.len(), opacities[i], sample, |i, by| by_depth[first + i] = by);
    }

    /// Prepares the derivatives with respect to optical depths of `samples` samples.
    pub fn clear_depths(&mut self, samples: usize) {
        self.by_depth.clear();
        self.by_depth.resize(samples, 0.0);
    }

    /// Returns the derivative of the loss with respect to the optical depth of sample `row` through the mean of its ray.
    pub fn by_depth(&self, row: usize) -> f32 {
        if self.of_rays { self.by_depth[row] } else { 0.0 }
    }
}

/// The encoded view directions of the rays that have samples.
#[derive(Default)]
pub struct Directions {
    /// Number of rays with samples.
    pub(super) count: usize,
    /// Encoded directions, [rays with samples (padded), width].
    pub(super) views: Buffer<f32>,
    /// For each sample, padding included: the row of `views` that holds the direction of its ray.
    pub(super) of: Vec<u32>,
}

impl Directions {
    pub fn gather(
        &mut self,
        field: &FieldConfig,
        width: usize,
        rays: &Rays<CpuBackend>,
        owners: impl Iterator<Item = u32>,
    ) {
        self.of.clear();
        self.views.clear();
        let (mut count, mut last) = (0, None);
        for ray in owners {
            if last != Some(ray) {
                last = Some(ray);
                count += 1;
                self.views.resize(count * width);
                let row = &mut self.views[(count - 1) * width..];
                row.fill(0.0);
                encode_view(field, rays.rays[ray as usize].direction, row);
            }
            self.of.push(count as u32 - 1);
        }
        self.count = count;
        self.views.resize(padded(count) * width);
        self.of.resize(padded(self.of.len()), 0);
    }

    /// Keeps the entries of `of` for the samples `kept`, and drops all others.
    fn keep(&mut self, kept: &[u32]) {
        if self.of.is_empty() {
            return;
        }
        kept.iter().enumerate().for_each(|(to, from)| self.of[to] = self.of[*from as usize]);
        self.of.truncate(kept.len());
        self.of.resize(padded(kept.len()), 0);
    }

    pub fn shared(&self) -> Shared<'_> {
        Shared { groups: self.count, input: &self.views, of: &self.of }
    }
}
