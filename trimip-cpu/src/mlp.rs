//! A small ReLU network without biases over rows of a tile. Widths are padded to multiples of 16 with zero weights; the
//! parameters know nothing of the padding.

use crate::buffer::Buffer;
use crate::gemm::{Finish, Packed, accumulate, multiply, padded};
use crate::simd::Simd;

/// Weights of the network, packed for both directions.
pub struct Mlp {
    layers: Vec<Layer>,
}

struct Layer {
    forward: Packed,
    backward: Packed,
    /// Parameter row of each padded input, if it has one.
    rows: Vec<Option<usize>>,
    /// Outputs that have parameters.
    outputs: usize,
}

/// Activations of every layer but the input: hidden layers after their ReLU, then the output.
#[derive(Default)]
pub struct Activations {
    layers: Vec<Buffer<f32>>,
}

/// Weight gradients, padded like the packed weights, and two buffers for gradients on their way back.
pub struct MlpGradient {
    layers: Vec<Buffer<f32>>,
}

impl Mlp {
    /// A network of the given layers ([inputs, outputs] each); `input_rows` says which parameter row each padded input
    /// of the first layer has.
    pub fn new(layers: &[[usize; 2]], input_rows: Vec<Option<usize>>) -> Self {
        let mut rows = input_rows;
        let layers = layers
            .iter()
            .map(|&[_, outputs]| {
                let (k, n) = (rows.len(), outputs.next_multiple_of(16));
                let next = (0..n).map(|column| (column < outputs).then_some(column)).collect();
                Layer {
                    forward: Packed::zeros(k, n),
                    backward: Packed::zeros(n, k),
                    rows: std::mem::replace(&mut rows, next),
                    outputs,
                }
            })
            .collect();
        Self { layers }
    }

    /// Packs parameters; `weights[i]` is layer i, [inputs, outputs].
    pub fn pack(&mut self, weights: &[&[f32]]) {
        for (layer, weights) in self.layers.iter_mut().zip(weights) {
            let Layer { forward, backward, rows, outputs } = layer;
            let value = |row: usize, column: usize| match rows[row] {
                Some(row) if column < *outputs => weights[row * *outputs + column],
                _ => 0.0,
            };
            forward.fill(value);
            backward.fill(|row, column| value(column, row));
        }
    }

    /// Padded width of the input.
    pub fn inputs(&self) -> usize {
        self.layers[0].forward.k
    }

    /// Room for activations.
    pub fn activations(&self) -> Activations {
        Activations { layers: self.layers.iter().map(|_| Buffer::zeros(0)).collect() }
    }

    /// A zero gradient.
    pub fn gradient(&self) -> MlpGradient {
        let layers =
            self.layers.iter().map(|layer| Buffer::zeros(layer.forward.k * layer.forward.n)).collect();
        MlpGradient { layers }
    }

    /// Runs `rows` rows through the network.
    pub fn forward(&self, simd: Simd, rows: usize, input: &[f32], activations: &mut Activations) {
        let last = self.layers.len() - 1;
        for (i, layer) in self.layers.iter().enumerate() {
            let (before, after) = activations.layers.split_at_mut(i);
            let input = if i == 0 { input } else { &before[i - 1][..] };
            after[0].resize(padded(rows) * layer.forward.n);
            let finish = if i == last { Finish::Store } else { Finish::Relu };
            multiply(simd, rows, input, &layer.forward, &mut after[0], finish);
        }
    }

    /// From the gradient of the output to that of the input, which is left in the returned buffer of `scratch`; adds to
    /// the weight gradients. `scratch[0]` holds the output's gradient, padded rows included.
    pub fn backward<'a>(
        &self,
        simd: Simd,
        rows: usize,
        input: &[f32],
        activations: &Activations,
        scratch: &'a mut [Buffer<f32>; 2],
        gradient: &mut MlpGradient,
    ) -> &'a mut Buffer<f32> {
        for (i, layer) in self.layers.iter().enumerate().rev() {
            let input = if i == 0 { input } else { &activations.layers[i - 1][..] };
            let (k, n) = (layer.forward.k, layer.forward.n);
            let [above, below] = scratch;
            accumulate(simd, rows, k, n, input, above, &mut gradient.layers[i]);
            below.resize(padded(rows) * k);
            // Behind the input lies no ReLU of this network.
            let finish = if i == 0 { Finish::Store } else { Finish::Mask(input) };
            multiply(simd, rows, above, &layer.backward, below, finish);
            scratch.swap(0, 1);
        }
        &mut scratch[0]
    }

    /// Sums the gradients of layer `layer` over the deposits in their order, into parameters [inputs, outputs], and
    /// zeroes them.
    pub fn flush<'a>(
        &self,
        layer: usize,
        gradients: impl Iterator<Item = &'a mut MlpGradient>,
        parameters: &mut [f32],
    ) {
        let Layer { rows, outputs, forward, .. } = &self.layers[layer];
        parameters.fill(0.0);
        for gradient in gradients {
            let gradient = &mut gradient.layers[layer];
            for (padded_row, row) in rows.iter().enumerate() {
                if let Some(row) = row {
                    let to = &mut parameters[row * outputs..][..*outputs];
                    for (to, from) in to.iter_mut().zip(&gradient[padded_row * forward.n..]) {
                        *to += from;
                    }
                }
            }
            gradient.fill(0.0);
        }
    }
}

impl Activations {
    /// The output, padded width.
    pub fn output(&self) -> &Buffer<f32> {
        &self.layers[self.layers.len() - 1]
    }

    /// Drops rows.
    pub fn keep(&mut self, mlp: &Mlp, kept: &[u32]) {
        for (buffer, layer) in self.layers.iter_mut().zip(&mlp.layers) {
            let width = layer.forward.n;
            buffer.keep_rows(kept, width);
            buffer.resize(padded(kept.len()) * width);
        }
    }
}
