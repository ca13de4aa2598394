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
        let (from, last) = self.from.as_chunks::<32>();
        let (to, last_words) = self.to.as_chunks_mut::<16>();
        for (values, words) in from.iter().zip(to) {
            let halves = values.as_chunks().0;
            L::of(&halves[0]).pair_neighbours(L::of(&halves[1])).put(words);
        }
        for (word, two) in last_words.iter_mut().zip(last.as_chunks::<2>().0) {
            *word = pair(two[0], two[1]);
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
            let (first, second) = two.split_at(width);
            let (first, second) = (first.as_chunks().0, second.as_chunks().0);
            for (column, words) in words.as_chunks_mut().0.iter_mut().enumerate() {
                let second = match second.get(column) {
                    Some(second) => L::of(second),
                    None => L::splat(0.0),
                };
                L::of(&first[column]).pair(second).put(words);
            }
        }
    }
}
