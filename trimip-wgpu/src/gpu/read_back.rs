//! Transfers from the device to the host. A copy is recorded with the other work and read once the device has
//! executed it.

use super::device::Gpu;
use super::lock::lock;
use super::mapping::Mapping;
use bytemuck::Pod;
use std::sync::atomic::Ordering;

/// A pending copy to the host.
pub struct Receipt<T> {
    staging: wgpu::Buffer,
    count: usize,
    /// Number of the submission that contains the copy.
    number: u64,
    kind: std::marker::PhantomData<T>,
}

impl Gpu {
    /// Records a copy of `count` values from byte `offset` of a buffer to memory that the host can read.
    pub fn send<T: Pod>(&self, buffer: &wgpu::Buffer, offset: u64, count: usize) -> Receipt<T> {
        let bytes = (count * size_of::<T>()) as u64;
        let staging = self.device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("read back"),
            size: bytes.next_multiple_of(4).max(4),
            usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
            mapped_at_creation: false,
        });
        let mut recorder = self.recorder();
        if bytes > 0 {
            let whole = bytes.next_multiple_of(4);
            recorder.encoder().copy_buffer_to_buffer(buffer, offset, &staging, 0, whole);
        }
        Receipt { staging, count, number: recorder.number, kind: std::marker::PhantomData }
    }

    /// Returns the copied values, as many as [`send`](Self::send) was given; they are zeros if the device failed. Waits
    /// until the device has executed the copy, but not for later work.
    pub fn redeem<T: Pod>(&self, receipt: Receipt<T>) -> Vec<T> {
        let wait = {
            let mut recorder = self.recorder();
            if recorder.number == receipt.number {
                self.submit_recorder(&mut recorder);
            }
            let newest = recorder.submitted.back().is_none_or(|(number, _)| *number <= receipt.number);
            self.counters.stalls.fetch_add(newest.into(), Ordering::Relaxed);
            recorder
                .submitted
                .iter()
                .find(|(number, _)| *number == receipt.number)
                .map(|(_, index)| index.clone())
        };
        let mapping = Mapping::of(&receipt.staging);
        let polled = self.poll(wgpu::PollType::Wait { submission_index: wait, timeout: None });
        self.collect(&receipt, polled && mapping.settle(|| self.poll(wgpu::PollType::Poll)))
    }

    /// Returns the copied values as [`Gpu::redeem`] does, without blocking: the future is pending until the device has
    /// executed the copy.
    pub async fn redeem_async<T: Pod>(&self, receipt: Receipt<T>) -> Vec<T> {
        {
            let mut recorder = self.recorder();
            if recorder.number == receipt.number {
                self.submit_recorder(&mut recorder);
            }
        }
        let mapping = Mapping::of(&receipt.staging);
        let mapped = mapping.wait(|| self.poll(wgpu::PollType::Poll)).await;
        self.collect(&receipt, mapped)
    }

    /// Copies the values out of the receipt's buffer. If the buffer could not be mapped, records a failure and returns
    /// zeros.
    fn collect<T: Pod>(&self, receipt: &Receipt<T>, mapped: bool) -> Vec<T> {
        if !mapped {
            lock(&self.failure).get_or_insert_with(|| "a buffer could not be read back".into());
            return vec![T::zeroed(); receipt.count];
        }
        let bytes = receipt.count * size_of::<T>();
        self.counters.read.fetch_add(bytes as u64, Ordering::Relaxed);
        let values = match receipt.staging.get_mapped_range(..) {
            Ok(view) => bytemuck::pod_collect_to_vec(&view[..bytes]),
            Err(_) => vec![T::zeroed(); receipt.count],
        };
        receipt.staging.unmap();
        values
    }
}
