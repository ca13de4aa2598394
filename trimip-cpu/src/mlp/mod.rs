//! A small ReLU network over rows of a tile, with or without biases. Widths are padded with zero weights to multiples of 16;
//! a last layer of up to four outputs is padded to four. The parameters are not padded. If many rows share some inputs (all
//! samples of a ray), the first layer may compute the contribution of these inputs once per group of rows. One later layer
//! may have a skip connection from the input. A network without layers copies its input. Activations and gradients are f32.
//! At bf16 the factors of a layer's products are rounded immediately before the product, except in a last layer of few
//! outputs.

mod activations;
mod gradient;
mod inputs;

use crate::buffer::Buffer;
use crate::gemm::{
    Epilogue, Finish, Packed, Product, ROWS, Start, accumulate, dots, multiply, padded, pair_columns,
};
use crate::simd::Simd;
pub use activations::Activations;
pub use gradient::{Flow, MlpGradient, Passing};
pub use inputs::InputRow;
use inputs::{FEW, Forward, Inputs};
use trimip_core::config::Precision;
use trimip_core::field::networks::Network;

/// Number of rows that pass through all layers together. Their activations and a layer's weights fit into half of a 1
/// MiB L2.
pub const BLOCK: usize = 21 * ROWS;

/// Weights of the network, packed for the forward and the backward pass.
pub struct Mlp {
    layers: Vec<Layer>,
    /// Padded width of the rows that a network without layers copies.
    copied: usize,
    /// First-layer weights of the shared inputs, if there are any.
    shared: Option<Inputs>,
    /// Index of the layer with a skip connection from the network's input.
    joined: Option<usize>,
    /// Indices of the rows that hold the initial values of a layer's products: `each` counts the rows of a block,
    /// `first` holds zeros.
    each: Vec<u32>,
    first: Vec<u32>,
}

struct Layer {
    inputs: Inputs,
    /// The transposed weights, [outputs, inputs], for the gradient of the inputs.
    backward: Packed,
    /// Padded biases; empty if the network has none.
    biases: Buffer<f32>,
    /// For the layer with the skip connection: the weights of the network's input, and their transpose.
    joined: Option<(Inputs, Packed)>,
    /// Number of outputs without padding.
    outputs: usize,
}

/// Inputs that groups of rows share.
#[derive(Clone, Copy)]
pub struct Shared<'a> {
    /// Number of groups.
    pub groups: usize,
    /// Shared inputs, [groups (padded), inputs].
    pub input: &'a [f32],
    /// Group of each row, padding included.
    pub of: &'a [u32],
}

/// The rows that pass through a network.
#[derive(Clone, Copy)]
pub struct Batch<'a> {
    /// Instruction set.
    pub simd: Simd,
    /// Number of rows.
    pub rows: usize,
    /// Inputs, [rows (padded), inputs].
    pub input: &'a [f32],
    /// Inputs that groups of rows share; `None` if the network has no such inputs.
    pub shared: Option<Shared<'a>>,
}

/// Returns rows of `w.k` values as the left factor of a product with `w`. If `w` is bf16, the rows are packed into
/// `pairs`.
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

impl Layer {
    /// Returns the number of padded inputs.
    fn k(&self) -> usize {
        self.inputs.rows.len()
    }

    /// Returns the number of padded outputs, which is the number of rows of the transpose.
    fn n(&self) -> usize {
        self.backward.k()
    }

    /// Returns the initial values of the layer's products: the biases, for every row. `first` holds a zero for each
    /// row.
    fn start<'a>(&'a self, first: &'a [u32]) -> Start<'a> {
        match self.biases.is_empty() {
            true => Start::Zero,
            false => Start::Rows { rows: &self.biases, of: first },
        }
    }
}

