//! A flat array aligned to a cache line, so that a row of 16 features fills exactly one cache line and one vector
//! register.

use crate::pages::{Line, Lines};
use bytemuck::Pod;
use std::marker::PhantomData;
use std::ops::{Deref, DerefMut};

/// Values on the CPU. The memory grows and never shrinks.
pub struct Buffer<T> {
    lines: Lines,
    length: usize,
    values: PhantomData<T>,
}

impl<T> Default for Buffer<T> {
    fn default() -> Self {
        Self { lines: Lines::zeros(0), length: 0, values: PhantomData }
    }
}

impl<T: Pod> Buffer<T> {
    /// Creates a buffer of `length` zeros.
    pub fn zeros(length: usize) -> Self {
        let lines = Lines::zeros((length * size_of::<T>()).div_ceil(size_of::<Line>()));
        Self { lines, length, values: PhantomData }
    }

    /// Changes the length. Old values are kept; new ones are zero or left over from earlier use.
    pub fn resize(&mut self, length: usize) {
        self.lines.grow((length * size_of::<T>()).div_ceil(size_of::<Line>()));
        self.length = length;
    }

    /// Appends one value.
    pub fn push(&mut self, value: T) {
        let length = self.length;
        if (length + 1) * size_of::<T>() > size_of_val(&*self.lines) {
            self.resize((2 * length).max(64));
        }
        self.length = length + 1;
        self[length] = value;
    }

    /// Removes all values and keeps the memory.
    pub fn clear(&mut self) {
        self.length = 0;
    }

    /// Moves row `kept[i]` of `width` values to row i, for ascending `kept`. Only the kept rows remain.
    pub fn keep_rows(&mut self, kept: &[u32], width: usize) {
        for (to, &from) in kept.iter().enumerate() {
            let from = from as usize;
            if from != to {
                self.copy_within(from * width..(from + 1) * width, to * width);
            }
        }
        self.length = kept.len() * width;
    }

    /// Appends those rows of `from` whose indices are in `rows`. A row has `width` values.
    pub fn append_rows(&mut self, from: &[T], rows: &[u32], width: usize) {
        let start = self.length;
        self.resize(start + rows.len() * width);
        copy_rows(&mut self[start..], from, rows, width);
    }

    /// Replaces the values with those rows of `from` whose indices are in `rows`. A row has `width` values, and the
    /// buffer then has the length of `padded` rows.
    pub fn gather_rows(&mut self, from: &[T], rows: &[u32], width: usize, padded: usize) {
        self.resize(padded * width);
        copy_rows(self, from, rows, width);
    }
}

fn copy_rows<T: Copy>(to: &mut [T], from: &[T], rows: &[u32], width: usize) {
    if width == 0 {
        return;
    }
    for (to, &row) in to.chunks_exact_mut(width).zip(rows) {
        to.copy_from_slice(&from[row as usize * width..][..width]);
    }
}

impl<T: Pod> Deref for Buffer<T> {
    type Target = [T];
    #[inline]
    fn deref(&self) -> &[T] {
        let bytes: &[u8] = bytemuck::cast_slice(&self.lines);
        bytemuck::cast_slice(&bytes[..self.length * size_of::<T>()])
    }
}

impl<T: Pod> DerefMut for Buffer<T> {
    #[inline]
    fn deref_mut(&mut self) -> &mut [T] {
        let bytes: &mut [u8] = bytemuck::cast_slice_mut(&mut self.lines);
        bytemuck::cast_slice_mut(&mut bytes[..self.length * size_of::<T>()])
    }
}

/// Splits the first `count` values off the front of `from`.
pub fn take<'a, T>(from: &mut &'a [T], count: usize) -> &'a [T] {
    let (first, rest) = from.split_at(count);
    *from = rest;
    first
}

/// Splits the first `count` values off the front of `from`, mutably.
pub fn take_mut<'a, T>(from: &mut &'a mut [T], count: usize) -> &'a mut [T] {
    let (first, rest) = std::mem::take(from).split_at_mut(count);
    *from = rest;
    first
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_of_any_size_stay_in_place() {
        let mut buffer = Buffer::<[f32; 3]>::zeros(0);
        for i in 0..1000 {
            buffer.push([i as f32; 3]);
        }
        assert!((0..1000).all(|i| buffer[i] == [i as f32; 3]));
        assert_eq!(buffer.as_ptr() as usize % 64, 0);
        buffer.keep_rows(&[1, 5, 999], 1);
        assert_eq!(&buffer[..], &[[1.0; 3], [5.0; 3], [999.0; 3]]);
    }

    #[test]
    fn buffers_of_many_pages_grow_like_small_ones() {
        for first in [0, 1, 1_000_000, 3_000_000] {
            let mut buffer = Buffer::<u32>::zeros(first);
            assert!(buffer.iter().all(|value| *value == 0));
            buffer.iter_mut().zip(0..).for_each(|(value, i)| *value = i);
            for length in [first + 1, 1_048_577, 2_000_000, 9_000_001] {
                buffer.resize(length);
                assert_eq!(buffer.len(), length);
                assert!(
                    buffer.iter().zip(0..).all(|(&value, i)| value == if i < first as u32 { i } else { 0 })
                );
                assert_eq!(buffer.as_ptr() as usize % 64, 0);
            }
        }
    }
}
