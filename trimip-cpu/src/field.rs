//! Density and colour networks on the CPU. The density network outputs a logit and the geometry features. The colour
//! network reads this output, with zero weights for the logit, and the encoded view direction. The direction's
//! contribution to the first layer is computed once per ray. If sines and cosines of the geometry features are
//! configured, the colour network reads separate rows that hold them. If the field has no networks, the encoder's
//! features are the logits of density and colour.

mod context;

pub use context::Context;

use crate::buffer::Buffer;
use crate::gemm::padded;
use crate::mlp::{Batch, Flow, InputRow, Mlp, MlpGradient, Passing};
use crate::reduction_tree::{ReductionTree, halves};
use crate::simd::Simd;
use crate::wire::Reader;
use crate::{CpuBackend, WorkerScratch};
use context::{Directions, Lit};
use rayon::prelude::*;
use std::ops::Range;
use trimip_core::config::Precision;
use trimip_core::engine::batch::{FieldBackward, FieldDraw, PartialGradients, Radiance, SampleDraw, Tile};
use trimip_core::engine::exchange::Rank;
use trimip_core::engine::policy::FieldPolicy;
use trimip_core::field::networks::{append_frequencies, pull_frequencies};
use trimip_core::field::params::{ALIGNMENT, Slot};
use trimip_core::{Config, Field, Layout, Result, field::encoders};

/// The density and colour networks.
pub struct CpuField {
    simd: Simd,
    policy: FieldPolicy,
    density: Mlp,
    color: Mlp,
    slots: Vec<Slot>,
    /// Index of red in a row of colour logits.
    red: usize,
    /// Padded width of the encoded view direction; 0 if the colour network does not read directions.
    view: usize,
    /// Padded width of the geometry features with their sines and cosines; 0 without sines and cosines.
    shape: usize,
    /// `train.leaves`.
    wanted_leaves: u32,
    /// Number of ranks whose sums of weight gradients the partial gradients hold; 0 until a step calls
    /// [`CpuField::fold`].
    shared_by: usize,
}

/// Weight gradients of both networks.
pub struct FieldGradient {
    density: MlpGradient,
    color: MlpGradient,
}

impl FieldGradient {
    fn fold(&mut self, other: &mut Self) {
        self.density.fold(&mut other.density);
        self.color.fold(&mut other.color);
    }

    /// Appends all weight gradients to a message.
    pub(crate) fn put(&self, out: &mut Vec<u8>) {
        self.density.put(out);
        self.color.put(out);
    }

    /// Replaces all weight gradients with those that [`put`](Self::put) wrote.
    ///
    /// # Errors
    /// When the message is too short.
    pub(crate) fn take(&mut self, from: &mut Reader<'_>) -> Result<()> {
        self.density.take(from)?;
        self.color.take(from)
    }
}

/// Adds up weight gradients in a balanced tree over `range`; `at` maps an index in the range to a set of partial
/// gradients. The first set receives the sum, and the other sets become zero.
fn join(partials: &mut [PartialGradients<CpuBackend>], range: Range<usize>, at: &impl Fn(usize) -> usize) {
    if range.len() < 2 {
        return;
    }
    let [left, right] = halves(range);
    let (sum, other) = (at(left.start), at(right.start));
    join(partials, left, at);
    join(partials, right, at);
    let (head, tail) = partials.split_at_mut(other);
    head[sum].field.fold(&mut tail[0].field);
}

impl CpuField {
    /// Returns the reduction tree of a step with `partials` sets of partial gradients.
    pub(crate) fn reduction_tree(&self, partials: usize) -> ReductionTree {
        ReductionTree::new(self.wanted_leaves, partials)
    }

    /// Sums the weight gradients of the leaves of `this_rank` into the first set of partial gradients of these leaves.
    /// Their other sets become zero.
    pub(crate) fn fold(&mut self, partials: &mut [PartialGradients<CpuBackend>], this_rank: Rank) {
        let parts = self.reduction_tree(partials.len());
        let own = parts.of(this_rank);
        let (first, rest) = partials.split_at_mut(parts.count());
        let mut sums: Vec<Vec<&mut FieldGradient>> =
            first.iter_mut().map(|partial| vec![&mut partial.field]).collect();
        for (i, partial) in rest.iter_mut().enumerate() {
            sums[i % parts.count()].push(&mut partial.field);
        }
        sums[own.clone()].par_iter_mut().for_each(|part| {
            if let [sum, others @ ..] = &mut part[..] {
                others.iter_mut().for_each(|other| sum.fold(other));
            }
        });
        join(partials, own, &|part| part);
        self.shared_by = this_rank.size;
    }

