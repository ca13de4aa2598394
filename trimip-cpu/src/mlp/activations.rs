//! The activations of a network: one buffer of rows per layer, with operations that keep, append and gather rows.

use super::Mlp;
use crate::buffer::Buffer;
use crate::gemm::padded;

/// Activations of every layer except the input: hidden layers after their ReLU, then the output.
#[derive(Default)]
pub struct Activations {
    pub(super) layers: Vec<Buffer<f32>>,
    /// Contribution of the shared inputs to the first layer, [groups (padded), outputs of that layer].
    pub(super) shared: Buffer<f32>,
    /// Contribution of the network's input to the layer with the skip connection, for one block.
    pub(super) joined: Buffer<f32>,
    /// The rows of a block, packed into bf16 pairs of neighbouring columns.
    pub(super) pairs: Buffer<f32>,
}

impl Activations {
    /// Returns the output, [rows, width], with padded rows and width.
    pub fn output(&self) -> &Buffer<f32> {
        &self.layers[self.layers.len() - 1]
    }

    /// Replaces each output row in `kept` with the weighted sum of its group. The group of row i continues with the
    /// following rows whose fractions are negative; the weight of a row is the magnitude of its fraction.
    pub fn blend(&mut self, mlp: &Mlp, kept: &[u32], fractions: &[f32]) {
        let width = mlp.outputs();
        let Some(output) = self.layers.last_mut() else { return };
        for &first in kept {
            let first = first as usize;
            let more = fractions[first + 1..].iter().take_while(|fraction| **fraction < 0.0).count();
            if more == 0 {
                continue;
            }
            let (sum, rest) = output[first * width..(first + more + 1) * width].split_at_mut(width);
            sum.iter_mut().for_each(|value| *value *= fractions[first]);
            for (row, fraction) in rest.chunks_exact(width).zip(&fractions[first + 1..]) {
                sum.iter_mut().zip(row).for_each(|(sum, value)| *sum -= fraction * value);
            }
        }
    }

    /// Keeps the rows with the indices `kept` and drops all others.
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

    /// Appends the rows of `from` with the indices `rows`.
    pub fn append(&mut self, mlp: &Mlp, from: &Self, rows: &[u32]) {
        for ((buffer, from), width) in self.layers.iter_mut().zip(&from.layers).zip(mlp.widths()) {
            buffer.append_rows(from, rows, width);
        }
    }

    /// Replaces all rows with the rows of `from` that have the indices `rows`.
    pub fn gather(&mut self, mlp: &Mlp, from: &Self, rows: &[u32]) {
        for ((buffer, from), width) in self.layers.iter_mut().zip(&from.layers).zip(mlp.widths()) {
            buffer.gather_rows(from, rows, width, padded(rows.len()));
        }
    }
}
