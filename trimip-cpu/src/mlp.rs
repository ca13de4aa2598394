//! A small ReLU network over rows of a tile, with or without biases. Widths are padded to multiples of 16 with zero weights,
//! and up to four outputs to four; the parameters are not padded. Inputs that many rows share (all samples of a ray)
//! may go through the first layer once per group of rows. One later layer may read the input again. A network without
//! layers copies its input. Activations and gradients are f32. At bf16 the factors of a
//! layer's products are rounded immediately before the product, except in a last layer of few outputs.

use crate::buffer::Buffer;
use crate::gemm::{Finish, Packed, ROWS, Start, accumulate, dots, multiply, padded, pair_columns, pair_rows};
use crate::simd::Simd;
use crate::wire::{Reader, put};
use trimip_core::config::Precision;
use trimip_core::networks::Network;

/// Rows that go through all layers together. Their activations and a layer's weights fit into half of a 1 MiB L2.
pub const BLOCK: usize = 21 * ROWS;

/// Maximum number of outputs for which a last layer is computed by dot products.
const FEW: usize = 4;

/// Weights of the network, packed for the forward and the backward pass.
pub struct Mlp {
    layers: Vec<Layer>,
    /// Padded width of the rows that are copied, for a network without layers.
    copied: usize,
    /// First-layer weights of the shared inputs, if there are any.
    shared: Option<Inputs>,
    /// Which layer reads the network's input again.
    joined: Option<usize>,
    /// Row numbers of a block, and zeros: where products of a layer start from.
    each: Vec<u32>,
    first: Vec<u32>,
}

struct Layer {
    inputs: Inputs,
    /// The transpose, [outputs, inputs], for the gradient of the inputs.
    backward: Packed,
    /// Padded biases; empty without.
    biases: Buffer<f32>,
    /// Weights of the network's input, where it joins again, and their transpose.
    joined: Option<(Inputs, Packed)>,
    /// Number of outputs without padding.
    outputs: usize,
}

/// What a padded input of a layer is multiplied by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Row {
    /// Nothing: padding.
    Zero,
    /// A row of the weights.
    Weights(usize),
    /// One, for the first output alone, which has no weights then.
    One,
}

impl Row {
    /// The padded inputs `0..stride` for a network that has weights for the first `inputs` of them.
    pub fn all(inputs: usize, stride: usize) -> Vec<Self> {
        (0..stride).map(|row| if row < inputs { Self::Weights(row) } else { Self::Zero }).collect()
    }
}

/// The weights of some inputs of a layer.
struct Inputs {
    forward: Forward,
    /// One per padded input.
    rows: Vec<Row>,
    /// Outputs before those that have weights: 1 where the first one is a sum.
    offset: usize,
}

enum Forward {
    /// A product over column panels.
    Wide(Packed),
    /// [outputs, inputs], for few outputs.
    Few(Buffer<f32>),
}

/// Inputs that groups of rows share.
#[derive(Clone, Copy)]
pub struct Shared<'a> {
    /// Number of groups.
    pub groups: usize,
    /// Shape: [groups (padded), inputs].
    pub input: &'a [f32],
    /// Group of each row, padding included.
    pub of: &'a [u32],
}

/// Activations of every layer except the input: hidden layers after their ReLU, then the output.
#[derive(Default)]
pub struct Activations {
    layers: Vec<Buffer<f32>>,
    /// Contribution of the shared inputs to the first layer, [groups (padded), outputs of that layer].
    shared: Buffer<f32>,
    /// Contribution of the input to the layer that it joins again, for one block.
    joined: Buffer<f32>,
    /// The rows of a block as pairs of columns.
    pairs: Buffer<f32>,
}

/// Weight gradients, padded as the packed weights are.
pub struct MlpGradient {
    layers: Vec<Buffer<f32>>,
    shared: Buffer<f32>,
    joined: Buffer<f32>,
    biases: Vec<Buffer<f32>>,
}

impl MlpGradient {
    fn buffers(&self) -> impl Iterator<Item = &Buffer<f32>> {
        self.layers.iter().chain([&self.shared, &self.joined]).chain(&self.biases)
    }

    fn buffers_mut(&mut self) -> impl Iterator<Item = &mut Buffer<f32>> {
        self.layers.iter_mut().chain([&mut self.shared, &mut self.joined]).chain(&mut self.biases)
    }

