//! Matrix products of the small networks over blocks of rows that stay in a core's L2. Activations are row-major with
//! rows padded to [`ROWS`]; weights are packed in column panels of 32 (the last may have 16), so that a panel streams.
//! Letters: C[m, n] = A[m, k]·W[k, n]; G[k, n] += Aᵀ·D.

use crate::buffer::Buffer;
use crate::simd::{Kernel, Lanes, Simd};

/// Rows of a register tile; activation buffers hold a multiple of it.
pub const ROWS: usize = 12;

/// Rows of one pass of a weight gradient: what leaves its two panels in L1.
const GRADIENT_ROWS: usize = 64;

/// Rows rounded up to whole tiles.
pub fn padded(rows: usize) -> usize {
    rows.next_multiple_of(ROWS)
}

/// A weight matrix [k, n] in panels; n is a multiple of 16.
pub struct Packed {
    /// Rows.
    pub k: usize,
    /// Columns.
    pub n: usize,
    data: Buffer<f32>,
}

impl Packed {
    /// Room for a matrix of zeros.
    pub fn zeros(k: usize, n: usize) -> Self {
        assert!(n.is_multiple_of(16), "padded width");
        Self { k, n, data: Buffer::zeros(k * n) }
    }

    /// Fills the matrix from `value(row, column)`.
    pub fn fill(&mut self, value: impl Fn(usize, usize) -> f32) {
        for column in 0..self.n {
            let panel = column / 32 * 32;
            let width = (self.n - panel).min(32);
            for row in 0..self.k {
                self.data[panel * self.k + row * width + column - panel] = value(row, column);
            }
        }
    }
}

/// What a product is added to.
#[derive(Clone, Copy)]
pub enum Start<'a> {
    /// Nothing.
    Zero,
    /// To row i of the product, row `of[i]` of `rows`, which is as wide.
    Rows {
        /// The rows.
        rows: &'a [f32],
        /// One index for each row of the product, padding rows included.
        of: &'a [u32],
    },
}

/// What becomes of a product before it is stored.
#[derive(Clone, Copy)]
pub enum Finish<'a> {
    /// Nothing.
    Store,
    /// Values below zero become zero.
    Relu,
    /// Zero where this matrix of the same shape is not above zero: the derivative of a ReLU.
    Mask(&'a [f32]),
}

/// C = start + A·W for `rows` rows, padding rows included.
pub fn multiply(
    simd: Simd,
    rows: usize,
    a: &[f32],
    w: &Packed,
    c: &mut [f32],
    start: Start<'_>,
    finish: Finish<'_>,
) {
    let rows = padded(rows);
    assert!(a.len() >= rows * w.k && c.len() >= rows * w.n, "padded activations");
    if let Finish::Mask(mask) = finish {
        assert!(mask.len() >= rows * w.n, "padded mask");
    }
    if let Start::Rows { rows: start, of } = start {
        let fits = |&row: &u32| (row as usize + 1) * w.n <= start.len();
        assert!(of.len() >= rows && of[..rows].iter().all(fits), "a row for each row");
    }
    simd.run(Multiply { rows, a, w, c, start, finish });
}

/// C[row, j] = Σ_p A[row, p]·W[j, p] for the few rows of W, [outputs, k]; C has `width` columns, zero beyond `outputs`.
pub fn dots(simd: Simd, rows: usize, k: usize, a: &[f32], w: &[f32], c: &mut [f32], width: usize) {
    assert!(k.is_multiple_of(16) && w.len().is_multiple_of(k) && w.len() / k <= width, "padded widths");
    assert!(a.len() >= rows * k && c.len() >= rows * width, "whole matrices");
    simd.run(Dots { rows, k, a, w, c, width });
}

/// G += Aᵀ·D over exactly `rows` rows, for A of `k` and D of `n` columns.
pub fn accumulate(simd: Simd, rows: usize, k: usize, n: usize, a: &[f32], d: &[f32], g: &mut [f32]) {
    assert!(a.len() >= rows * k && d.len() >= rows * n && g.len() >= k * n, "whole matrices");
    assert!(k.is_multiple_of(4) && n.is_multiple_of(16), "padded widths");
    simd.run(Accumulate { rows, k, n, a, d, g });
}

