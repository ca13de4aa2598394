//! Matrix products of the small networks, over blocks of rows that stay in a core's L2. Activations are row-major
//! with rows padded to [`ROWS`]. Weights are packed in column panels of 32 (the last may have 16), so that a panel is
//! read sequentially. Notation: C[m, n] = A[m, k]·W[k, n]; G[k, n] += Aᵀ·D.
//!
//! At [`Precision::Bf16`](trimip_core::config::Precision::Bf16) the factors are words of two bf16 values that are neighbours along the summed dimension,
//! packed by [`pair_columns`] and [`pair_rows`]. Sums stay in f32. The kernels are the same, over half as many words.

mod accumulate;
mod dots;
mod multiply;
mod packed;
mod pairs;
#[cfg(test)]
mod tests;
mod words;

pub use accumulate::{Product, accumulate};
pub use dots::dots;
pub use multiply::{Epilogue, Finish, Start, multiply};
pub use packed::Packed;
pub use pairs::{pair_columns, pair_rows};
pub use words::{ROWS, padded};
