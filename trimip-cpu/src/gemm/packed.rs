//! A weight matrix packed for the matrix-product kernels.

use super::words::words;
use crate::buffer::Buffer;
use crate::simd::pair;
use trimip_core::config::Precision;

/// A weight matrix [k, n] packed in panels; n is a multiple of 16.
pub struct Packed {
    k: usize,
    n: usize,
    precision: Precision,
    /// Words of all panels.
    data: Buffer<f32>,
}

impl Packed {
    /// Creates a matrix of zeros; `k` is even.
    pub fn zeros(k: usize, n: usize, precision: Precision) -> Self {
        assert!(n.is_multiple_of(16) && k.is_multiple_of(2), "padded widths");
        Self { k, n, precision, data: Buffer::zeros(words(k, precision) * n) }
    }

    /// Fills the matrix from `value(row, column)`.
    pub fn fill(&mut self, value: impl Fn(usize, usize) -> f32) {
        let height = self.words();
        for column in 0..self.n {
            let panel = column / 32 * 32;
            let width = (self.n - panel).min(32);
            for row in 0..height {
                self.data[panel * height + row * width + column - panel] = match self.precision {
                    Precision::F32 | Precision::F16 => value(row, column),
                    Precision::Bf16 => pair(value(2 * row, column), value(2 * row + 1, column)),
                };
            }
        }
    }

    /// Returns the number of rows of words, over which a product sums.
    #[inline(always)]
    pub(super) fn words(&self) -> usize {
        words(self.k, self.precision)
    }

    /// Returns the words of the panel that begins at column `first`, and of all later panels.
    #[inline(always)]
    pub(super) fn panel(&self, first: usize) -> &[f32] {
        &self.data[first * self.words()..]
    }

    /// Returns the number of rows (inputs).
    pub fn k(&self) -> usize {
        self.k
    }

    /// Returns the number of columns (outputs).
    pub fn n(&self) -> usize {
        self.n
    }

    /// Returns the precision in which the matrix is stored. The left factor of a product must have the same precision.
    pub fn precision(&self) -> Precision {
        self.precision
    }
}
