//! Matrix products with few columns, computed as dot products.

use crate::simd::{Kernel, Lanes, Simd};

/// Computes C[row, j] = Σ_p A[row, p]·W[j, p] for `rows` rows of k values and the few rows of W, [outputs, k]. C has `width`
/// columns; columns beyond `outputs` become zero.
pub fn dots(simd: Simd, rows: usize, [k, width]: [usize; 2], a: &[f32], w: &[f32], c: &mut [f32]) {
    assert!(k.is_multiple_of(16) && w.len().is_multiple_of(k) && w.len() / k <= width, "padded widths");
    assert!(a.len() >= rows * k && c.len() >= rows * width, "whole matrices");
    simd.run(Dots { rows, k, a, w, c, width });
}

struct Dots<'a> {
    rows: usize,
    k: usize,
    a: &'a [f32],
    w: &'a [f32],
    c: &'a mut [f32],
    width: usize,
}

impl Kernel for Dots<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { rows, k, a, w, c, width } = self;
        for (a, c) in a.chunks_exact(k).zip(c.chunks_exact_mut(width)).take(rows) {
            c.fill(0.0);
            for (c, w) in c.iter_mut().zip(w.chunks_exact(k)) {
                let mut sum = L::splat(0.0);
                for (a, w) in a.as_chunks().0.iter().zip(w.as_chunks().0) {
                    sum = L::of(a).mul_add(L::of(w), sum);
                }
                *c = sum.sum();
            }
        }
    }
}
