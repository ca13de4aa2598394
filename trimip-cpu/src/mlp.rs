//! A small ReLU network without biases, over rows of a tile. Widths are padded to multiples of 16 with zero weights,
//! and up to four outputs to four; the parameters are not padded. Inputs that many rows share (all samples of a ray)
//! may go through the first layer once per group of rows. Activations and gradients are f32. At bf16 the factors of a
//! layer's products are rounded immediately before the product, except in a last layer of few outputs.

use crate::buffer::Buffer;
use crate::gemm::{Finish, Packed, ROWS, Start, accumulate, dots, multiply, padded, pair_columns, pair_rows};
use crate::simd::Simd;
use trimip_core::config::Precision;

/// Rows that go through all layers together. Their activations and a layer's weights fit into half of a 1 MiB L2.
pub const BLOCK: usize = 21 * ROWS;

/// Maximum number of outputs for which a last layer is computed by dot products.
const FEW: usize = 4;

/// Weights of the network, packed for the forward and the backward pass.
pub struct Mlp {
    layers: Vec<Layer>,
    /// First-layer weights of the shared inputs, if there are any.
    shared: Option<Inputs>,
}

struct Layer {
    inputs: Inputs,
    /// The transpose, [outputs, inputs], for the gradient of the inputs.
    backward: Packed,
    /// Number of outputs without padding.
    outputs: usize,
}

/// The weights of some inputs of a layer.
struct Inputs {
    forward: Forward,
    /// Parameter row of each padded input; `None` for padding.
    rows: Vec<Option<usize>>,
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
    /// The rows of a block as pairs of columns.
    pairs: Buffer<f32>,
}

/// Weight gradients, padded as the packed weights are.
pub struct MlpGradient {
    layers: Vec<Buffer<f32>>,
    shared: Buffer<f32>,
}

/// A worker's buffers for a backward pass, used by one network at a time.
#[derive(Default)]
pub struct Passing {
    /// The gradients above and below a layer, for one block.
    scratch: [Buffer<f32>; 2],
    /// Gradients of the first layer's outputs, summed over each group.
    sums: Buffer<f32>,
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
    fn new(rows: Vec<Option<usize>>, outputs: usize, last: bool, precision: Precision) -> Self {
        let forward = if last && outputs <= FEW {
            Forward::Few(Buffer::zeros(outputs * rows.len()))
        } else {
            Forward::Wide(Packed::zeros(rows.len(), outputs.next_multiple_of(16), precision))
        };
        Self { forward, rows }
    }

    fn fill(&mut self, outputs: usize, weights: &[f32]) {
        let Self { forward, rows } = self;
        let value = |row: usize, column: usize| weight(rows, outputs, weights, row, column);
        match forward {
            Forward::Wide(packed) => packed.fill(value),
            Forward::Few(dots) => {
                for (place, weight) in dots.iter_mut().enumerate() {
                    *weight = value(place % rows.len(), place / rows.len());
                }
            }
        }
    }

    /// Adds a padded gradient to parameters [inputs, outputs].
    fn unpack(&self, outputs: usize, gradient: &[f32], parameters: &mut [f32]) {
        for (padded_row, row) in self.rows.iter().enumerate() {
            let Some(row) = row else { continue };
            for column in 0..outputs {
                let place = match &self.forward {
                    Forward::Wide(packed) => padded_row * packed.n() + column,
                    Forward::Few(_) => column * self.rows.len() + padded_row,
                };
                parameters[row * outputs + column] += gradient[place];
            }
        }
    }
}

