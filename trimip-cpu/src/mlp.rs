//! A small ReLU network without biases over rows of a tile. Widths are padded to multiples of 16 with zero weights; the
//! parameters know nothing of the padding.

use crate::buffer::Buffer;
use crate::gemm::{Finish, Packed, ROWS, accumulate, multiply, padded};
use crate::simd::Simd;

/// Rows that go through all layers together: their activations and a layer's weights fit into half of a 1 MiB L2.
const BLOCK: usize = 21 * ROWS;

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

/// Weight gradients, padded like the packed weights, and two buffers for a block's gradients on their way back.
pub struct MlpGradient {
    layers: Vec<Buffer<f32>>,
    scratch: [Buffer<f32>; 2],
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
        MlpGradient { layers, scratch: [Buffer::zeros(0), Buffer::zeros(0)] }
    }

    /// Runs `rows` rows through the network, a block at a time through all layers: a block's activations stay in L2.
    pub fn forward(&self, simd: Simd, rows: usize, input: &[f32], activations: &mut Activations) {
        for (buffer, layer) in activations.layers.iter_mut().zip(&self.layers) {
            buffer.resize(padded(rows) * layer.forward.n);
        }
        let last = self.layers.len() - 1;
        for start in (0..rows).step_by(BLOCK) {
            let count = (rows - start).min(BLOCK);
            for (i, layer) in self.layers.iter().enumerate() {
                let (before, after) = activations.layers.split_at_mut(i);
                let input = if i == 0 { input } else { &before[i - 1][..] };
                let out = &mut after[0][start * layer.forward.n..];
                let finish = if i == last { Finish::Store } else { Finish::Relu };
                multiply(simd, count, &input[start * layer.forward.k..], &layer.forward, out, finish);
            }
        }
    }

    /// From the gradient of the output to `input_gradient`, both of padded rows and width; adds to the weight gradients.
    #[allow(clippy::too_many_arguments)]
    pub fn backward(
        &self,
        simd: Simd,
        rows: usize,
        input: &[f32],
        activations: &Activations,
        output_gradient: &[f32],
        input_gradient: &mut Buffer<f32>,
        gradient: &mut MlpGradient,
    ) {
        input_gradient.resize(padded(rows) * self.inputs());
        let [above, below] = &mut gradient.scratch;
        for start in (0..rows).step_by(BLOCK) {
            let count = (rows - start).min(BLOCK);
            for (i, layer) in self.layers.iter().enumerate().rev() {
                let (k, n) = (layer.forward.k, layer.forward.n);
                let input = if i == 0 { input } else { &activations.layers[i - 1][..] };
                let input = &input[start * k..];
                let by_output =
                    if i + 1 == self.layers.len() { &output_gradient[start * n..] } else { &above[..] };
                accumulate(simd, count, k, n, input, by_output, &mut gradient.layers[i]);
                if i == 0 {
                    // Behind the input lies no ReLU of this network.
                    let out = &mut input_gradient[start * k..];
                    multiply(simd, count, by_output, &layer.backward, out, Finish::Store);
                } else {
                    below.resize(padded(count) * k);
                    multiply(simd, count, by_output, &layer.backward, below, Finish::Mask(input));
                    std::mem::swap(above, below);
                }
            }
        }
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

    /// Forgets all rows.
    pub fn clear(&mut self) {
        self.layers.iter_mut().for_each(Buffer::clear);
    }

    /// Appends the rows `rows` of `from`.
    pub fn append(&mut self, mlp: &Mlp, from: &Self, rows: &[u32]) {
        for ((buffer, from), layer) in self.layers.iter_mut().zip(&from.layers).zip(&mlp.layers) {
            buffer.append_rows(from, rows, layer.forward.n);
        }
    }

    /// Becomes the rows `rows` of `from`.
    pub fn gather(&mut self, mlp: &Mlp, from: &Self, rows: &[u32]) {
        for ((buffer, from), layer) in self.layers.iter_mut().zip(&from.layers).zip(&mlp.layers) {
            buffer.gather_rows(from, rows, layer.forward.n, padded(rows.len()));
        }
    }
}
