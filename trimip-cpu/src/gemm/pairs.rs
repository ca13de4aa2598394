//! Packs the factors of a product into words of two bf16.

use crate::buffer::Buffer;
use crate::simd::{Kernel, Lanes, Simd, pair};

/// Packs neighbours `from[2 i]`, `from[2 i + 1]` into the bf16 pair `to[i]`: rows of k values become rows of k/2
/// words.
pub fn pair_columns(simd: Simd, from: &[f32], to: &mut [f32]) {
    assert!(from.len() == 2 * to.len(), "whole pairs");
    simd.run(PairColumns { from, to });
}

/// Packs rows 2i and 2i + 1 of `from`, [rows, width], into row i of `to`, as bf16 pairs. An odd last row is paired
/// with zeros.
pub fn pair_rows(simd: Simd, rows: usize, width: usize, from: &[f32], to: &mut Buffer<f32>) {
    assert!(width.is_multiple_of(16) && from.len() >= rows * width, "padded width");
    to.resize(rows.div_ceil(2) * width);
    simd.run(PairRows { from: &from[..rows * width], to, width });
}

struct PairColumns<'a> {
    from: &'a [f32],
    to: &'a mut [f32],
}

impl Kernel for PairColumns<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let whole = self.to.len() / 16 * 16;
        for word in (0..whole).step_by(16) {
            // SAFETY: `pair_columns` checked that there are two values for each word.
            unsafe {
                let values = self.from.as_ptr().add(2 * word);
                let pairs = L::load(values).pair_neighbours(L::load(values.add(16)));
                pairs.store(self.to.as_mut_ptr().add(word));
            }
        }
        for word in whole..self.to.len() {
            self.to[word] = pair(self.from[2 * word], self.from[2 * word + 1]);
        }
    }
}

struct PairRows<'a> {
    from: &'a [f32],
    to: &'a mut [f32],
    width: usize,
}

impl Kernel for PairRows<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let width = self.width;
        for (two, words) in self.from.chunks(2 * width).zip(self.to.chunks_exact_mut(width)) {
            for column in (0..width).step_by(16) {
                // SAFETY: a chunk holds one or two rows of `width` values, a multiple of 16.
                unsafe {
                    let first = L::load(two.as_ptr().add(column));
                    let second = match two.len() > width {
                        true => L::load(two.as_ptr().add(width + column)),
                        false => L::splat(0.0),
                    };
                    first.pair(second).store(words.as_mut_ptr().add(column));
                }
            }
        }
    }
}