struct Multiply<'a> {
    rows: usize,
    a: &'a [f32],
    w: &'a Packed,
    c: &'a mut [f32],
    start: Start<'a>,
    finish: Finish<'a>,
}

impl Kernel for Multiply<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let (k, n) = (self.w.k, self.w.n);
        for panel in (0..n).step_by(32) {
            let w = self.w.data[panel * k..].as_ptr();
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
                        (true, true) => tile.run::<L, 12, 2>(0),
                        (true, false) => tile.run::<L, 12, 1>(0),
                        (false, true) => {
                            tile.run::<L, 6, 1>(0);
                            tile.run::<L, 6, 1>(16);
                        }
                        (false, false) => tile.run::<L, 6, 1>(0),
                    }
                }
            }
        }
    }
}

struct MultiplyTile {
    k: usize,
    a: *const f32,
    w: *const f32,
    width: usize,
    c: *mut f32,
    n: usize,
    mask: *const f32,
    relu: bool,
    /// Rows of n that are added, and which.
    start: Option<(*const f32, *const u32)>,
}

impl MultiplyTile {
    /// `MR` rows times `NV`·16 columns from column `first` of the panel.
    ///
    /// # Safety
    /// `a` holds MR rows of k, `w` k rows of `width`, `c` (and `mask` unless null) MR rows of n; `start` names MR rows.
    #[inline(always)]
    unsafe fn run<L: Lanes, const MR: usize, const NV: usize>(&self, first: usize) {
        let mut sums = [[L::splat(0.0); NV]; MR];
        // SAFETY: the caller's promise bounds every index.
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
                        sums[j] = a.mul_add(w[j], sums[j]);
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
                for p in (0..k).step_by(16) {
                    // SAFETY: both slices hold k values, a multiple of 16.
                    unsafe { sum = L::load(a.as_ptr().add(p)).mul_add(L::load(w.as_ptr().add(p)), sum) };
                }
                *c = sum.sum();
            }
        }
    }
}

struct Accumulate<'a> {
    rows: usize,
    k: usize,
    n: usize,
    a: &'a [f32],
    d: &'a [f32],
    g: &'a mut [f32],
}

