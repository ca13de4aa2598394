//! Matrix products of the small networks, over blocks of rows that stay in a core's L2. Activations are row-major, and their number of rows
//! is padded to a multiple of [`ROWS`]. Weights are packed in column panels of 32 (the last may have 16), so that a panel is read
//! sequentially. Notation: C[m, n] = A[m, k]·W[k, n]; G[k, n] += Aᵀ·D.
//!
//! At [`Precision::Bf16`](trimip_core::config::Precision::Bf16) the factors consist of words of two bf16 values that are neighbours along
//! the summed dimension; [`pair_columns`] and [`pair_rows`] pack them. Sums stay in f32. The kernels are those of f32, and process half as
//! many words.

mod accumulate;
mod dots;
mod multiply;
mod operands;
mod packed;
mod pairs;
#[cfg(test)]
mod tests;
#[cfg(target_arch = "x86_64")]
mod tiles;
mod words;

pub use accumulate::accumulate;
pub use dots::dots;
pub use multiply::multiply;
pub use operands::{Epilogue, Finish, Product, Start};
pub use packed::Packed;
pub use pairs::{pair_columns, pair_rows};
pub use words::{ROWS, padded};