    /// Adds another gradient, and sets it to zero.
    pub fn fold(&mut self, other: &mut Self) {
        for (sums, values) in self.buffers_mut().zip(other.buffers_mut()) {
            sums.iter_mut().zip(values.iter()).for_each(|(sum, value)| *sum += value);
            values.fill(0.0);
        }
    }

    /// Writes all numbers.
    pub fn put(&self, out: &mut Vec<u8>) {
        self.buffers().for_each(|values| put(out, values));
    }

    /// Replaces all numbers by those that were put.
    pub fn take(&mut self, from: &mut Reader<'_>) {
        self.buffers_mut().for_each(|values| from.copy(values));
    }
}

/// A worker's buffers for a backward pass, used by one network at a time.
#[derive(Default)]
pub struct Passing {
    /// The gradients above and below a layer, for one block.
    scratch: [Buffer<f32>; 2],
    /// Gradients of the first layer's outputs, summed over each group.
    sums: Buffer<f32>,
    /// Gradient of the input from the layer that it joins again, for one block.
    joined: Buffer<f32>,
    pairs: Pairs,
}

/// The factors of a block as pairs of bf16.
#[derive(Default)]
struct Pairs {
    /// Gradient of a layer's outputs, in pairs of neighbouring columns.
    columns: Buffer<f32>,
    /// A layer's inputs and the gradient of its outputs, in pairs of neighbouring rows.
    rows: [Buffer<f32>; 2],
}

impl Pairs {
    /// Adds `input`ᵀ·`by_output` to the weight gradient of a layer.
    #[allow(clippy::too_many_arguments)]
    fn accumulate(
        &mut self,
        simd: Simd,
        precision: Precision,
        rows: usize,
        [k, n]: [usize; 2],
        input: &[f32],
        by_output: &[f32],
        weights: &mut [f32],
    ) {
        match precision {
            Precision::F32 | Precision::F16 => {
                accumulate(simd, precision, rows, k, n, input, by_output, weights)
            }
            Precision::Bf16 => {
                let [a, d] = &mut self.rows;
                pair_rows(simd, rows, k, input, a);
                pair_rows(simd, rows, n, by_output, d);
                accumulate(simd, precision, rows.div_ceil(2), k, n, a, d, weights);
            }
        }
    }
}

/// Rows of `w.k` values as the left factor of a product with `w`; packed into `pairs` if `w` is bf16.
fn left<'a>(simd: Simd, rows: usize, values: &'a [f32], w: &Packed, pairs: &'a mut Buffer<f32>) -> &'a [f32] {
    match w.precision() {
        Precision::F32 | Precision::F16 => values,
        Precision::Bf16 => {
            let count = padded(rows) * w.k();
            pairs.resize(count / 2);
            pair_columns(simd, &values[..count], pairs);
            pairs
        }
    }
}

impl Inputs {
    fn new(rows: Vec<Row>, outputs: usize, last: bool, precision: Precision) -> Self {
        let forward = if last && outputs <= FEW {
            Forward::Few(Buffer::zeros(outputs * rows.len()))
        } else {
            Forward::Wide(Packed::zeros(rows.len(), outputs.next_multiple_of(16), precision))
        };
        let offset = usize::from(rows.contains(&Row::One));
        Self { forward, rows, offset }
    }

    /// The weight at a padded row and column; `weights` has rows of `outputs` − offset values.
    fn weight(&self, outputs: usize, weights: &[f32], row: usize, column: usize) -> f32 {
        let weighted = self.offset..outputs;
        match self.rows[row] {
            Row::Weights(row) if weighted.contains(&column) => {
                weights[row * weighted.len() + column - self.offset]
            }
            Row::One if column == 0 => 1.0,
            _ => 0.0,
        }
    }

    fn fill(&mut self, outputs: usize, weights: &[f32]) {
        let mut forward = std::mem::replace(&mut self.forward, Forward::Few(Buffer::zeros(0)));
        let value = |row: usize, column: usize| self.weight(outputs, weights, row, column);
        match &mut forward {
            Forward::Wide(packed) => packed.fill(value),
            Forward::Few(dots) => {
                for (place, weight) in dots.iter_mut().enumerate() {
                    *weight = value(place % self.rows.len(), place / self.rows.len());
                }
            }
        }
        self.forward = forward;
    }

