//! Products of bf16 pairs in the tile registers of AMX: [`multiply`](super::multiply) and
//! [`accumulate`](super::accumulate) on processors that have them. Tiles 0 to 3 hold sums, for neighbouring columns;
//! the other tiles hold factors.

use super::operands::{Finish, Product, Start};
use super::packed::Packed;
use super::words::ROWS;
use crate::simd::amx::{Shapes, release, tile, transpose};
use crate::simd::{Kernel, Lanes};

/// Width of a tile in words or columns, and its maximum number of rows.
const SIDE: usize = 16;

/// Number of tiles of C that are computed at a time.
const SUMS: usize = 4;

/// Bytes of an f32 or a word.
const WORD: usize = 4;

/// Adds the products of tile `$a` and the `$n` tiles at `$b(j)`, with rows `$stride(j)` bytes apart, to the sums 0 to `$n` - 1.
/// Each tile at `$b(j)` is loaded into tile `$at`.
macro_rules! add_products {
    ($n:ident, $a:literal, $at:literal, $b:expr, $stride:expr) => {
        tile!(load $at, $b(0), $stride(0));
        tile!(add 0, $a, $at);
        if $n > 1 {
            tile!(load $at, $b(1), $stride(1));
            tile!(add 1, $a, $at);
        }
        if $n > 2 {
            tile!(load $at, $b(2), $stride(2));
            tile!(add 2, $a, $at);
        }
        if $n > 3 {
            tile!(load $at, $b(3), $stride(3));
            tile!(add 3, $a, $at);
        }
    };
}

/// Stores the sums 0 to `N` - 1 next to each other.
macro_rules! store_sums {
    ($n:ident, $to:expr, $stride:expr) => {
        tile!(store 0, $to, $stride);
        if $n > 1 {
            tile!(store 1, $to.add(SIDE), $stride);
        }
        if $n > 2 {
            tile!(store 2, $to.add(2 * SIDE), $stride);
        }
        if $n > 3 {
            tile!(store 3, $to.add(3 * SIDE), $stride);
        }
    };
}

/// C = finish(start + A·W); see [`multiply`](super::multiply), which checks the shapes.
pub(super) struct Multiply<'a> {
    pub(super) rows: usize,
    pub(super) a: &'a [f32],
    pub(super) w: &'a Packed,
    pub(super) c: &'a mut [f32],
    pub(super) start: Start<'a>,
    pub(super) finish: Finish<'a>,
}

impl Kernel for Multiply<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(mut self) {
        let k = self.w.words();
        let rest = match k % SIDE {
            0 => SIDE,
            rest => rest,
        };
        let (sum, factor) = ([ROWS, SIDE], [SIDE, SIDE]);
        let shapes = Shapes::new([sum, sum, sum, sum, [ROWS, SIDE], [ROWS, rest], factor, [rest, SIDE]]);
        // SAFETY: `multiply` checked that AMX is available and that all matrices hold `rows` rows, a multiple of 12.
        unsafe {
            shapes.load();
            for row in (0..self.rows).step_by(ROWS) {
                for column in (0..self.w.n()).step_by(SUMS * SIDE) {
                    match (self.w.n() - column).min(SUMS * SIDE) / SIDE {
                        1 => self.block::<L, 1>(row, column),
                        2 => self.block::<L, 2>(row, column),
                        3 => self.block::<L, 3>(row, column),
                        _ => self.block::<L, 4>(row, column),
                    }
                }
            }
            release();
        }
    }
}

impl Multiply<'_> {
    /// Computes twelve rows and `N`·16 columns of C.
    ///
    /// # Safety
    /// The matrices hold these rows and columns, and the tiles have their shapes.
    #[inline(always)]
    unsafe fn block<L: Lanes, const N: usize>(&mut self, row: usize, column: usize) {
        let (k, n) = (self.w.words(), self.w.n());
        let a = self.a[row * k..].as_ptr();
        let mut w = [std::ptr::null(); N];
        let mut strides = [0; N];
        for j in 0..N {
            let first = column + SIDE * j;
            let panel = first / 32 * 32;
            w[j] = self.w.panel(panel)[first - panel..].as_ptr();
            strides[j] = (n - panel).min(32) * WORD;
        }
        // SAFETY: the caller guarantees the shapes. At the end of the summed dimension, tiles of only `rest` words or
        // rows are read.
        unsafe {
            tile!(zero 0);
            if N > 1 {
                tile!(zero 1);
            }
            if N > 2 {
                tile!(zero 2);
            }
            if N > 3 {
                tile!(zero 3);
            }
            let whole = k / SIDE;
            for p in 0..whole {
                let w = |j: usize| w[j].byte_add(SIDE * p * strides[j]);
                tile!(load 4, a.add(SIDE * p), k * WORD);
                add_products!(N, 4, 6, w, |j: usize| strides[j]);
            }
            if !k.is_multiple_of(SIDE) {
                let w = |j: usize| w[j].byte_add(SIDE * whole * strides[j]);
                tile!(load 5, a.add(SIDE * whole), k * WORD);
                add_products!(N, 5, 7, w, |j: usize| strides[j]);
            }
            let c = self.c[row * n + column..].as_mut_ptr();
            store_sums!(N, c, n * WORD);
        }
        self.end::<L>(row, column, N);
    }

    /// Adds the initial values of twelve rows and applies the last operation while the rows are in the cache.
    #[inline(always)]
    fn end<L: Lanes>(&mut self, row: usize, column: usize, tiles: usize) {
        if matches!((self.start, self.finish), (Start::Zero, Finish::Store)) {
            return;
        }
        let n = self.w.n();
        for row in row..row + ROWS {
            let at = row * n + column..row * n + column + SIDE * tiles;
            let start = match self.start {
                Start::Zero => None,
                Start::Rows { rows, of } => Some(&rows[of[row] as usize * n + column..][..SIDE * tiles]),
            };
            let mask = match self.finish {
                Finish::Mask(mask) => Some(&mask[at.clone()]),
                Finish::Store | Finish::Relu => None,
            };
            for (j, values) in self.c[at].as_chunks_mut().0.iter_mut().enumerate() {
                let lanes = |values: &[f32]| L::of(&values.as_chunks().0[j]);
                let mut sum = L::of(values);
                if let Some(start) = start {
                    sum = sum.add(lanes(start));
                }
                if matches!(self.finish, Finish::Relu) {
                    sum = sum.relu();
                } else if let Some(mask) = mask {
                    sum = sum.where_positive(lanes(mask));
                }
                sum.put(values);
            }
        }
    }
}

