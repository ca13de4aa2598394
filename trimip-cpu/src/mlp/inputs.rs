//! Padded weights of some of a layer's inputs, packed for matrix products.

use crate::buffer::Buffer;
use crate::gemm::Packed;
use trimip_core::config::Precision;

/// Maximum number of outputs for which a last layer is computed by dot products.
pub(super) const FEW: usize = 4;

/// The weights of one padded input of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputRow {
    /// Zeros: padding.
    Zero,
    /// A row of the weights.
    Weights(usize),
    /// One for the first output, which then has no trained weights, and zero for all other outputs.
    One,
}

impl InputRow {
    /// Returns one row for each padded input `0..stride`; the first `inputs` of them have weights.
    pub fn all(inputs: usize, stride: usize) -> Vec<Self> {
        (0..stride).map(|row| if row < inputs { Self::Weights(row) } else { Self::Zero }).collect()
    }
}

/// The weights of some inputs of a layer.
pub(super) struct Inputs {
    pub(super) forward: Forward,
    /// One per padded input.
    pub(super) rows: Vec<InputRow>,
    /// Index of the first output that has weights: 1 if output 0 is a plain sum of inputs.
    pub(super) offset: usize,
}

pub(super) enum Forward {
    /// Weights in column panels, for a matrix product.
    Wide(Packed),
    /// Weights [outputs, inputs], for dot products with few outputs.
    Few(Buffer<f32>),
}

impl Inputs {
    pub(super) fn new(rows: Vec<InputRow>, outputs: usize, last: bool, precision: Precision) -> Self {
        let forward = if last && outputs <= FEW {
            Forward::Few(Buffer::zeros(outputs * rows.len()))
        } else {
            Forward::Wide(Packed::zeros(rows.len(), outputs.next_multiple_of(16), precision))
        };
        let offset = usize::from(rows.contains(&InputRow::One));
        Self { forward, rows, offset }
    }

    /// Returns the weight at a padded row and column; `weights` has rows of `outputs` − offset values.
    pub(super) fn weight(&self, outputs: usize, weights: &[f32], row: usize, column: usize) -> f32 {
        let weighted = self.offset..outputs;
        match self.rows[row] {
            InputRow::Weights(row) if weighted.contains(&column) => {
                weights[row * weighted.len() + column - self.offset]
            }
            InputRow::One if column == 0 => 1.0,
            _ => 0.0,
        }
    }

    pub(super) fn fill(&mut self, outputs: usize, weights: &[f32]) {
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

    /// Adds a padded gradient to `parameters`, [inputs, outputs − offset], without the padding.
    pub(super) fn unpack(&self, outputs: usize, gradient: &[f32], parameters: &mut [f32]) {
        let weighted = self.offset..outputs;
        for (padded_row, row) in self.rows.iter().enumerate() {
            let InputRow::Weights(row) = row else { continue };
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