    /// Adds a padded gradient to parameters [inputs, outputs − offset].
    fn unpack(&self, outputs: usize, gradient: &[f32], parameters: &mut [f32]) {
        let weighted = self.offset..outputs;
        for (padded_row, row) in self.rows.iter().enumerate() {
            let Row::Weights(row) = row else { continue };
            for column in weighted.clone() {
                let place = match &self.forward {
                    Forward::Wide(packed) => padded_row * packed.n() + column,
                    Forward::Few(_) => column * self.rows.len() + padded_row,
                };
                parameters[row * weighted.len() + column - self.offset] += gradient[place];
            }
        }
    }
}

impl Layer {
    /// Number of padded inputs.
    fn k(&self) -> usize {
        self.inputs.rows.len()
    }

    /// Number of padded outputs, which are the rows of the transpose.
    fn n(&self) -> usize {
        self.backward.k()
    }

    /// What products of the layer start from: its biases, by a row number of 0 for each row.
    fn start<'a>(&'a self, first: &'a [u32]) -> Start<'a> {
        match self.biases.is_empty() {
            true => Start::Zero,
            false => Start::Rows { rows: &self.biases, of: first },
        }
    }
}

impl Mlp {
    /// The network `shape`. `input_rows` tells what each padded input of the first layer is multiplied by; `shared_rows` does
    /// the same for the inputs that groups of rows share.
    pub fn new(shape: &Network, input_rows: Vec<Row>, shared_rows: Vec<Row>, precision: Precision) -> Self {
        let shared =
            (!shared_rows.is_empty()).then(|| Inputs::new(shared_rows, shape.layers[0][1], false, precision));
        let copied = if shape.layers.is_empty() { input_rows.len() } else { 0 };
        let again = input_rows.clone();
        let mut rows = input_rows;
        let count = shape.layers.len();
        let layers = shape.layers.iter().enumerate().map(|(i, &[_, outputs])| {
            let k = rows.len();
            let before = rows.iter().filter(|row| **row != Row::Zero).count();
            let inputs = Inputs::new(std::mem::take(&mut rows), outputs, i + 1 == count, precision);
            let (n, precision) = match &inputs.forward {
                Forward::Wide(packed) => (packed.n(), precision),
                Forward::Few(_) => (FEW, Precision::F32),
            };
            rows = Row::all(outputs, n);
            let joined = (shape.joined == Some(i)).then(|| {
                let after = |row: &Row| match row {
                    Row::Weights(row) => Row::Weights(before + row),
                    other => *other,
                };
                let inputs = Inputs::new(again.iter().map(after).collect(), outputs, false, precision);
                (inputs, Packed::zeros(n, again.len(), precision))
            });
            let biases = Buffer::zeros(if shape.biases { n } else { 0 });
            Layer { inputs, backward: Packed::zeros(n, k, precision), biases, joined, outputs }
        });
        let layers = layers.collect();
        let each = (0..padded(BLOCK) as u32).collect();
        Self { layers, copied, shared, joined: shape.joined, each, first: vec![0; padded(BLOCK)] }
    }

    /// Packs parameters: for each layer its weights, [inputs, outputs], and its biases if it has any.
    pub fn pack(&mut self, parameters: &[&[f32]]) {
        if let Some(shared) = &mut self.shared {
            shared.fill(self.layers[0].outputs, parameters[0]);
        }
        let mut parameters = parameters.iter();
        let mut next = || parameters.next().copied().unwrap_or_default();
        for layer in &mut self.layers {
            let Layer { inputs, backward, biases, joined, outputs } = layer;
            let weights = next();
            inputs.fill(*outputs, weights);
            backward.fill(|row, column| inputs.weight(*outputs, weights, column, row));
            if let Some((inputs, backward)) = joined {
                inputs.fill(*outputs, weights);
                backward.fill(|row, column| inputs.weight(*outputs, weights, column, row));
            }
            if !biases.is_empty() {
                biases[..*outputs].copy_from_slice(next());
            }
        }
    }

    /// Padded width of the input.
    pub fn inputs(&self) -> usize {
        self.layers.first().map_or(self.copied, Layer::k)
    }