    /// Creates the networks of a configuration, with products in `precision`.
    pub fn new(simd: Simd, config: &Config, layout: &Layout, precision: Precision) -> Self {
        let policy = FieldPolicy::new(config);
        let (density, color) = (&policy.density, &policy.color);
        let features = (0..encoders::stride(config)).map(|row| match row {
            _ if row < density.summed => InputRow::One,
            _ if row < density.inputs() => InputRow::Weights(row - density.summed),
            _ => InputRow::Zero,
        });
        let (view, geometry_width) = (policy.view, policy.geometry_width);
        let shape = match policy.settings.geometry_frequencies {
            0 => 0,
            _ => geometry_width.next_multiple_of(ALIGNMENT),
        };
        let input = match shape {
            0 => {
                // The density logit is not an input of the colour network.
                let outputs = 1 + policy.geometry;
                let row = |output| match (1..outputs).contains(&output) {
                    true => InputRow::Weights(view + output - 1),
                    false => InputRow::Zero,
                };
                (0..outputs.next_multiple_of(ALIGNMENT)).map(row).collect()
            }
            _ => {
                let row = |i| if i < geometry_width { InputRow::Weights(view + i) } else { InputRow::Zero };
                (0..shape).map(row).collect()
            }
        };
        let padded_view = if view == 0 { 0 } else { view.next_multiple_of(ALIGNMENT) };
        Self {
            simd,
            density: Mlp::new(density, features.collect(), Vec::new(), precision),
            color: Mlp::new(color, input, InputRow::all(view, padded_view), precision),
            slots: layout.networks().to_vec(),
            // Without networks the density logit precedes red.
            red: usize::from(policy.is_direct()),
            policy,
            view: padded_view,
            shape,
            wanted_leaves: config.train.leaves,
            shared_by: 0,
        }
    }

    /// Returns the input of the colour network in addition to the encoded view direction.
    fn color_input<'a>(&self, outputs: &'a Buffer<f32>, shape: &'a Buffer<f32>) -> &'a Buffer<f32> {
        if self.shape == 0 { outputs } else { shape }
    }

    /// Writes the geometry features with their sines and cosines to `shape`.
    fn append_shapes(&self, rows: usize, outputs: &Buffer<f32>, shape: &mut Buffer<f32>) {
        if self.shape == 0 {
            return;
        }
        let count = self.policy.settings.geometry as usize;
        shape.resize(padded(rows) * self.shape);
        let outputs = outputs.chunks_exact(self.density.outputs());
        for (row, output) in shape.chunks_exact_mut(self.shape).zip(outputs) {
            row.fill(0.0);
            row[..count].copy_from_slice(&output[1..=count]);
            append_frequencies(row, count, self.policy.settings.geometry_frequencies);
        }
    }
}

impl CpuField {
    /// Removes all rows of the density network from a context.
    pub(crate) fn clear(&self, context: &mut Context) {
        context.density.clear();
    }

    /// Appends the density network's rows with the indices `rows` in another context.
    pub(crate) fn append(&self, context: &mut Context, from: &Context, rows: &[u32]) {
        context.density.append(&self.density, &from.density, rows);
    }

    /// Replaces the geometry features of each group of samples with their weighted mean, in the group's first row. `kept`
    /// lists these rows. `fractions` has one value per sample: the sample's weight in its group, negated for all samples of
    /// a group except the first.
    pub(crate) fn blend(&self, context: &mut Context, kept: &[u32], fractions: &[f32]) {
        context.density.blend(&self.density, kept, fractions);
    }

    /// Replaces the density network's rows with the rows that have the indices `rows` in another context.
    pub(crate) fn gather(&self, context: &mut Context, from: &Context, rows: &[u32]) {
        context.density.gather(&self.density, &from.density, rows);
    }
}

/// Returns the norm of the gradient with respect to a sample's logits.
fn norm(density: f32, [r, g, b]: [f32; 3]) -> f32 {
    (density * density + r * r + g * g + b * b).sqrt()
}

impl Field<CpuBackend> for CpuField {
    type Context = Context;
    type Gradient = FieldGradient;

    fn context(&self) -> Context {
        Context {
            density: self.density.activations(),
            color: self.color.activations(),
            lit: Lit::default(),
            directions: Directions::default(),
            shape: Buffer::zeros(0),
            color_gradient: Buffer::zeros(0),
            shape_gradient: Buffer::zeros(0),
            output_gradient: Buffer::zeros(0),
            passing: Passing::default(),
        }
    }

    fn gradient(&self) -> FieldGradient {
        FieldGradient { density: self.density.gradient(), color: self.color.gradient() }
    }