/// The weight at a padded row and column.
fn weight(rows: &[Option<usize>], outputs: usize, weights: &[f32], row: usize, column: usize) -> f32 {
    match rows[row] {
        Some(row) if column < outputs => weights[row * outputs + column],
        _ => 0.0,
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
}

impl Mlp {
    /// A network of the given layers ([inputs, outputs] each). `input_rows` gives the parameter row of each padded
    /// input of the first layer; `shared_rows` does the same for the inputs that groups of rows share.
    pub fn new(
        layers: &[[usize; 2]],
        input_rows: Vec<Option<usize>>,
        shared_rows: Vec<Option<usize>>,
        precision: Precision,
    ) -> Self {
        let shared =
            (!shared_rows.is_empty()).then(|| Inputs::new(shared_rows, layers[0][1], false, precision));
        let mut rows = input_rows;
        let count = layers.len();
        let layers = layers
            .iter()
            .enumerate()
            .map(|(i, &[_, outputs])| {
                let k = rows.len();
                let inputs = Inputs::new(std::mem::take(&mut rows), outputs, i + 1 == count, precision);
                let (n, precision) = match &inputs.forward {
                    Forward::Wide(packed) => (packed.n(), precision),
                    Forward::Few(_) => (FEW, Precision::F32),
                };
                rows = (0..n).map(|column| (column < outputs).then_some(column)).collect();
                Layer { inputs, backward: Packed::zeros(n, k, precision), outputs }
            })
            .collect();
        Self { layers, shared }
    }

    /// Packs parameters; `weights[i]` is layer i, [inputs, outputs].
    pub fn pack(&mut self, weights: &[&[f32]]) {
        if let Some(shared) = &mut self.shared {
            shared.fill(self.layers[0].outputs, weights[0]);
        }
        for (layer, weights) in self.layers.iter_mut().zip(weights) {
            let Layer { inputs, backward, outputs } = layer;
            inputs.fill(*outputs, weights);
            backward.fill(|row, column| weight(&inputs.rows, *outputs, weights, column, row));
        }
    }

    /// Padded width of the input.
    pub fn inputs(&self) -> usize {
        self.layers[0].k()
    }

    /// Padded width of the output.
    pub fn outputs(&self) -> usize {
        self.layers[self.layers.len() - 1].n()
    }

    /// Creates empty activations.
    pub fn activations(&self) -> Activations {
        Activations {
            layers: self.layers.iter().map(|_| Buffer::zeros(0)).collect(),
            shared: Buffer::zeros(0),
            pairs: Buffer::zeros(0),
        }
    }

    /// Creates a zero gradient.
    pub fn gradient(&self) -> MlpGradient {
        let size = |inputs: &Inputs, n: usize| inputs.rows.len() * n;
        MlpGradient {
            layers: self.layers.iter().map(|layer| Buffer::zeros(size(&layer.inputs, layer.n()))).collect(),
            shared: Buffer::zeros(self.shared.as_ref().map_or(0, |s| size(s, self.layers[0].n()))),
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
        let Activations { layers: buffers, shared: group_rows, pairs } = activations;
        for (buffer, layer) in buffers.iter_mut().zip(&self.layers) {
            buffer.resize(padded(rows) * layer.n());
        }
        assert_eq!(self.shared.is_some(), shared.is_some(), "shared inputs");
        if let (Some(Inputs { forward: Forward::Wide(weights), .. }), Some(shared)) = (&self.shared, shared) {
            group_rows.resize(padded(shared.groups) * weights.n());
            let input = left(simd, shared.groups, shared.input, weights, pairs);
            multiply(simd, shared.groups, input, weights, group_rows, Start::Zero, Finish::Store);
        }
        let last = self.layers.len() - 1;
        for first in (0..rows).step_by(BLOCK) {
            let count = (rows - first).min(BLOCK);
            for (i, layer) in self.layers.iter().enumerate() {
                let (before, after) = buffers.split_at_mut(i);
                let input = if i == 0 { input } else { &before[i - 1][..] };
                let input = &input[first * layer.k()..];
                let out = &mut after[0][first * layer.n()..];
                match &layer.inputs.forward {
                    Forward::Wide(weights) => {
                        let start = match shared {
                            Some(shared) if i == 0 => {
                                Start::Rows { rows: group_rows, of: &shared.of[first..] }
                            }
                            _ => Start::Zero,
                        };
                        let finish = if i == last { Finish::Store } else { Finish::Relu };
                        let input = left(simd, count, input, weights, pairs);
                        multiply(simd, count, input, weights, out, start, finish);
                    }
                    Forward::Few(weights) => dots(simd, count, layer.k(), input, weights, out, layer.n()),
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
        let MlpGradient { layers: weights, shared: shared_weights } = gradient;
        let Passing { scratch: [above, below], sums, pairs } = passing;
        let width = self.layers[0].n();
        if let Some(shared) = shared {
            sums.resize(shared.groups * width);
            sums.fill(0.0);
        }
        for first in (0..rows).step_by(BLOCK) {
            let count = (rows - first).min(BLOCK);
            for (i, layer) in self.layers.iter().enumerate().rev() {
                let (k, n) = (layer.k(), layer.n());
                let input = if i == 0 { input } else { &activations.layers[i - 1][..] };
                let input = &input[first * k..];
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
                let mask = Finish::Mask(input);
                if i == 0 {
                    if let Some(shared) = shared {
                        add_groups(sums, by_output, &shared.of[first..][..count], width);
                    }
                    // There is no ReLU of this network before its input.
                    let out = &mut input_gradient[first * k..];
                    let by_output = left(simd, count, by_output, &layer.backward, &mut pairs.columns);
                    multiply(simd, count, by_output, &layer.backward, out, Start::Zero, Finish::Store);
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

    /// Sums the gradients of layer `layer` over the deposits, in order, into parameters [inputs, outputs], and sets
    /// the deposits to zero.
    pub fn flush<'a>(
        &self,
        layer: usize,
        gradients: impl Iterator<Item = &'a mut MlpGradient>,
        parameters: &mut [f32],
    ) {
        let Layer { inputs, outputs, .. } = &self.layers[layer];
        parameters.fill(0.0);
        for gradient in gradients {
            inputs.unpack(*outputs, &gradient.layers[layer], parameters);
            gradient.layers[layer].fill(0.0);
            if let (0, Some(shared)) = (layer, &self.shared) {
                shared.unpack(*outputs, &gradient.shared, parameters);
                gradient.shared.fill(0.0);
            }
        }
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
        for (buffer, layer) in self.layers.iter_mut().zip(&mlp.layers) {
            let width = layer.n();
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
        for ((buffer, from), layer) in self.layers.iter_mut().zip(&from.layers).zip(&mlp.layers) {
            buffer.append_rows(from, rows, layer.n());
        }
    }

    /// Replaces all rows by the rows `rows` of `from`.
    pub fn gather(&mut self, mlp: &Mlp, from: &Self, rows: &[u32]) {
        for ((buffer, from), layer) in self.layers.iter_mut().zip(&from.layers).zip(&mlp.layers) {
            buffer.gather_rows(from, rows, layer.n(), padded(rows.len()));
        }
    }
}