    /// Padded width of the output.
    pub fn outputs(&self) -> usize {
        self.layers.last().map_or(self.copied, Layer::n)
    }

    /// Padded widths of the activations.
    fn widths(&self) -> impl Iterator<Item = usize> {
        let copied = self.layers.is_empty().then_some(self.copied);
        self.layers.iter().map(Layer::n).chain(copied)
    }

    /// The layer that reads the network's input again, with the weights of that input and their transpose.
    fn joined(&self) -> Option<(&Layer, &Inputs, &Packed)> {
        let layer = &self.layers[self.joined?];
        layer.joined.as_ref().map(|(inputs, backward)| (layer, inputs, backward))
    }

    /// Creates empty activations.
    pub fn activations(&self) -> Activations {
        Activations {
            layers: self.widths().map(|_| Buffer::zeros(0)).collect(),
            shared: Buffer::zeros(0),
            joined: Buffer::zeros(0),
            pairs: Buffer::zeros(0),
        }
    }

    /// Creates a zero gradient.
    pub fn gradient(&self) -> MlpGradient {
        let size = |inputs: &Inputs, n: usize| inputs.rows.len() * n;
        MlpGradient {
            layers: self.layers.iter().map(|layer| Buffer::zeros(size(&layer.inputs, layer.n()))).collect(),
            shared: Buffer::zeros(self.shared.as_ref().map_or(0, |s| size(s, self.layers[0].n()))),
            joined: Buffer::zeros(self.joined().map_or(0, |(layer, inputs, _)| size(inputs, layer.n()))),
            biases: self.layers.iter().map(|layer| Buffer::zeros(layer.biases.len())).collect(),
        }
    }

    /// Runs `rows` rows through the network. Each block goes through all layers, so that its activations stay in L2.
    ///
    /// # Panics
    /// When `shared` is given and the network has no shared inputs, or the other way round.
    pub fn forward(
        &self,
        simd: Simd,
        rows: usize,
        input: &[f32],
        shared: Option<Shared<'_>>,
        activations: &mut Activations,
    ) {
        let Activations { layers: buffers, shared: group_rows, joined, pairs } = activations;
        for (buffer, width) in buffers.iter_mut().zip(self.widths()) {
            buffer.resize(padded(rows) * width);
        }
        if self.layers.is_empty() {
            return buffers[0].copy_from_slice(&input[..padded(rows) * self.copied]);
        }
        assert_eq!(self.shared.is_some(), shared.is_some(), "shared inputs");
        if let (Some(Inputs { forward: Forward::Wide(weights), .. }), Some(shared)) = (&self.shared, shared) {
            group_rows.resize(padded(shared.groups) * weights.n());
            let input = left(simd, shared.groups, shared.input, weights, pairs);
            let biases = vec![0; if self.layers[0].biases.is_empty() { 0 } else { padded(shared.groups) }];
            let start = self.layers[0].start(&biases);
            multiply(simd, shared.groups, input, weights, group_rows, start, Finish::Store);
        }
        let last = self.layers.len() - 1;
        for first in (0..rows).step_by(BLOCK) {
            let count = (rows - first).min(BLOCK);
            for (i, layer) in self.layers.iter().enumerate() {
                let (before, after) = buffers.split_at_mut(i);
                let own = &input[first * self.inputs()..];
                let input = if i == 0 { own } else { &before[i - 1][first * layer.k()..] };
                let out = &mut after[0][first * layer.n()..];
                if let Some((Inputs { forward: Forward::Wide(weights), .. }, _)) = &layer.joined {
                    joined.resize(padded(count) * layer.n());
                    let own = left(simd, count, own, weights, pairs);
                    let start = layer.start(&self.first);
                    multiply(simd, count, own, weights, joined, start, Finish::Store);
                }
                match &layer.inputs.forward {
                    Forward::Wide(weights) => {
                        let start = match shared {
                            Some(shared) if i == 0 => {
                                Start::Rows { rows: group_rows, of: &shared.of[first..] }
                            }
                            _ if layer.joined.is_some() => Start::Rows { rows: joined, of: &self.each },
                            _ => layer.start(&self.first),
                        };
                        let finish = if i == last { Finish::Store } else { Finish::Relu };
                        let input = left(simd, count, input, weights, pairs);
                        multiply(simd, count, input, weights, out, start, finish);
                    }
                    Forward::Few(weights) => {
                        dots(simd, count, layer.k(), input, weights, out, layer.n());
                        if !layer.biases.is_empty() {
                            let rows = out.chunks_exact_mut(layer.n()).take(count);
                            rows.for_each(|row| {
                                row.iter_mut().zip(&*layer.biases).for_each(|(x, b)| *x += b)
                            });
                        }
                    }
                }
            }
        }
    }

