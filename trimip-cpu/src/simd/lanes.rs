//! Kernels, and the operations on sixteen lanes that kernels consist of.

use super::bf16::pair;

/// A computation that is written in terms of [`Lanes`]. `run` and everything that it calls must be `#[inline(always)]`;
/// otherwise the compiler does not use the features of the instruction set.
pub trait Kernel {
    /// The result.
    type Output;
    /// Runs the computation.
    fn run<L: Lanes>(self) -> Self::Output;
}

/// Sixteen f32 values, or sixteen words. A word is a pair of bf16 values in the bits of an f32; the first value is in
/// the low half.
pub trait Lanes: Copy {
    /// True if 24 accumulators fit in registers.
    const WIDE: bool;
    /// Sets all lanes to `value`.
    fn splat(value: f32) -> Self;
    /// Reads 16 values.
    ///
    /// # Safety
    /// `from` is valid for 16 values.
    unsafe fn load(from: *const f32) -> Self;
    /// Writes 16 values.
    ///
    /// # Safety
    /// `to` is valid for 16 values.
    unsafe fn store(self, to: *mut f32);
    /// Reads the lanes from an array.
    #[inline(always)]
    fn of(values: &[f32; 16]) -> Self {
        // SAFETY: 16 values.
        unsafe { Self::load(values.as_ptr()) }
    }
    /// Writes the lanes to an array.
    #[inline(always)]
    fn put(self, to: &mut [f32; 16]) {
        // SAFETY: 16 values.
        unsafe { self.store(to.as_mut_ptr()) };
    }
    /// Returns self · factor + addend.
    fn mul_add(self, factor: Self, addend: Self) -> Self;
    /// Returns the lane-wise product.
    #[inline(always)]
    fn times(self, factor: Self) -> Self {
        self.mul_add(factor, Self::splat(0.0))
    }
    /// Sets lanes below zero to zero.
    fn relu(self) -> Self;
    /// Keeps the lanes where `mask` is above zero, and sets all others to zero.
    fn where_positive(self, mask: Self) -> Self;
    /// Returns the lane-wise sum.
    fn add(self, other: Self) -> Self;
    /// Returns the sum of all lanes.
    fn sum(self) -> f32;
    /// Returns the first value of each pair, as f32.
    fn first(self) -> Self;
    /// Returns the second value of each pair, as f32.
    fn second(self) -> Self;
    /// Returns self.0 · factor.0 + self.1 · factor.1 + addend in f32, where .0 and .1 are the two values of each word.
    #[inline(always)]
    fn dot_add(self, factor: Self, addend: Self) -> Self {
        self.first().mul_add(factor.first(), self.second().mul_add(factor.second(), addend))
    }
    /// Packs the pairs `(self[i], second[i])` into words, rounded to bf16.
    #[inline(always)]
    fn pair(self, second: Self) -> Self {
        let (first, second) = (self.array(), second.array());
        let words: [f32; 16] = std::array::from_fn(|i| pair(first[i], second[i]));
        Self::of(&words)
    }
    /// Packs neighbours among the 32 values of `self` and `next` into words of pairs, rounded to bf16.
    #[inline(always)]
    fn pair_neighbours(self, next: Self) -> Self {
        let values = [self.array(), next.array()];
        let at = |i: usize| values[i / 16][i % 16];
        let words: [f32; 16] = std::array::from_fn(|i| pair(at(2 * i), at(2 * i + 1)));
        Self::of(&words)
    }
    /// Returns the lanes as an array.
    #[inline(always)]
    fn array(self) -> [f32; 16] {
        let mut values = [0.0; 16];
        self.put(&mut values);
        values
    }
}