impl Mlp {
    /// Creates the network `shape`. `input_rows` describes the weights of each padded input of the first layer,
    /// `shared_rows` the weights of each input that groups of rows share.
    pub fn new(
        shape: &Network,
        input_rows: Vec<InputRow>,
        shared_rows: Vec<InputRow>,
        precision: Precision,
    ) -> Self {
        let shared =
            (!shared_rows.is_empty()).then(|| Inputs::new(shared_rows, shape.layers[0][1], false, precision));
        let copied = if shape.layers.is_empty() { input_rows.len() } else { 0 };
        let again = input_rows.clone();
        let mut rows = input_rows;
        let count = shape.layers.len();
        let layers = shape.layers.iter().enumerate().map(|(i, &[_, outputs])| {
            let k = rows.len();
            let before = rows.iter().filter(|row| **row != InputRow::Zero).count();
            let inputs = Inputs::new(std::mem::take(&mut rows), outputs, i + 1 == count, precision);
            let (n, precision) = match &inputs.forward {
                Forward::Wide(packed) => (packed.n(), precision),
                Forward::Few(_) => (FEW, Precision::F32),
            };
            rows = InputRow::all(outputs, n);
            let joined = (shape.joined == Some(i)).then(|| {
                let after = |row: &InputRow| match row {
                    InputRow::Weights(row) => InputRow::Weights(before + row),
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

    /// Packs `parameters`, which hold for each layer its weights, [inputs, outputs], and its biases if it has any.
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

    /// Returns the padded width of the input.
    pub fn inputs(&self) -> usize {
        self.layers.first().map_or(self.copied, Layer::k)
    }

    /// Returns the padded width of the output.
    pub fn outputs(&self) -> usize {
        self.layers.last().map_or(self.copied, Layer::n)
    }

    /// Returns the padded widths of the activations.
    fn widths(&self) -> impl Iterator<Item = usize> {
        let copied = self.layers.is_empty().then_some(self.copied);
        self.layers.iter().map(Layer::n).chain(copied)
    }

    /// Returns the layer with the skip connection, its weights for the network's input, and the transpose of these
    /// weights.
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

    /// Runs rows through the network. Each block of rows passes through all layers before the next block, so that its
    /// activations stay in L2.
    ///
    /// # Panics
    /// When `batch` has shared inputs and the network has none, or the other way round.
    pub fn forward(&self, batch: Batch<'_>, activations: &mut Activations) {
        let Batch { simd, rows, input, shared } = batch;
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
            let epilogue = Epilogue { start, finish: Finish::Store };
            multiply(simd, shared.groups, input, weights, group_rows, epilogue);
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
                    let epilogue = Epilogue { start: layer.start(&self.first), finish: Finish::Store };
                    multiply(simd, count, own, weights, joined, epilogue);
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
                        multiply(simd, count, input, weights, out, Epilogue { start, finish });
                    }
                    Forward::Few(weights) => {
                        dots(simd, count, [layer.k(), layer.n()], input, weights, out);
                        if !layer.biases.is_empty() {
                            let rows = out.chunks_exact_mut(layer.n()).take(count);
                            rows.for_each(|row| {
                                row.iter_mut().zip(&*layer.biases).for_each(|(x, b)| *x += b);
                            });
                        }
                    }
                }
            }
        }
    }

    /// Computes the gradient of the input from the gradient of the output, and adds to the weight gradients.
    pub fn backward(
        &self,
        batch: Batch<'_>,
        activations: &Activations,
        flow: Flow<'_>,
        passing: &mut Passing,
    ) {
        let Batch { simd, rows, input, shared } = batch;
        let Flow { output: output_gradient, input: input_gradient, weights: gradient } = flow;
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
                let product = |precision, k, n| Product { simd, precision, rows: count, k, n };
                let own = &input[first * self.inputs()..];
                let input = if i == 0 { own } else { &activations.layers[i - 1][first * k..] };
                let by_output =
                    if i + 1 == self.layers.len() { &output_gradient[first * n..] } else { &above[..] };
                match &layer.inputs.forward {
                    Forward::Wide(w) => {
                        pairs.accumulate(product(w.precision(), k, n), input, by_output, &mut weights[i]);
                    }
                    Forward::Few(_) => {
                        accumulate(product(Precision::F32, n, k), by_output, input, &mut weights[i]);
                    }
                }
                if !layer.biases.is_empty() {
                    add_rows(&mut biases[i], &by_output[..count * n]);
                }
                if let Some((Inputs { forward: Forward::Wide(w), .. }, backward)) = &layer.joined {
                    let product = product(w.precision(), self.inputs(), n);
                    pairs.accumulate(product, own, by_output, joined_weights);
                    joined.resize(padded(count) * self.inputs());
                    let by_output = left(simd, count, by_output, backward, &mut pairs.columns);
                    let epilogue = Epilogue { start: Start::Zero, finish: Finish::Store };
                    multiply(simd, count, by_output, backward, joined, epilogue);
                }
                let mask = Finish::Mask(input);
                if i == 0 {
                    if let Some(shared) = shared {
                        add_groups(sums, by_output, &shared.of[first..][..count], width);
                    }
                    // The input of the first layer does not come from a ReLU of this network, so it needs no mask.
                    let out = &mut input_gradient[first * k..];
                    let by_output = left(simd, count, by_output, &layer.backward, &mut pairs.columns);
                    let start = match self.joined {
                        Some(_) => Start::Rows { rows: joined, of: &self.each },
                        None => Start::Zero,
                    };
                    let epilogue = Epilogue { start, finish: Finish::Store };
                    multiply(simd, count, by_output, &layer.backward, out, epilogue);
                } else {
                    below.resize(padded(count) * k);
                    let by_output = left(simd, count, by_output, &layer.backward, &mut pairs.columns);
                    let epilogue = Epilogue { start: Start::Zero, finish: mask };
                    multiply(simd, count, by_output, &layer.backward, below, epilogue);
                    std::mem::swap(above, below);
                }
            }
        }
        if let (Some(inputs), Some(shared)) = (&self.shared, shared)
            && let Forward::Wide(w) = &inputs.forward
        {
            let (precision, k) = (w.precision(), inputs.rows.len());
            let product = Product { simd, precision, rows: shared.groups, k, n: width };
            pairs.accumulate(product, shared.input, sums, shared_weights);
        }
    }

    /// Returns the number of parameter slots: the weights of each layer, and the biases if there are any.
    pub fn slots(&self) -> usize {
        self.layers.iter().map(|layer| 1 + usize::from(!layer.biases.is_empty())).sum()
    }

    /// Sums the gradients of slot `slot` over the partial gradients, in order, into `parameters`, and sets the partial gradients to zero.
    pub fn reduce<'a>(
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

/// Adds all rows to `sums`, which has the length of a row.
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
