//! The field's context of a tile, kept from the forward to the backward pass: activations, the list of samples that have a
//! colour, and the encoded view directions of rays.

use crate::CpuBackend;
use crate::buffer::Buffer;
use crate::gemm::padded;
use crate::mlp::{Activations, Mlp, Passing, Shared};
use trimip_core::config::{FieldConfig, ViewEncoding};
use trimip_core::engine::batch::{Radiance, Rays, Samples};
use trimip_core::field::networks::append_frequencies;
use trimip_core::math::compositing::is_lit;
use trimip_core::math::sh::spherical_harmonics;

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

/// The list of samples whose colour is computed. Samples that are too faint have no colour.
#[derive(Default)]
pub struct Lit {
    /// True if `rows` lists the samples that have a colour; otherwise all samples have one.
    pub(super) listed: bool,
    pub(super) rows: Vec<u32>,
    /// The density network's outputs for the listed samples, with padded rows, and the gradient of these outputs.
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
        self.listed = least > 0.0;
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

    /// Returns the number of samples with a colour; `all` is the number of all samples.
    pub fn count(&self, all: usize) -> usize {
        if self.listed { self.rows.len() } else { all }
    }

    /// Returns the row of the `i`th sample that has a colour.
    pub fn row(&self, i: usize) -> usize {
        if self.listed { self.rows[i] as usize } else { i }
    }

    /// Returns the density network's outputs for the samples that have a colour, in their order, with padded rows and
    /// width.
    pub fn of<'a>(&'a self, density: &'a Activations) -> &'a Buffer<f32> {
        if self.listed { &self.outputs } else { density.output() }
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
                let direction = rays.rays[ray as usize].direction;
                match field.view {
                    ViewEncoding::Harmonics => row.copy_from_slice(&spherical_harmonics(direction)),
                    ViewEncoding::Frequencies => {
                        row.fill(0.0);
                        row[..3].copy_from_slice(&direction);
                        append_frequencies(row, 3, field.view_frequencies);
                    }
                }
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
