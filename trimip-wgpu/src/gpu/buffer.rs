//! A flat array on the device. Its length is either known to the host or stored in a counter on the device, so that
//! the host never waits for the number of samples of a step.

use super::bind::Bind;
use super::device::Gpu;
use super::read_back::Receipt;
use bytemuck::Pod;
use std::marker::PhantomData;
use std::sync::Arc;

/// An array of values on the device.
pub struct Buffer<T> {
    gpu: Arc<Gpu>,
    raw: wgpu::Buffer,
    /// Size of the allocation in bytes.
    bytes: usize,
    length: Length,
    values: PhantomData<T>,
}

/// The number of values.
#[derive(Clone)]
enum Length {
    Known(usize),
    /// The counter times `width`, at most `most`.
    Counted {
        counts: wgpu::Buffer,
        counter: u32,
        width: usize,
        most: usize,
    },
}

impl<T> Drop for Buffer<T> {
    fn drop(&mut self) {
        self.gpu.released(self.bytes as u64);
    }
}

impl<T: Pod> Buffer<T> {
    /// Creates a buffer of `length` zeros.
    pub fn zeros(gpu: &Arc<Gpu>, length: usize) -> Self {
        let raw = gpu.buffer(std::any::type_name::<T>(), (length * size_of::<T>()) as u64);
        Self {
            gpu: Arc::clone(gpu),
            raw,
            bytes: length * size_of::<T>(),
            length: Length::Known(length),
            values: PhantomData,
        }
    }

    /// Makes room for `capacity` values. If that needs a new allocation, the old values are lost. An array that was not
    /// empty then gets a quarter more room than it needs, so that an array that grows step by step is seldom
    /// reallocated.
    pub fn reserve(&mut self, capacity: usize) {
        if capacity > self.capacity() {
            let spare = if self.bytes > 0 { capacity / 4 } else { 0 };
            *self = Self::zeros(&self.gpu, capacity + spare);
        }
    }

    /// Sets the length to `length`; the values are arbitrary.
    pub fn resize(&mut self, length: usize) {
        self.reserve(length);
        self.length = Length::Known(length);
    }

    /// Makes room for `capacity` values, and sets the length to `width` times the given counter on the device.
    pub fn count_by(&mut self, capacity: usize, counts: &wgpu::Buffer, counter: u32, width: usize) {
        self.reserve(capacity);
        self.length = Length::Counted { counts: counts.clone(), counter, width, most: capacity };
    }

    /// Swaps the memory with an array of another type. Lengths are swapped as they are, in values: if the values of the
    /// arrays differ in size, the caller has to set both lengths again.
    pub fn swap<U>(&mut self, other: &mut Buffer<U>) {
        std::mem::swap(&mut self.raw, &mut other.raw);
        std::mem::swap(&mut self.bytes, &mut other.bytes);
        std::mem::swap(&mut self.length, &mut other.length);
    }

    /// Returns the number of values that fit into the allocation.
    pub fn capacity(&self) -> usize {
        self.bytes / size_of::<T>()
    }

    /// Returns the maximum number of values.
    pub fn most(&self) -> usize {
        match self.length {
            Length::Known(length) => length,
            Length::Counted { most, .. } => most,
        }
    }

    /// Returns the number of values; `None` if it is stored on the device.
    pub fn known_len(&self) -> Option<usize> {
        match self.length {
            Length::Known(length) => Some(length),
            Length::Counted { .. } => None,
        }
    }

    /// Returns the counter that holds the number of rows, if this number is on the device.
    pub fn counter(&self) -> Option<(&wgpu::Buffer, u32)> {
        match &self.length {
            Length::Known(_) => None,
            Length::Counted { counts, counter, .. } => Some((counts, *counter)),
        }
    }

    /// Replaces the values, and sets the length to that of `values`.
    pub fn write(&mut self, values: &[T]) {
        self.resize(values.len());
        self.gpu.write(&self.raw, values);
    }

    /// Copies the values to the host; waits for the device. A length on the device is read first.
    pub fn read(&self) -> Vec<T> {
        let count = self.count_receipt().map(|receipt| self.gpu.redeem(receipt));
        self.gpu.redeem(self.gpu.send(&self.raw, 0, self.length_of(count)))
    }

    /// Copies the values to the host as [`read`](Self::read) does; the future is pending while the device works.
    pub async fn read_async(&self) -> Vec<T> {
        let count = match self.count_receipt() {
            Some(receipt) => Some(self.gpu.redeem_async(receipt).await),
            None => None,
        };
        self.gpu.redeem_async(self.gpu.send(&self.raw, 0, self.length_of(count))).await
    }

    /// Starts the transfer of the counter to the host, if the number of rows is on the device.
    fn count_receipt(&self) -> Option<Receipt<u32>> {
        self.counter().map(|(counts, counter)| self.gpu.send(counts, u64::from(counter) * 4, 1))
    }

    /// Returns the number of values, given the counter's value if the number of rows is on the device.
    fn length_of(&self, count: Option<Vec<u32>>) -> usize {
        match (&self.length, count.as_deref()) {
            (Length::Counted { width, most, .. }, Some(&[count])) => (count as usize * width).min(*most),
            (length, _) => match length {
                Length::Known(length) => *length,
                Length::Counted { .. } => 0,
            },
        }
    }

    /// Returns the underlying `wgpu` buffer.
    pub fn raw(&self) -> &wgpu::Buffer {
        &self.raw
    }

    /// Binds the whole buffer.
    pub fn bind(&self) -> Bind<'_> {
        Bind { buffer: &self.raw, offset: 0, size: None }
    }

    /// Binds `count` values from index `first` on. The offset of this value must be a multiple of 256 bytes.
    pub fn part(&self, first: usize, count: usize) -> Bind<'_> {
        let bytes = |count: usize| (count * size_of::<T>()) as u64;
        Bind { buffer: &self.raw, offset: bytes(first), size: Some(bytes(count)) }
    }
}
