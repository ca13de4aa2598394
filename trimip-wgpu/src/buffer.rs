//! A flat array on the device. Its length is known to the host, or stands in a counter on the device: how many samples a
//! step has is never waited for.

use crate::device::{Bind, Gpu};
use crate::read_back::Receipt;
use bytemuck::Pod;
use std::marker::PhantomData;
use std::sync::Arc;

/// Values on the device.
pub struct Buffer<T> {
    gpu: Arc<Gpu>,
    raw: wgpu::Buffer,
    /// Bytes that there is room for.
    room: usize,
    length: Length,
    values: PhantomData<T>,
}

/// How many values there are.
#[derive(Clone)]
enum Length {
    Known(usize),
    /// As many as the counter says, times a width, and at most so many.
    Counted {
        counts: wgpu::Buffer,
        counter: u32,
        width: usize,
        most: usize,
    },
}

impl<T> Drop for Buffer<T> {
    fn drop(&mut self) {
        self.gpu.released(self.room as u64);
    }
}

impl<T: Pod> Buffer<T> {
    /// `length` zeros.
    pub fn zeros(gpu: &Arc<Gpu>, length: usize) -> Self {
        let raw = gpu.buffer(std::any::type_name::<T>(), (length * size_of::<T>()) as u64);
        Self {
            gpu: Arc::clone(gpu),
            raw,
            room: length * size_of::<T>(),
            length: Length::Known(length),
            values: PhantomData,
        }
    }

    /// Makes room for `capacity` values; what was there is lost if there was less. An array that grows gets a quarter
    /// more than it needs, so that one that grows step by step seldom moves.
    pub fn reserve(&mut self, capacity: usize) {
        if capacity > self.capacity() {
            let spare = if self.room > 0 { capacity / 4 } else { 0 };
            *self = Self::zeros(&self.gpu, capacity + spare);
        }
    }

    /// Has `length` values, whatever they are.
    pub fn resize(&mut self, length: usize) {
        self.reserve(length);
        self.length = Length::Known(length);
    }

    /// Has room for `capacity` values, of which there are `width` for each that the device has counted.
    pub fn count_by(&mut self, capacity: usize, counts: &wgpu::Buffer, counter: u32, width: usize) {
        self.reserve(capacity);
        self.length = Length::Counted { counts: counts.clone(), counter, width, most: capacity };
    }

    /// Changes places with an array of other values.
    pub fn swap<U>(&mut self, other: &mut Buffer<U>) {
        std::mem::swap(&mut self.raw, &mut other.raw);
        std::mem::swap(&mut self.room, &mut other.room);
        std::mem::swap(&mut self.length, &mut other.length);
    }

    /// Values that there is room for.
    pub fn capacity(&self) -> usize {
        self.room / size_of::<T>()
    }

    /// Values that there are at most.
    pub fn most(&self) -> usize {
        match self.length {
            Length::Known(length) => length,
            Length::Counted { most, .. } => most,
        }
    }

    /// Number of values where the host knows it.
    pub fn known_len(&self) -> Option<usize> {
        match self.length {
            Length::Known(length) => Some(length),
            Length::Counted { .. } => None,
        }
    }

    /// The counter that says how many rows there are, where the device counted them.
    pub fn counter(&self) -> Option<(&wgpu::Buffer, u32)> {
        match &self.length {
            Length::Known(_) => None,
            Length::Counted { counts, counter, .. } => Some((counts, *counter)),
        }
    }

    /// Replaces the values.
    pub fn write(&mut self, values: &[T]) {
        self.resize(values.len());
        self.gpu.write(&self.raw, values);
    }

    /// Copies the values out; waits for the device.
    pub fn read(&self) -> Vec<T> {
        let count = self.count_receipt().map(|receipt| self.gpu.redeem(receipt));
        self.gpu.redeem(self.gpu.send(&self.raw, 0, self.length_of(count)))
    }

    /// Copies the values out; the future is pending while the device works.
    pub async fn read_async(&self) -> Vec<T> {
        let count = match self.count_receipt() {
            Some(receipt) => Some(self.gpu.redeem_async(receipt).await),
            None => None,
        };
        self.gpu.redeem_async(self.gpu.send(&self.raw, 0, self.length_of(count))).await
    }

    /// The counter that says how many rows there are, on its way to the host.
    fn count_receipt(&self) -> Option<Receipt<u32>> {
        self.counter().map(|(counts, counter)| self.gpu.send(counts, u64::from(counter) * 4, 1))
    }

    /// Number of values, once the counter is read where the device counted them.
    fn length_of(&self, count: Option<Vec<u32>>) -> usize {
        match (&self.length, count.as_deref()) {
            (Length::Counted { width, most, .. }, Some(&[count])) => (count as usize * width).min(*most),
            (length, _) => match length {
                Length::Known(length) => *length,
                Length::Counted { .. } => 0,
            },
        }
    }

    /// The buffer on the device.
    pub fn raw(&self) -> &wgpu::Buffer {
        &self.raw
    }

    /// All of it, for a kernel.
    pub fn bind(&self) -> Bind<'_> {
        Bind { buffer: &self.raw, offset: 0, size: None }
    }

    /// A part of it; `first` is a multiple of 64 values of four bytes.
    pub fn part(&self, first: usize, count: usize) -> Bind<'_> {
        let bytes = |count: usize| (count * size_of::<T>()) as u64;
        Bind { buffer: &self.raw, offset: bytes(first), size: Some(bytes(count)) }
    }
}
