//! The initial values of a product, its last operation, and the shapes of a weight gradient.

use crate::simd::Simd;
use trimip_core::config::Precision;

/// Initial value of a product.
#[derive(Clone, Copy)]
pub enum Start<'a> {
    /// Zero.
    Zero,
    /// Row i of the product starts from row `of[i]` of `rows`, which has the same width.
    Rows {
        /// The rows to start from.
        rows: &'a [f32],
        /// One index per row of the product, padding included.
        of: &'a [u32],
    },
}

/// Operation on a product before it is stored.
#[derive(Clone, Copy)]
pub enum Finish<'a> {
    /// No operation.
    Store,
    /// ReLU: values below zero become zero.
    Relu,
    /// Derivative of a ReLU: values become zero where this matrix, which has the shape of the product, is not above
    /// zero.
    Mask(&'a [f32]),
}

/// Initial value of a product, and its last operation.
#[derive(Clone, Copy)]
pub struct Epilogue<'a> {
    /// Initial value.
    pub start: Start<'a>,
    /// Last operation.
    pub finish: Finish<'a>,
}

/// Parameters of a weight gradient, and the shapes of its factors: A is [rows, k], D is [rows, n].
#[derive(Clone, Copy, Debug)]
pub struct Product {
    /// Instruction set.
    pub simd: Simd,
    /// Precision of the factors.
    pub precision: Precision,
    /// Number of rows of both factors.
    pub rows: usize,
    /// Columns of A.
    pub k: usize,
    /// Columns of D.
    pub n: usize,
}
