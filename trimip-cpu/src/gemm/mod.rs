//! Matrix products of the small networks, over blocks of rows that stay in a core's L2. Activations are row-major
//! with rows padded to [`ROWS`]. Weights are packed in column panels of 32 (the last may have 16), so that a panel is
//! read sequentially. Notation: C[m, n] = A[m, k]·W[k, n]; G[k, n] += Aᵀ·D.
//!
//! At [`Precision::Bf16`] the factors are words of two bf16 values that are neighbours along the summed dimension,
//! packed by [`pair_columns`] and [`pair_rows`]. Sums stay in f32. The kernels are the same, over half as many words.

mod accumulate;
mod dots;
mod multiply;
mod packed;
mod pairs;
#[cfg(test)]
mod tests;
#[cfg(target_arch = "x86_64")]
mod tiles;

pub use accumulate::{Product, accumulate};
pub use dots::dots;
pub use multiply::{Epilogue, Finish, Start, multiply};
pub use packed::Packed;
pub use pairs::{pair_columns, pair_rows};

use crate::simd::Lanes;
use trimip_core::config::Precision;

/// Rows of a register tile. Activation buffers hold a multiple of it.
pub const ROWS: usize = 12;

/// Rows rounded up to whole tiles.
pub fn padded(rows: usize) -> usize {
    rows.next_multiple_of(ROWS)
}

/// Number of words for `count` values along the summed dimension.
fn words(count: usize, precision: Precision) -> usize {
    match precision {
        Precision::F32 | Precision::F16 => count,
        Precision::Bf16 => count.div_ceil(2),
    }
}

/// `a` · `b` + `sum`, for values or for words of pairs.
#[inline(always)]
fn add_product<L: Lanes, const PAIRS: bool>(a: L, b: L, sum: L) -> L {
    if PAIRS { a.dot_add(b, sum) } else { a.mul_add(b, sum) }
}
