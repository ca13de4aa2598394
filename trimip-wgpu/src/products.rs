//! Kernels of matrix products, in f32 or with cooperative f16 matrices: sizes of their tiles and blocks of rows.

use crate::device::Size;
use crate::kernel::Access::{self, Parameters, Read, Write};
use crate::kernel::Kernel;
use crate::rows::Rows;

const PRODUCT: &str = include_str!("shaders/multiply.wgsl");
const STORE: &str = include_str!("shaders/finish_store.wgsl");
const RELU: &str = include_str!("shaders/finish_relu.wgsl");
const MASK: &str = include_str!("shaders/finish_mask.wgsl");
const ADD: &str = include_str!("shaders/finish_add.wgsl");
const ADD_RELU: &str = include_str!("shaders/finish_add_relu.wgsl");
const MULTIPLY: [&[&str]; 5] =
    [&[STORE, PRODUCT], &[RELU, PRODUCT], &[MASK, PRODUCT], &[ADD, PRODUCT], &[ADD_RELU, PRODUCT]];
const ACCUMULATE: &[&str] = &[include_str!("shaders/accumulate.wgsl")];
/// Conversion to f16.
pub const HALF: &str = include_str!("shaders/half.wgsl");
const EIGHT: &str = include_str!("shaders/cooperative_8.wgsl");
const SIXTEEN: &str = include_str!("shaders/cooperative_16.wgsl");
const PRODUCT_HALF: &str = include_str!("shaders/multiply_cooperative.wgsl");
/// By side of the matrices, then by [`Finish`].
const MULTIPLY_COOPERATIVE: [[&[&str]; 3]; 2] = [
    [
        &[HALF, EIGHT, STORE, PRODUCT_HALF],
        &[HALF, EIGHT, RELU, PRODUCT_HALF],
        &[HALF, EIGHT, MASK, PRODUCT_HALF],
    ],
    [
        &[HALF, SIXTEEN, STORE, PRODUCT_HALF],
        &[HALF, SIXTEEN, RELU, PRODUCT_HALF],
        &[HALF, SIXTEEN, MASK, PRODUCT_HALF],
    ],
];
const ACCUMULATE_HALF: &str = include_str!("shaders/accumulate_cooperative.wgsl");
const ACCUMULATE_COOPERATIVE: [&[&str]; 2] =
    [&[HALF, EIGHT, ACCUMULATE_HALF], &[HALF, SIXTEEN, ACCUMULATE_HALF]];

/// Operation on a product before it is stored.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// None.
    Store,
    /// ReLU: values below zero become zero.
    Relu,
    /// Derivative of a ReLU: zero where the mask is not above zero.
    Mask,
    /// Added to what is there; f32 alone.
    Add,
    /// Added to what is there, then ReLU; f32 alone.
    AddRelu,
}

/// Rows per tile of a product in f32.
const TILE_ROWS: u32 = 64;

/// Columns of a tile, in units of 16, for a matrix of `n` columns.
pub fn tile(n: usize) -> u32 {
    (1..=4).rev().find(|t| n.is_multiple_of(16 * t)).unwrap_or(1) as u32
}

/// Cooperative matrices of a device, with f16 factors and f32 sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Matrices {
    /// Number of rows and columns: 8 or 16.
    pub side: u32,
    /// Minimum number of subgroups in a workgroup of [`COOPERATING`] invocations.
    pub subgroups: u32,
}

/// Workgroup size of the kernels that use cooperative matrices.
pub const COOPERATING: u32 = 128;

/// Factor that keeps small gradients within the range of f16; it leaves room for gradients up to 255.
pub const GRADIENT_SCALE: u32 = 256;

/// Floats of a block of rows in workgroup memory: 16 KiB of f16.
const BLOCK: usize = 8192;

impl Matrices {
    fn index(self) -> usize {
        usize::from(self.side == 16)
    }

    /// Number of adjacent matrices that a subgroup sums at once.
    fn across(self, n: usize) -> u32 {
        (1..=4).rev().find(|t| n.is_multiple_of((self.side * t) as usize)).unwrap_or(1)
    }

    /// Rows of a block of `k` columns. The number divides [`crate::rows::BLOCK`], to which arrays are padded, so that
    /// no block exceeds its array.
    pub fn rows(self, k: usize) -> u32 {
        match BLOCK / k {
            64.. => 64,
            32.. => 32,
            _ => 16,
        }
    }

