//! The number of rows that a kernel works on: always a counter on the device, even if the host determined the number.

use super::bind::{Bind, Size};
use super::buffer::Buffer;
use bytemuck::Pod;

/// Maximum number of rows per workgroup. Arrays have room for whole blocks.
pub const BLOCK: usize = 64;

/// A counter of rows.
pub struct Rows {
    /// Counters on the device.
    pub counts: wgpu::Buffer,
    /// Index of the counter.
    pub counter: u32,
    /// Maximum number of rows.
    pub capacity: usize,
}

impl Rows {
    /// Returns the rows of an array of samples. If their number is on the host, it is written to `own` on the device.
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

    /// Sizes an array to `width` values per row, with room for whole blocks of rows.
    pub fn size<T: Pod>(&self, array: &mut Buffer<T>, width: usize) {
        array.count_by(self.capacity.next_multiple_of(BLOCK) * width, &self.counts, self.counter, width);
    }

    /// Returns the size of a dispatch of `per` invocations per row, in workgroups of `group`.
    pub fn dispatch(&self, per: u32, group: u32) -> Size<'_> {
        Size::Counted { counts: &self.counts, counter: self.counter, per, group, times: 1 }
    }

    /// Returns the size of a dispatch of `times` workgroups for every `tile` rows.
    pub fn tiles(&self, tile: u32, times: u32) -> Size<'_> {
        Size::Counted { counts: &self.counts, counter: self.counter, per: 1, group: tile, times }
    }

    /// Binds all counters.
    pub fn bind(&self) -> Bind<'_> {
        Bind::whole(&self.counts)
    }
}
