//! Rows and words of the factors of a product, and the product of two of them.

use crate::simd::Lanes;
use trimip_core::config::Precision;

/// Rows of a register tile. Activation buffers hold a multiple of this many rows.
pub const ROWS: usize = 12;

/// Rows rounded up to whole tiles.
pub fn padded(rows: usize) -> usize {
    rows.next_multiple_of(ROWS)
}

/// Number of words for `count` values along the summed dimension.
pub(super) fn words(count: usize, precision: Precision) -> usize {
    match precision {
        Precision::F32 | Precision::F16 => count,
        Precision::Bf16 => count.div_ceil(2),
    }
}

/// `a` · `b` + `sum`, for values or for words of pairs.
#[inline(always)]
pub(super) fn add_product<L: Lanes, const PAIRS: bool>(a: L, b: L, sum: L) -> L {
    if PAIRS { a.dot_add(b, sum) } else { a.mul_add(b, sum) }
}
