//! Matrix products of the small networks over blocks of rows that stay in a core's L2. Activations are row-major with
//! rows padded to [`ROWS`]; weights are packed in column panels of 32 (the last may have 16), so that a panel streams.
//! Letters: C[m, n] = A[m, k]·W[k, n]; G[k, n] += Aᵀ·D.
//!
//! At [`Precision::Bf16`] the factors are words of two bf16 that are neighbours in the direction summed over, made by
//! [`pair_columns`] and [`pair_rows`]; sums stay in f32. The kernels are the same, over half as many words.

use crate::buffer::Buffer;
use crate::simd::{Kernel, Lanes, Simd, pair};
use trimip_core::config::Precision;

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
    precision: Precision,
    /// Words.
    data: Buffer<f32>,
}

impl Packed {
    /// Room for a matrix of zeros; `k` is even.
    pub fn zeros(k: usize, n: usize, precision: Precision) -> Self {
        assert!(n.is_multiple_of(16) && k.is_multiple_of(2), "padded widths");
        Self { k, n, precision, data: Buffer::zeros(words(k, precision) * n) }
    }

    /// Fills the matrix from `value(row, column)`.
    pub fn fill(&mut self, value: impl Fn(usize, usize) -> f32) {
        let height = words(self.k, self.precision);
        for column in 0..self.n {
            let panel = column / 32 * 32;
            let width = (self.n - panel).min(32);
            for row in 0..height {
                self.data[panel * height + row * width + column - panel] = match self.precision {
                    Precision::F32 | Precision::F16 => value(row, column),
                    Precision::Bf16 => pair(value(2 * row, column), value(2 * row + 1, column)),
                };
            }
        }
    }

    /// How the matrix is stored, and its left factor has to be.
    pub fn precision(&self) -> Precision {
        self.precision
    }
}

/// Words of `count` values that are summed over.
fn words(count: usize, precision: Precision) -> usize {
    match precision {
        Precision::F32 | Precision::F16 => count,
        Precision::Bf16 => count.div_ceil(2),
    }
}

/// Neighbours `from[2 i]`, `from[2 i + 1]` become the pair `to[i]` in bf16: rows of k values become rows of k/2 words.
pub fn pair_columns(simd: Simd, from: &[f32], to: &mut [f32]) {
    assert!(from.len() == 2 * to.len(), "whole pairs");
    simd.run(PairColumns { from, to });
}

/// Row i of `to` = the pairs of rows 2i and 2i + 1 of `from`, [rows, width], in bf16; an odd last row goes with zeros.
pub fn pair_rows(simd: Simd, rows: usize, width: usize, from: &[f32], to: &mut Buffer<f32>) {
    assert!(width.is_multiple_of(16) && from.len() >= rows * width, "padded width");
    to.resize(rows.div_ceil(2) * width);
    simd.run(PairRows { from: &from[..rows * width], to, width });
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

/// C = start + A·W for `rows` rows, padding rows included; A has the precision of W.
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
    assert!(a.len() >= rows * words(w.k, w.precision) && c.len() >= rows * w.n, "padded activations");
    if let Finish::Mask(mask) = finish {
        assert!(mask.len() >= rows * w.n, "padded mask");
    }
    if let Start::Rows { rows: start, of } = start {
        let fits = |&row: &u32| (row as usize + 1) * w.n <= start.len();
        assert!(of.len() >= rows && of[..rows].iter().all(fits), "a row for each row");
    }
    match w.precision {
        Precision::F32 | Precision::F16 => simd.run(Multiply::<false> { rows, a, w, c, start, finish }),
        Precision::Bf16 => simd.run(Multiply::<true> { rows, a, w, c, start, finish }),
    }
}

/// C[row, j] = Σ_p A[row, p]·W[j, p] for the few rows of W, [outputs, k]; C has `width` columns, zero beyond `outputs`.
pub fn dots(simd: Simd, rows: usize, k: usize, a: &[f32], w: &[f32], c: &mut [f32], width: usize) {
    assert!(k.is_multiple_of(16) && w.len().is_multiple_of(k) && w.len() / k <= width, "padded widths");
    assert!(a.len() >= rows * k && c.len() >= rows * width, "whole matrices");
    simd.run(Dots { rows, k, a, w, c, width });
}