/// Number of tiles of A that are transposed at a time.
const SECTION: usize = 8;

/// G += Aᵀ·D; see [`accumulate`](super::accumulate), which checks the shapes. Both widths are multiples of 16.
pub(super) struct Accumulate<'a> {
    pub(super) product: Product,
    pub(super) a: &'a [f32],
    pub(super) d: &'a [f32],
    pub(super) g: &'a mut [f32],
}

impl Kernel for Accumulate<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(mut self) {
        let Product { rows, k, n, .. } = self.product;
        let shapes = Shapes::new([[SIDE, SIDE]; 8]);
        // SAFETY: `accumulate` checked the matrices, and that AMX is available.
        unsafe {
            shapes.load();
            let whole = rows / SIDE * SIDE;
            for first in (0..whole).step_by(SECTION * SIDE) {
                let count = (whole - first).min(SECTION * SIDE) / SIDE;
                self.section(count, self.a[first * k..].as_ptr(), self.d[first * n..].as_ptr());
            }
            if whole < rows {
                // Adds the last rows, padded with zeros.
                let filled = |from: &[f32], width: usize| {
                    let mut last = from[whole * width..rows * width].to_vec();
                    last.resize(SIDE * width, 0.0);
                    last
                };
                let (a, d) = (filled(self.a, k), filled(self.d, n));
                self.section(1, a.as_ptr(), d.as_ptr());
            }
            release();
        }
    }
}

impl Accumulate<'_> {
    /// Adds the products of `count`·16 rows; `count` is at most [`SECTION`].
    ///
    /// # Safety
    /// `a` and `d` hold these rows; the tiles have their shapes.
    #[inline(always)]
    unsafe fn section(&mut self, count: usize, a: *const f32, d: *const f32) {
        let Product { k, n, .. } = self.product;
        let mut transposed = [[0.0; SIDE * SIDE]; SECTION];
        for row in (0..k).step_by(SIDE) {
            for (block, to) in transposed[..count].iter_mut().enumerate() {
                // SAFETY: as the caller guarantees; a processor with AMX has AVX-512F.
                unsafe { transpose(a.add(SIDE * block * k + row), k, to) };
            }
            for column in (0..n).step_by(SUMS * SIDE) {
                let g = self.g[row * n + column..].as_mut_ptr();
                // SAFETY: as the caller guarantees.
                unsafe {
                    match (n - column).min(SUMS * SIDE) / SIDE {
                        1 => sum::<1>(&transposed[..count], d.add(column), g, n),
                        2 => sum::<2>(&transposed[..count], d.add(column), g, n),
                        3 => sum::<3>(&transposed[..count], d.add(column), g, n),
                        _ => sum::<4>(&transposed[..count], d.add(column), g, n),
                    }
                }
            }
        }
    }
}

/// Adds the products of tiles of A with rows of D to 16 rows and `N`·16 columns of G.
///
/// # Safety
/// `d` holds 16 rows of `n` words for each tile, `g` holds 16 rows of `n` values; the tiles have their shapes.
#[inline(always)]
unsafe fn sum<const N: usize>(a: &[[f32; SIDE * SIDE]], d: *const f32, g: *mut f32, n: usize) {
    let stride = n * WORD;
    // SAFETY: as the caller guarantees.
    unsafe {
        tile!(load 0, g, stride);
        if N > 1 {
            tile!(load 1, g.add(SIDE), stride);
        }
        if N > 2 {
            tile!(load 2, g.add(2 * SIDE), stride);
        }
        if N > 3 {
            tile!(load 3, g.add(3 * SIDE), stride);
        }
        for (block, a) in a.iter().enumerate() {
            let d = d.add(SIDE * block * n);
            tile!(load 4, a.as_ptr(), SIDE * WORD);
            add_products!(N, 4, 6, |j: usize| d.add(SIDE * j), |_| stride);
        }
        store_sums!(N, g, stride);
    }
}