    /// Workgroups per chunk of a weight gradient [k, n].
    pub fn tiles(self, k: usize, n: usize) -> u32 {
        (k as u32).div_ceil(self.side * self.subgroups) * (n as u32 / (self.side * self.across(n)))
    }
}

const PLAIN: &[(u32, Access)] = &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read)];
const MASKED: &[(u32, Access)] = &[(0, Read), (1, Read), (2, Parameters), (3, Write), (4, Read), (5, Read)];
const SUMMED: &[(u32, Access)] = &[(0, Read), (1, Read), (2, Parameters), (3, Write), (4, Read)];
// The same bindings, and the counter of overflows.
const PLAIN_HALF: &[(u32, Access)] =
    &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (6, Write)];
const MASKED_HALF: &[(u32, Access)] =
    &[(0, Read), (1, Read), (2, Parameters), (3, Write), (4, Read), (5, Read), (6, Write)];
const SUMMED_HALF: &[(u32, Access)] =
    &[(0, Read), (1, Read), (2, Parameters), (3, Write), (4, Read), (6, Write)];

/// The product of [rows, k] and [k, n], in f32 or with cooperative `matrices`. The latter multiply the left factor by
/// `scale` and have one more binding, the counter of overflows.
pub fn multiply(k: usize, n: usize, finish: Finish, matrices: Option<Matrices>, scale: u32) -> Kernel {
    let bindings = match (finish == Finish::Mask, matrices.is_some()) {
        (false, false) => PLAIN,
        (true, false) => MASKED,
        (false, true) => PLAIN_HALF,
        (true, true) => MASKED_HALF,
    };
    let mut constants = vec![("K", k as u32), ("N", n as u32)];
    match matrices {
        None => {
            constants.push(("TN", tile(n)));
            Kernel::new("multiply", MULTIPLY[finish as usize], bindings).with(&constants)
        }
        Some(matrices) => {
            constants.extend([("TN", matrices.across(n)), ("ROWS", matrices.rows(k)), ("SCALE", scale)]);
            let files = MULTIPLY_COOPERATIVE[matrices.index()][finish as usize];
            Kernel::new("multiply", files, bindings).cooperative().with(&constants)
        }
    }
}

/// Workgroups of the product of [rows, k] and [k, n].
pub fn multiplying(rows: &Rows, k: usize, n: usize, matrices: Option<Matrices>) -> Size<'_> {
    match matrices {
        None => rows.tiles(TILE_ROWS, n as u32 / (16 * tile(n))),
        Some(matrices) => rows.tiles(matrices.rows(k), 1),
    }
}

/// The weight gradient [k, n] in `chunks` parts, in f32 or with cooperative `matrices`. The latter leave it
/// multiplied by [`GRADIENT_SCALE`] and have one more binding, the counter of overflows.
pub fn accumulate(k: usize, n: usize, chunks: u32, matrices: Option<Matrices>) -> Kernel {
    let mut constants = vec![("K", k as u32), ("N", n as u32), ("CHUNKS", chunks)];
    match matrices {
        None => {
            constants.extend([("TK", tile(k)), ("TN", tile(n))]);
            Kernel::new("accumulate", ACCUMULATE, SUMMED).with(&constants)
        }
        Some(matrices) => {
            let (across, subgroups) = (matrices.across(n), matrices.subgroups);
            constants.extend([("TN", across), ("SUBGROUPS", subgroups), ("SCALE", GRADIENT_SCALE)]);
            let files = ACCUMULATE_COOPERATIVE[matrices.index()];
            Kernel::new("accumulate", files, SUMMED_HALF).cooperative().with(&constants)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cooperative stores write whole blocks of rows, so arrays have to end with a whole block.
    #[test]
    fn arrays_end_with_whole_blocks() {
        let matrices = Matrices { side: 16, subgroups: 4 };
        for k in (16..=512).step_by(16) {
            let rows = matrices.rows(k) as usize;
            assert!(crate::rows::BLOCK.is_multiple_of(rows) && rows.is_multiple_of(16), "{k}");
            assert!(rows * k <= BLOCK, "{k}: workgroup memory");
        }
    }

    #[test]
    fn tiles_divide_their_matrices() {
        for n in (16..=512).step_by(16) {
            assert_eq!(n % (16 * tile(n) as usize), 0, "{n}");
        }
    }
}