    /// Computes `input_gradient` from the gradient of the output, both with padded rows and width; adds to the weight
    /// gradients.
    #[allow(clippy::too_many_arguments)]
    pub fn backward(
        &self,
        simd: Simd,
        rows: usize,
        input: &[f32],
        shared: Option<Shared<'_>>,
        activations: &Activations,
        output_gradient: &[f32],
        input_gradient: &mut Buffer<f32>,
        passing: &mut Passing,
        gradient: &mut MlpGradient,
    ) {
        input_gradient.resize(padded(rows) * self.inputs());
        if self.layers.is_empty() {
            return input_gradient.copy_from_slice(&output_gradient[..padded(rows) * self.copied]);
        }
        let MlpGradient { layers: weights, shared: shared_weights, joined: joined_weights, biases } =
            gradient;
        let Passing { scratch: [above, below], sums, joined, pairs } = passing;
        let width = self.layers[0].n();
        if let Some(shared) = shared {
            sums.resize(shared.groups * width);
            sums.fill(0.0);
        }
        for first in (0..rows).step_by(BLOCK) {
            let count = (rows - first).min(BLOCK);
            for (i, layer) in self.layers.iter().enumerate().rev() {
                let (k, n) = (layer.k(), layer.n());
                let own = &input[first * self.inputs()..];
                let input = if i == 0 { own } else { &activations.layers[i - 1][first * k..] };
                let by_output =
                    if i + 1 == self.layers.len() { &output_gradient[first * n..] } else { &above[..] };
                match &layer.inputs.forward {
                    Forward::Wide(w) => {
                        let precision = w.precision();
                        pairs.accumulate(simd, precision, count, [k, n], input, by_output, &mut weights[i]);
                    }
                    Forward::Few(_) => {
                        accumulate(simd, Precision::F32, count, n, k, by_output, input, &mut weights[i]);
                    }
                }
                if !layer.biases.is_empty() {
                    add_rows(&mut biases[i], &by_output[..count * n]);
                }
                if let Some((Inputs { forward: Forward::Wide(w), .. }, backward)) = &layer.joined {
                    let shape = [self.inputs(), n];
                    pairs.accumulate(simd, w.precision(), count, shape, own, by_output, joined_weights);
                    joined.resize(padded(count) * self.inputs());
                    let by_output = left(simd, count, by_output, backward, &mut pairs.columns);
                    multiply(simd, count, by_output, backward, joined, Start::Zero, Finish::Store);
                }
                let mask = Finish::Mask(input);
                if i == 0 {
                    if let Some(shared) = shared {
                        add_groups(sums, by_output, &shared.of[first..][..count], width);
                    }
                    // There is no ReLU of this network before its input.
                    let out = &mut input_gradient[first * k..];
                    let by_output = left(simd, count, by_output, &layer.backward, &mut pairs.columns);
                    let start = match self.joined {
                        Some(_) => Start::Rows { rows: joined, of: &self.each },
                        None => Start::Zero,
                    };
                    multiply(simd, count, by_output, &layer.backward, out, start, Finish::Store);
                } else {
                    below.resize(padded(count) * k);
                    let by_output = left(simd, count, by_output, &layer.backward, &mut pairs.columns);
                    multiply(simd, count, by_output, &layer.backward, below, Start::Zero, mask);
                    std::mem::swap(above, below);
                }
            }
        }
        if let (Some(inputs), Some(shared)) = (&self.shared, shared)
            && let Forward::Wide(w) = &inputs.forward
        {
            let shape = [inputs.rows.len(), width];
            pairs.accumulate(simd, w.precision(), shared.groups, shape, shared.input, sums, shared_weights);
        }
    }

