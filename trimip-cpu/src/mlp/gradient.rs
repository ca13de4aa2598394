//! Gradients of a network's weights, and a worker's buffers for the backward pass.

use crate::buffer::Buffer;
use crate::gemm::{Product, accumulate, pair_rows};
use crate::wire::{Reader, put};
use trimip_core::Result;
use trimip_core::config::Precision;

/// Weight gradients, with the padding of the packed weights.
pub struct MlpGradient {
    pub(super) layers: Vec<Buffer<f32>>,
    pub(super) shared: Buffer<f32>,
    pub(super) joined: Buffer<f32>,
    pub(super) biases: Vec<Buffer<f32>>,
}

impl MlpGradient {
    fn buffers(&self) -> impl Iterator<Item = &Buffer<f32>> {
        self.layers.iter().chain([&self.shared, &self.joined]).chain(&self.biases)
    }

    fn buffers_mut(&mut self) -> impl Iterator<Item = &mut Buffer<f32>> {
        self.layers.iter_mut().chain([&mut self.shared, &mut self.joined]).chain(&mut self.biases)
    }

    /// Adds the gradient `other`, and sets `other` to zero.
    pub fn fold(&mut self, other: &mut Self) {
        for (sums, values) in self.buffers_mut().zip(other.buffers_mut()) {
            sums.iter_mut().zip(values.iter()).for_each(|(sum, value)| *sum += value);
            values.fill(0.0);
        }
    }

    /// Appends the bytes of all gradients to the message `out`.
    pub fn put(&self, out: &mut Vec<u8>) {
        self.buffers().for_each(|values| put(out, values));
    }

    /// Replaces all gradients with those that [`put`](Self::put) wrote.
    ///
    /// # Errors
    /// When the message is too short.
    pub fn take(&mut self, from: &mut Reader<'_>) -> Result<()> {
        self.buffers_mut().try_for_each(|values| from.copy(values))
    }
}

/// The gradients of a backward pass.
pub struct Flow<'a> {
    /// Gradient of the network's output, with padded rows and width.
    pub output: &'a [f32],
    /// Receives the gradient of the network's input, also with padded rows and width.
    pub input: &'a mut Buffer<f32>,
    /// Weight gradient, to which the backward pass adds.
    pub weights: &'a mut MlpGradient,
}

/// A worker's buffers for a backward pass, used by one network at a time.
#[derive(Default)]
pub struct Passing {
    /// Gradients of a layer's outputs and of its inputs, for one block.
    pub(super) scratch: [Buffer<f32>; 2],
    /// Gradients of the first layer's outputs, summed over each group.
    pub(super) sums: Buffer<f32>,
    /// Gradient of the network's input through the skip connection, for one block.
    pub(super) joined: Buffer<f32>,
    pub(super) pairs: Pairs,
}

/// The factors of a block as pairs of bf16.
#[derive(Default)]
pub(super) struct Pairs {
    /// Gradient of a layer's outputs, in pairs of neighbouring columns.
    pub(super) columns: Buffer<f32>,
    /// A layer's inputs and the gradient of its outputs, in pairs of neighbouring rows.
    pub(super) rows: [Buffer<f32>; 2],
}

impl Pairs {
    /// Adds `input`ᵀ·`by_output` to the weight gradient of a layer.
    pub(super) fn accumulate(
        &mut self,
        product: Product,
        input: &[f32],
        by_output: &[f32],
        weights: &mut [f32],
    ) {
        let Product { simd, precision, rows, k, n } = product;
        match precision {
            Precision::F32 | Precision::F16 => accumulate(product, input, by_output, weights),
            Precision::Bf16 => {
                let [a, d] = &mut self.rows;
                pair_rows(simd, rows, k, input, a);
                pair_rows(simd, rows, n, by_output, d);
                accumulate(Product { rows: rows.div_ceil(2), ..product }, a, d, weights);
            }
        }
    }
}