/// G += Aᵀ·D over exactly `rows` rows of words, for A of `k` and D of `n` columns.
#[allow(clippy::too_many_arguments)]
pub fn accumulate(
    simd: Simd,
    precision: Precision,
    rows: usize,
    k: usize,
    n: usize,
    a: &[f32],
    d: &[f32],
    g: &mut [f32],
) {
    assert!(a.len() >= rows * k && d.len() >= rows * n && g.len() >= k * n, "whole matrices");
    assert!(k.is_multiple_of(4) && n.is_multiple_of(16), "padded widths");
    match precision {
        Precision::F32 | Precision::F16 => simd.run(Accumulate::<false> { rows, k, n, a, d, g }),
        Precision::Bf16 => simd.run(Accumulate::<true> { rows, k, n, a, d, g }),
    }
}

/// `a` · `b` + `sum`, of values or of words of pairs.
#[inline(always)]
fn add_product<L: Lanes, const PAIRS: bool>(a: L, b: L, sum: L) -> L {
    if PAIRS { a.dot_add(b, sum) } else { a.mul_add(b, sum) }
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
        let (k, n) = (words(self.w.k, self.w.precision), self.w.n);
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
    /// Words.
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
    unsafe fn run<L: Lanes, const PAIRS: bool, const MR: usize, const NV: usize>(&self, first: usize) {
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
                    // SAFETY: `accumulate` checked the matrices; k is a multiple of 4, n of 16.
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
    /// `MR` rows of G from `row`, `NV`·16 columns from `column`.
    ///
    /// # Safety
    /// `a` and `d` hold `count` rows of k and n, `g` the rows and columns named.
    #[inline(always)]
    unsafe fn run<L: Lanes, const PAIRS: bool, const MR: usize, const NV: usize>(
        &self,
        row: usize,
        column: usize,
    ) {
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

    const PRECISIONS: [Precision; 2] = [Precision::F32, Precision::Bf16];

    /// The values that a precision can hold.
    fn hold(values: &mut [f32], precision: Precision) {
        if precision == Precision::Bf16 {
            values.iter_mut().for_each(|x| *x = f32::from_bits(u32::from(crate::simd::bf16(*x)) << 16));
        }
    }

    #[test]
    fn products_are_the_written_sums_on_every_set() {
        for (simd, precision) in
            Simd::available().into_iter().flat_map(|set| PRECISIONS.map(|precision| (set, precision)))
        {
            for (rows, k, n) in
                [(1, 16, 16), (12, 48, 128), (37, 128, 16), (25, 32, 48), (13, 128, 128), (5, 4, 64)]
            {
                let (mut a, mut w, mask) = (matrix(rows, k, 0.0), matrix(k, n, 1.0), matrix(rows, n, 2.0));
                let mut packed = Packed::zeros(k, n, precision);
                packed.fill(|row, column| w[row * n + column]);
                let mut left = Buffer::zeros(a.len() / 2);
                match precision {
                    Precision::F32 | Precision::F16 => left = matrix(rows, k, 0.0),
                    Precision::Bf16 => pair_columns(simd, &a, &mut left),
                }
                hold(&mut a, precision);
                hold(&mut w, precision);
                let mut c = Buffer::zeros(padded(rows) * n);
                let of: Vec<u32> = (0..padded(rows) as u32).map(|row| row % 3).collect();
                let shared = matrix(3, n, 7.0);
                let starts = [Start::Zero, Start::Rows { rows: &shared, of: &of }];
                let finishes = [Finish::Store, Finish::Relu, Finish::Mask(&mask)];
                for (start, finish) in starts.iter().flat_map(|s| finishes.iter().map(move |f| (*s, *f))) {
                    multiply(simd, rows, &left, &packed, &mut c, start, finish);
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
        for (simd, precision) in
            Simd::available().into_iter().flat_map(|set| PRECISIONS.map(|precision| (set, precision)))
        {
            for (rows, k, n) in
                [(1, 16, 16), (130, 48, 128), (64, 128, 16), (65, 32, 48), (70, 4, 48), (9, 12, 16)]
            {
                if precision == Precision::Bf16 && k % 16 != 0 {
                    continue;
                }
                let (mut a, mut d, g) = (matrix(rows, k, 3.0), matrix(rows, n, 4.0), matrix(k, n, 5.0));
                a[rows * k..].fill(f32::NAN);
                let mut out = matrix(k, n, 5.0);
                match precision {
                    Precision::F32 | Precision::F16 => {
                        accumulate(simd, precision, rows, k, n, &a, &d, &mut out)
                    }
                    Precision::Bf16 => {
                        let (mut left, mut right) = (Buffer::default(), Buffer::default());
                        pair_rows(simd, rows, k, &a, &mut left);
                        pair_rows(simd, rows, n, &d, &mut right);
                        accumulate(simd, precision, rows.div_ceil(2), k, n, &left, &right, &mut out);
                    }
                }
                hold(&mut a[..rows * k], precision);
                hold(&mut d, precision);
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
