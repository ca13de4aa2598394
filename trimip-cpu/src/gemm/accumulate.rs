//! G += Aᵀ·D: a layer's weight gradient.

use super::operands::Product;
#[cfg(target_arch = "x86_64")]
use super::tiles;
use super::words::add_product;
use crate::simd::{Kernel, Lanes};
use trimip_core::config::Precision;

/// Number of rows per pass of a weight gradient: few enough that the panels of A and D stay in L1.
const GRADIENT_ROWS: usize = 64;

/// Computes G += Aᵀ·D over exactly `product.rows` rows of words.
pub fn accumulate(product: Product, a: &[f32], d: &[f32], g: &mut [f32]) {
    let Product { simd, precision, rows, k, n } = product;
    assert!(a.len() >= rows * k && d.len() >= rows * n && g.len() >= k * n, "whole matrices");
    assert!(k.is_multiple_of(4) && n.is_multiple_of(16), "padded widths");
    match precision {
        Precision::F32 | Precision::F16 => simd.run(Accumulate::<false> { rows, k, n, a, d, g }),
        #[cfg(target_arch = "x86_64")]
        Precision::Bf16 if simd.has_tiles() && k.is_multiple_of(16) => {
            simd.run(tiles::Accumulate { product, a, d, g });
        }
        Precision::Bf16 => simd.run(Accumulate::<true> { rows, k, n, a, d, g }),
    }
}

struct Accumulate<'a, const PAIRS: bool> {
    rows: usize,
    k: usize,
    n: usize,
    a: &'a [f32],
    d: &'a [f32],
    g: &'a mut [f32],
}

impl<const PAIRS: bool> Kernel for Accumulate<'_, PAIRS> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { rows, k, n, a, d, g } = self;
        for first in (0..rows).step_by(GRADIENT_ROWS) {
            let count = (rows - first).min(GRADIENT_ROWS);
            for column in (0..n).step_by(32) {
                let wide = n - column >= 32;
                for row in (0..k).step_by(8) {
                    let narrow = k - row < 8;
                    let tile = AccumulateTile {
                        count,
                        k,
                        n,
                        a: a[first * k + row..].as_ptr(),
                        d: d[first * n + column..].as_ptr(),
                        g: g[row * n + column..].as_mut_ptr(),
                    };
                    // SAFETY: `accumulate` checked the matrices; k is a multiple of 4 and n of 16.
                    unsafe {
                        match (L::WIDE, wide, narrow) {
                            (true, true, false) => tile.run::<L, PAIRS, 8, 2>(0, 0),
                            (true, false, false) => tile.run::<L, PAIRS, 8, 1>(0, 0),
                            (true, true, true) => tile.run::<L, PAIRS, 4, 2>(0, 0),
                            (true, false, true) => tile.run::<L, PAIRS, 4, 1>(0, 0),
                            (false, wide, narrow) => {
                                for half in (0..if narrow { 4 } else { 8 }).step_by(4) {
                                    tile.run::<L, PAIRS, 4, 1>(half, 0);
                                    if wide {
                                        tile.run::<L, PAIRS, 4, 1>(half, 16);
                                    }
                                }
                            }
                        }
                    }
                }
            }
        }
    }
}

struct AccumulateTile {
    count: usize,
    k: usize,
    n: usize,
    a: *const f32,
    d: *const f32,
    g: *mut f32,
}

impl AccumulateTile {
    /// Adds to a block of G: `MR` rows, beginning with `row`, and `NV`·16 columns, beginning with `column`.
    ///
    /// # Safety
    /// `a` and `d` hold `count` rows of k and n values; `g` holds these rows and columns.
    #[inline(always)]
    unsafe fn run<L: Lanes, const PAIRS: bool, const MR: usize, const NV: usize>(
        &self,
        row: usize,
        column: usize,
    ) {
        let mut sums = [[L::splat(0.0); NV]; MR];
        // SAFETY: the caller guarantees that every index is in bounds.
        unsafe {
            for p in 0..self.count {
                let mut d = [L::splat(0.0); NV];
                for (j, d) in d.iter_mut().enumerate() {
                    *d = L::load(self.d.add(p * self.n + column + 16 * j));
                }
                for (i, sums) in sums.iter_mut().enumerate() {
                    let a = L::splat(*self.a.add(p * self.k + row + i));
                    for j in 0..NV {
                        sums[j] = add_product::<L, PAIRS>(a, d[j], sums[j]);
                    }
                }
            }
            for (i, sums) in sums.into_iter().enumerate() {
                for (j, sum) in sums.into_iter().enumerate() {
                    let place = self.g.add((row + i) * self.n + column + 16 * j);
                    L::load(place).add(sum).store(place);
                }
            }
        }
    }
}