    fn refresh(&mut self, parameters: &Buffer<f32>) {
        let weights: Vec<&[f32]> = self.slots.iter().map(|slot| &parameters[slot.range.clone()]).collect();
        let (density, color) = weights.split_at(self.density.slots());
        self.density.pack(density);
        self.color.pack(color);
    }

    fn density(
        &self,
        tile: &mut Tile<'_, CpuBackend>,
        features: &Buffer<f32>,
        context: &mut Context,
        radiance: &mut Buffer<Radiance>,
    ) {
        let rows = tile.samples.spheres.len();
        let batch = Batch { simd: self.simd, rows, input: features, shared: None };
        self.density.forward(batch, &mut context.density);
        radiance.resize(rows);
        for (radiance, output) in
            radiance.iter_mut().zip(context.density.output().chunks_exact(self.density.outputs()))
        {
            *radiance = Radiance { rgb: [0.0; 3], density: self.policy.density_activation.value(output[0]) };
        }
    }

    fn keep(
        &self,
        _: &mut WorkerScratch,
        kept: &Buffer<u32>,
        context: &mut Context,
        radiance: &mut Buffer<Radiance>,
    ) {
        context.density.keep(&self.density, kept);
        radiance.keep_rows(kept, 1);
    }

    fn color(
        &self,
        tile: &mut Tile<'_, CpuBackend>,
        least: f32,
        context: &mut Context,
        radiance: &mut Buffer<Radiance>,
    ) {
        let (rays, samples) = (tile.rays, tile.samples);
        let Context { density, color, lit, directions, shape, .. } = context;
        let width = self.density.outputs();
        let deferred = self.policy.settings.deferred;
        match deferred {
            true => lit.choose_rays(samples, radiance, least, density.output(), width),
            false => lit.choose(samples, radiance, least),
        }
        let rows = lit.count(samples.spheres.len());
        if lit.listed && !deferred {
            lit.outputs.gather_rows(density.output(), &lit.rows, width, padded(rows));
        }
        if self.view > 0 {
            let owners = (0..rows).map(|i| samples.rays[lit.row(i)]);
            directions.gather(&self.policy.settings, self.view, rays, owners);
        }
        let shared = (self.view > 0).then(|| directions.shared());
        let outputs = lit.of(density);
        self.append_shapes(rows, outputs, shape);
        let batch = Batch { simd: self.simd, rows, input: self.color_input(outputs, shape), shared };
        self.color.forward(batch, color);
        let logits = color.output().chunks_exact(self.color.outputs());
        for (i, logits) in logits.take(rows).enumerate() {
            let rgb = [0, 1, 2].map(|c| self.policy.color_activation.value(logits[self.red + c]));
            radiance[lit.samples(i, samples)].iter_mut().for_each(|own| own.rgb = rgb);
        }
    }

    fn draw(
        &self,
        tile: &mut Tile<'_, CpuBackend>,
        draw: &SampleDraw,
        context: &Context,
        arrays: FieldDraw<'_, CpuBackend>,
    ) {
        let FieldDraw { radiance, radiance_gradients, marks } = arrays;
        let (density, color) = (self.policy.density_activation, self.policy.color_activation);
        let (outputs, width) = (context.density.output(), self.density.outputs());
        marks.resize(radiance.len());
        for (ray, segment) in tile.samples.segments.iter().enumerate() {
            let mut sum = draw.first(tile.rays.first + ray as u32);
            for row in segment.range() {
                let (value, by_value) = (radiance[row].rgb, radiance_gradients[row]);
                let by_logit = by_value.density * density.derivative(outputs[row * width]);
                let by_colors = [0, 1, 2].map(|c| by_value.rgb[c] * color.derivative(value[c]));
                let probability = draw.probability(norm(by_logit, by_colors));
                sum += probability;
                let is_drawn = sum >= 1.0;
                marks[row] = is_drawn.into();
                if is_drawn {
                    sum -= 1.0;
                    let factor = probability.recip();
                    let Radiance { rgb, density } = by_value;
                    radiance_gradients[row] =
                        Radiance { rgb: rgb.map(|by| factor * by), density: factor * density };
                }
            }
        }
    }

    fn keep_drawn(
        &self,
        _: &mut WorkerScratch,
        drawn: &Buffer<u32>,
        context: &mut Context,
        radiance: &mut Buffer<Radiance>,
        radiance_gradients: &mut Buffer<Radiance>,
    ) {
        context.keep_drawn(drawn, [&self.density, &self.color], self.shape);
        radiance.keep_rows(drawn, 1);
        radiance_gradients.keep_rows(drawn, 1);
    }