    /// Number of parameter slots: the weights of each layer, and the biases if there are any.
    pub fn slots(&self) -> usize {
        self.layers.iter().map(|layer| 1 + usize::from(!layer.biases.is_empty())).sum()
    }

    /// Sums the gradients of slot `slot` over the deposits, in order, into its parameters, and sets the deposits to zero.
    pub fn flush<'a>(
        &self,
        slot: usize,
        gradients: impl Iterator<Item = &'a mut MlpGradient>,
        parameters: &mut [f32],
    ) {
        let each = self.slots() / self.layers.len();
        let (layer, is_bias) = (slot / each, slot % each == 1);
        let Layer { inputs, outputs, joined, .. } = &self.layers[layer];
        parameters.fill(0.0);
        for gradient in gradients {
            if is_bias {
                let sums = &mut gradient.biases[layer];
                parameters.iter_mut().zip(&**sums).for_each(|(parameter, sum)| *parameter += sum);
                sums.fill(0.0);
                continue;
            }
            inputs.unpack(*outputs, &gradient.layers[layer], parameters);
            gradient.layers[layer].fill(0.0);
            if let Some((inputs, _)) = joined {
                inputs.unpack(*outputs, &gradient.joined, parameters);
                gradient.joined.fill(0.0);
            }
            if let (0, Some(shared)) = (layer, &self.shared) {
                shared.unpack(*outputs, &gradient.shared, parameters);
                gradient.shared.fill(0.0);
            }
        }
    }
}

/// Adds all rows to `sums`, whose length is that of a row.
fn add_rows(sums: &mut [f32], rows: &[f32]) {
    for row in rows.chunks_exact(sums.len()) {
        sums.iter_mut().zip(row).for_each(|(sum, value)| *sum += value);
    }
}

/// Adds row i of `rows` to row `of[i]` of `sums`.
fn add_groups(sums: &mut [f32], rows: &[f32], of: &[u32], width: usize) {
    for (row, &group) in rows.chunks_exact(width).zip(of) {
        for (sum, value) in sums[group as usize * width..][..width].iter_mut().zip(row) {
            *sum += value;
        }
    }
}

impl Activations {
    /// The output, with padded width.
    pub fn output(&self) -> &Buffer<f32> {
        &self.layers[self.layers.len() - 1]
    }

    /// Replaces the output rows `kept` by weighted sums: row i times `shares[i]`, minus each later row times its share as long
    /// as that is negative.
    pub fn blend(&mut self, mlp: &Mlp, kept: &[u32], shares: &[f32]) {
        let width = mlp.outputs();
        let Some(output) = self.layers.last_mut() else { return };
        for &first in kept {
            let first = first as usize;
            let more = shares[first + 1..].iter().take_while(|share| **share < 0.0).count();
            if more == 0 {
                continue;
            }
            let (sum, rest) = output[first * width..(first + more + 1) * width].split_at_mut(width);
            sum.iter_mut().for_each(|value| *value *= shares[first]);
            for (row, share) in rest.chunks_exact(width).zip(&shares[first + 1..]) {
                sum.iter_mut().zip(row).for_each(|(sum, value)| *sum -= share * value);
            }
        }
    }

    /// Keeps the rows `kept` and drops the others.
    pub fn keep(&mut self, mlp: &Mlp, kept: &[u32]) {
        for (buffer, width) in self.layers.iter_mut().zip(mlp.widths()) {
            buffer.keep_rows(kept, width);
            buffer.resize(padded(kept.len()) * width);
        }
    }

    /// Removes all rows.
    pub fn clear(&mut self) {
        self.layers.iter_mut().for_each(Buffer::clear);
    }

    /// Appends the rows `rows` of `from`.
    pub fn append(&mut self, mlp: &Mlp, from: &Self, rows: &[u32]) {
        for ((buffer, from), width) in self.layers.iter_mut().zip(&from.layers).zip(mlp.widths()) {
            buffer.append_rows(from, rows, width);
        }
    }

    /// Replaces all rows by the rows `rows` of `from`.
    pub fn gather(&mut self, mlp: &Mlp, from: &Self, rows: &[u32]) {
        for ((buffer, from), width) in self.layers.iter_mut().zip(&from.layers).zip(mlp.widths()) {
            buffer.gather_rows(from, rows, width, padded(rows.len()));
        }
    }
}
