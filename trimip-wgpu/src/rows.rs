//! How many rows a kernel works on: a counter on the device, whether the device counted or the host knows.

use crate::buffer::Buffer;
use crate::device::Size;
use bytemuck::Pod;

/// Rows that a workgroup takes at most: arrays have room for whole blocks.
pub const BLOCK: usize = 64;

/// A counter of rows.
pub struct Rows {
    /// Counters on the device.
    pub counts: wgpu::Buffer,
    /// Which of them.
    pub counter: u32,
    /// Rows that there may be.
    pub capacity: usize,
}

impl Rows {
    /// The rows of an array of samples; `own` holds the number where the host knows it.
    pub fn of<T: Pod>(samples: &Buffer<T>, own: &mut Buffer<u32>) -> Self {
        match samples.counter() {
            Some((counts, counter)) => Self { counts: counts.clone(), counter, capacity: samples.most() },
            None => {
                let count = samples.known_len().unwrap_or(0);
                own.write(&[count as u32]);
                Self { counts: own.raw().clone(), counter: 0, capacity: count }
            }
        }
    }

    /// Lets an array have `width` values for each row, and whole blocks of rows.
    pub fn size<T: Pod>(&self, array: &mut Buffer<T>, width: usize) {
        array.count_by(self.capacity.next_multiple_of(BLOCK) * width, &self.counts, self.counter, width);
    }

    /// A dispatch over `per` invocations of each row, in workgroups of `group`.
    pub fn dispatch(&self, per: u32, group: u32) -> Size<'_> {
        Size::Counted { counts: &self.counts, counter: self.counter, per, group }
    }

    /// All counters, for a kernel.
    pub fn bind(&self) -> crate::device::Bind<'_> {
        crate::device::Bind { buffer: &self.counts, offset: 0, size: None }
    }
}