impl Kernel for Accumulate<'_> {
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
                    // SAFETY: `accumulate` checked the matrices; k is a multiple of 4, n of 16.
                    unsafe {
                        match (L::WIDE, wide, narrow) {
                            (true, true, false) => tile.run::<L, 8, 2>(0, 0),
                            (true, false, false) => tile.run::<L, 8, 1>(0, 0),
                            (true, true, true) => tile.run::<L, 4, 2>(0, 0),
                            (true, false, true) => tile.run::<L, 4, 1>(0, 0),
                            (false, wide, narrow) => {
                                for half in (0..if narrow { 4 } else { 8 }).step_by(4) {
                                    tile.run::<L, 4, 1>(half, 0);
                                    if wide {
                                        tile.run::<L, 4, 1>(half, 16);
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
    /// `MR` rows of G from `row`, `NV`·16 columns from `column`.
    ///
    /// # Safety
    /// `a` and `d` hold `count` rows of k and n, `g` the rows and columns named.
    #[inline(always)]
    unsafe fn run<L: Lanes, const MR: usize, const NV: usize>(&self, row: usize, column: usize) {
        let mut sums = [[L::splat(0.0); NV]; MR];
        // SAFETY: the caller's promise bounds every index.
        unsafe {
            for p in 0..self.count {
                let mut d = [L::splat(0.0); NV];
                for (j, d) in d.iter_mut().enumerate() {
                    *d = L::load(self.d.add(p * self.n + column + 16 * j));
                }
                for (i, sums) in sums.iter_mut().enumerate() {
                    let a = L::splat(*self.a.add(p * self.k + row + i));
                    for j in 0..NV {
                        sums[j] = a.mul_add(d[j], sums[j]);
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

#[cfg(test)]
mod tests {
    use super::*;

    fn matrix(rows: usize, columns: usize, seed: f32) -> Buffer<f32> {
        let mut values = Buffer::zeros(padded(rows) * columns);
        for (i, value) in values.iter_mut().enumerate() {
            *value = ((i as f32 * 0.37 + seed).sin() * 43.7).fract();
        }
        values
    }

    fn close(found: f32, expected: f64, terms: usize) {
        // A sum of `terms` products of size up to 1: each partial sum rounds to half an ulp of at most |expected| + terms.
        let tolerance = 6e-8 * (expected.abs() + (terms as f64).sqrt()) * (terms as f64).sqrt() + 1e-7;
        assert!((f64::from(found) - expected).abs() < tolerance, "{found} {expected}");
    }

    #[test]
    fn products_are_the_written_sums_on_every_set() {
        for simd in Simd::available() {
            for (rows, k, n) in
                [(1, 16, 16), (12, 48, 128), (37, 128, 16), (25, 32, 48), (13, 128, 128), (5, 4, 64)]
            {
                let (a, w, mask) = (matrix(rows, k, 0.0), matrix(k, n, 1.0), matrix(rows, n, 2.0));
                let mut packed = Packed::zeros(k, n);
                packed.fill(|row, column| w[row * n + column]);
                let mut c = Buffer::zeros(padded(rows) * n);
                let of: Vec<u32> = (0..padded(rows) as u32).map(|row| row % 3).collect();
                let shared = matrix(3, n, 7.0);
                let starts = [Start::Zero, Start::Rows { rows: &shared, of: &of }];
                let finishes = [Finish::Store, Finish::Relu, Finish::Mask(&mask)];
                for (start, finish) in starts.iter().flat_map(|s| finishes.iter().map(move |f| (*s, *f))) {
                    multiply(simd, rows, &a, &packed, &mut c, start, finish);
                    for (i, &found) in c[..rows * n].iter().enumerate() {
                        let (row, column) = (i / n, i % n);
                        let product: f64 =
                            (0..k).map(|p| f64::from(a[row * k + p]) * f64::from(w[p * n + column])).sum();
                        let sum = match start {
                            Start::Zero => product,
                            Start::Rows { rows, of } => {
                                product + f64::from(rows[of[row] as usize * n + column])
                            }
                        };
                        let expected = match finish {
                            Finish::Store => sum,
                            Finish::Relu => sum.max(0.0),
                            Finish::Mask(mask) => sum * f64::from(u8::from(mask[i] > 0.0)),
                        };
                        close(found, expected, k);
                    }
                }
            }
        }
    }

    #[test]
    fn few_outputs_are_the_written_dot_products() {
        for simd in Simd::available() {
            for (rows, k, outputs) in [(1, 16, 1), (37, 128, 3), (5, 48, 4)] {
                let (a, w) = (matrix(rows, k, 0.0), matrix(outputs, k, 1.0));
                let w = &w[..outputs * k];
                let mut c = vec![7.0; rows * 4];
                dots(simd, rows, k, &a, w, &mut c, 4);
                for (i, &found) in c.iter().enumerate() {
                    let (row, output) = (i / 4, i % 4);
                    let product = |p| f64::from(a[row * k + p]) * f64::from(w[output * k + p]);
                    close(found, if output < outputs { (0..k).map(product).sum() } else { 0.0 }, k);
                }
            }
        }
    }

    #[test]
    fn gradients_add_the_written_sums_and_leave_padding_out() {
        for simd in Simd::available() {
            for (rows, k, n) in
                [(1, 16, 16), (130, 48, 128), (64, 128, 16), (65, 32, 48), (70, 4, 48), (9, 12, 16)]
            {
                let (mut a, d, g) = (matrix(rows, k, 3.0), matrix(rows, n, 4.0), matrix(k, n, 5.0));
                a[rows * k..].fill(f32::NAN);
                let mut out = matrix(k, n, 5.0);
                accumulate(simd, rows, k, n, &a, &d, &mut out);
                for row in 0..k {
                    for column in 0..n {
                        let sum: f64 =
                            (0..rows).map(|r| f64::from(a[r * k + row]) * f64::from(d[r * n + column])).sum();
                        close(out[row * n + column], f64::from(g[row * n + column]) + sum, rows);
                    }
                }
            }
        }
    }
}