    fn backward(
        &self,
        tile: &mut Tile<'_, CpuBackend>,
        arrays: FieldBackward<'_, CpuBackend>,
        context: &mut Context,
        gradient: &mut FieldGradient,
    ) {
        let samples = tile.samples;
        let (simd, rows) = (self.simd, samples.spheres.len());
        let FieldBackward { features, radiance, radiance_gradients, feature_gradients } = arrays;
        let Context {
            density,
            color,
            lit,
            directions,
            shape,
            color_gradient,
            shape_gradient,
            output_gradient,
            passing,
        } = context;
        let (width, count) = (self.color.outputs(), lit.count(rows));
        color_gradient.resize(padded(count) * width);
        color_gradient.fill(0.0);
        for (i, out) in color_gradient.chunks_exact_mut(width).take(count).enumerate() {
            let own = lit.samples(i, samples);
            let value = radiance[own.start].rgb;
            for c in 0..3 {
                let by_value: f32 = radiance_gradients[own.clone()].iter().map(|own| own.rgb[c]).sum();
                out[self.red + c] = by_value * self.policy.color_activation.derivative(value[c]);
            }
        }
        let mut by_listed = std::mem::replace(&mut lit.gradient, Buffer::zeros(0));
        let input = self.color_input(lit.of(density), shape);
        let shared = (self.view > 0).then(|| directions.shared());
        let flow = Flow {
            output: color_gradient,
            input: match (self.shape, lit.listed) {
                (0, false) => output_gradient,
                (0, true) => &mut by_listed,
                _ => shape_gradient,
            },
            weights: &mut gradient.color,
        };
        self.color.backward(Batch { simd, rows: count, input, shared }, color, flow, passing);
        let width = self.density.outputs();
        if self.shape > 0 || lit.listed {
            output_gradient.resize(padded(rows) * width);
            output_gradient.fill(0.0);
        }
        if self.shape > 0 {
            let settings = &self.policy.settings;
            let (values, frequencies) = (settings.geometry as usize, settings.geometry_frequencies);
            let shapes = shape.chunks_exact(self.shape).zip(shape_gradient.chunks_exact_mut(self.shape));
            for (i, (shape, by_shape)) in shapes.take(count).enumerate() {
                pull_frequencies(shape, by_shape, values, frequencies);
                if !lit.of_rays {
                    output_gradient[lit.row(i) * width + 1..][..values].copy_from_slice(&by_shape[..values]);
                }
            }
        } else if lit.listed && !lit.of_rays {
            for (own, row) in by_listed.chunks_exact(width).zip(&lit.rows) {
                output_gradient[*row as usize * width..][..width].copy_from_slice(own);
            }
        }
        if lit.of_rays {
            let (by_rows, distance, first) = match self.shape {
                0 => (&by_listed, width, 1),
                shape => (&*shape_gradient, shape, 0),
            };
            lit.clear_depths(rows);
            for i in 0..count {
                let by_mean = &by_rows[i * distance + first..][..self.policy.geometry];
                let outputs = (&density.output()[..], &mut output_gradient[..], width);
                lit.spread(i, lit.samples(i, samples), (samples, radiance), by_mean, outputs);
            }
        }
        lit.gradient = by_listed;
        let outputs = density.output().chunks_exact(width).zip(radiance_gradients.iter());
        for (row, (out, (output, by_value))) in
            output_gradient.chunks_exact_mut(width).zip(outputs).enumerate()
        {
            let by_density = by_value.density + lit.by_depth(row) * samples.intervals[row].length;
            out[0] = by_density * self.policy.density_activation.derivative(output[0]);
        }
        let weights = &mut gradient.density;
        let flow = Flow { output: output_gradient, input: feature_gradients, weights };
        self.density.backward(Batch { simd, rows, input: features, shared: None }, density, flow, passing);
    }

    fn reduce(
        &mut self,
        partials: &mut [PartialGradients<CpuBackend>],
        parameter_gradient: &mut Buffer<f32>,
    ) {
        match std::mem::take(&mut self.shared_by) {
            0 => self.fold(partials, Rank::ONLY),
            of => {
                let parts = self.reduction_tree(partials.len());
                join(partials, 0..of, &|rank| parts.of(Rank { id: rank, size: of }).start);
            }
        }
        self.shared_by = 0;
        for (i, slot) in self.slots.iter().enumerate() {
            let out = &mut parameter_gradient[slot.range.clone()];
            let fields = partials[..1].iter_mut().map(|partial| &mut partial.field);
            match i.checked_sub(self.density.slots()) {
                None => self.density.reduce(i, fields.map(|field| &mut field.density), out),
                Some(i) => self.color.reduce(i, fields.map(|field| &mut field.color), out),
            }
        }
    }
}
