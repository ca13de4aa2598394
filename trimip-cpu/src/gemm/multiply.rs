//! C = A·W with an initial value and a last operation: a layer's forward pass, and the gradient of its input.

use super::operands::{Epilogue, Finish, Start};
use super::packed::Packed;
#[cfg(target_arch = "x86_64")]
use super::tiles;
use super::words::{ROWS, add_product, padded};
use crate::simd::{Kernel, Lanes, Simd};
use trimip_core::config::Precision;

/// Computes C = finish(start + A·W) for `rows` rows and their padding. A has the precision of W.
pub fn multiply(simd: Simd, rows: usize, a: &[f32], w: &Packed, c: &mut [f32], epilogue: Epilogue<'_>) {
    let (rows, Epilogue { start, finish }) = (padded(rows), epilogue);
    assert!(a.len() >= rows * w.words() && c.len() >= rows * w.n(), "padded activations");
    if let Finish::Mask(mask) = finish {
        assert!(mask.len() >= rows * w.n(), "padded mask");
    }
    if let Start::Rows { rows: start, of } = start {
        let fits = |&row: &u32| (row as usize + 1) * w.n() <= start.len();
        assert!(of.len() >= rows && of[..rows].iter().all(fits), "a row for each row");
    }
    match w.precision() {
        Precision::F32 | Precision::F16 => simd.run(Multiply::<false> { rows, a, w, c, start, finish }),
        #[cfg(target_arch = "x86_64")]
        Precision::Bf16 if simd.has_tiles() => simd.run(tiles::Multiply { rows, a, w, c, start, finish }),
        Precision::Bf16 => simd.run(Multiply::<true> { rows, a, w, c, start, finish }),
    }
}

struct Multiply<'a, const PAIRS: bool> {
    rows: usize,
    a: &'a [f32],
    w: &'a Packed,
    c: &'a mut [f32],
    start: Start<'a>,
    finish: Finish<'a>,
}

impl<const PAIRS: bool> Kernel for Multiply<'_, PAIRS> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let (k, n) = (self.w.words(), self.w.n());
        for panel in (0..n).step_by(32) {
            let w = self.w.panel(panel).as_ptr();
            let wide = n - panel >= 32;
            let step = if L::WIDE { ROWS } else { 6 };
            for row in (0..self.rows).step_by(step) {
                let tile = MultiplyTile {
                    k,
                    a: self.a[row * k..].as_ptr(),
                    w,
                    width: if wide { 32 } else { 16 },
                    c: self.c[row * n + panel..].as_mut_ptr(),
                    n,
                    mask: match self.finish {
                        Finish::Mask(mask) => mask[row * n + panel..].as_ptr(),
                        _ => std::ptr::null(),
                    },
                    relu: matches!(self.finish, Finish::Relu),
                    start: match self.start {
                        Start::Zero => None,
                        Start::Rows { rows, of } => Some((rows[panel..].as_ptr(), of[row..].as_ptr())),
                    },
                };
                // SAFETY: `multiply` checked that all matrices hold `rows` rows, a multiple of 12 and of 6.
                unsafe {
                    match (L::WIDE, wide) {
                        (true, true) => tile.run::<L, PAIRS, 12, 2>(0),
                        (true, false) => tile.run::<L, PAIRS, 12, 1>(0),
                        (false, true) => {
                            tile.run::<L, PAIRS, 6, 1>(0);
                            tile.run::<L, PAIRS, 6, 1>(16);
                        }
                        (false, false) => tile.run::<L, PAIRS, 6, 1>(0),
                    }
                }
            }
        }
    }
}

struct MultiplyTile {
    /// Number of words along the summed dimension.
    k: usize,
    a: *const f32,
    w: *const f32,
    width: usize,
    c: *mut f32,
    n: usize,
    mask: *const f32,
    relu: bool,
    /// Initial values: rows of n values, and for each row of C the index of its initial values.
    start: Option<(*const f32, *const u32)>,
}

impl MultiplyTile {
    /// Computes `MR` rows and `NV`·16 columns, beginning with column `first` of the panel.
    ///
    /// # Safety
    /// `a` holds MR rows of k words, `w` holds k rows of `width` words, and `c` (and `mask` unless null) holds MR rows
    /// of n values; `start` has MR indices.
    #[inline(always)]
    unsafe fn run<L: Lanes, const PAIRS: bool, const MR: usize, const NV: usize>(&self, first: usize) {
        let mut sums = [[L::splat(0.0); NV]; MR];
        // SAFETY: the caller guarantees that every index is in bounds.
        unsafe {
            if let Some((rows, of)) = self.start {
                for (i, sums) in sums.iter_mut().enumerate() {
                    let row = rows.add(*of.add(i) as usize * self.n + first);
                    for (j, sum) in sums.iter_mut().enumerate() {
                        *sum = L::load(row.add(16 * j));
                    }
                }
            }
            for p in 0..self.k {
                let mut w = [L::splat(0.0); NV];
                for (j, w) in w.iter_mut().enumerate() {
                    *w = L::load(self.w.add(p * self.width + first + 16 * j));
                }
                for (i, sums) in sums.iter_mut().enumerate() {
                    let a = L::splat(*self.a.add(i * self.k + p));
                    for j in 0..NV {
                        sums[j] = add_product::<L, PAIRS>(a, w[j], sums[j]);
                    }
                }
            }
            for (i, sums) in sums.into_iter().enumerate() {
                for (j, mut sum) in sums.into_iter().enumerate() {
                    let place = i * self.n + first + 16 * j;
                    if self.relu {
                        sum = sum.relu();
                    } else if !self.mask.is_null() {
                        sum = sum.where_positive(L::load(self.mask.add(place)));
                    }
                    sum.store(self.c.add(place));
                }
            }
        }
    }
}
