//! Numbers of rows and words of a product's factors, and the multiply-add of two words.

use crate::simd::Lanes;
use trimip_core::config::Precision;

/// Number of rows of a register tile. The number of rows of an activation buffer is a multiple of it.
pub const ROWS: usize = 12;

/// Returns `rows`, rounded up to whole tiles.
pub fn padded(rows: usize) -> usize {
    rows.next_multiple_of(ROWS)
}

/// Returns the number of words for `count` values along the summed dimension.
pub(super) fn words(count: usize, precision: Precision) -> usize {
    match precision {
        Precision::F32 | Precision::F16 => count,
        Precision::Bf16 => count.div_ceil(2),
    }
}

/// Returns `a` · `b` + `sum`, for f32 values or for words of bf16 pairs.
#[inline(always)]
pub(super) fn add_product<L: Lanes, const PAIRS: bool>(a: L, b: L, sum: L) -> L {
    if PAIRS { a.dot_add(b, sum) } else { a.mul_add(b, sum) }
}
