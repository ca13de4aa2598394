//! Arguments of a dispatch in addition to its kernel: bindings of buffers, and the amount of work.

use std::ops::Deref;

/// Maximum number of storage buffers of a kernel; every device supports it.
pub const MOST_BUFFERS: usize = 8;

/// Maximum number of workgroups along x; every device supports it.
pub const MOST_GROUPS: u32 = 65_535;

/// A part of a buffer, bound to a kernel.
#[derive(Clone, Copy)]
pub struct Bind<'a> {
    /// The buffer.
    pub buffer: &'a wgpu::Buffer,
    /// Offset in bytes; a multiple of 256.
    pub offset: u64,
    /// Size in bytes; `None` for the rest of the buffer.
    pub size: Option<u64>,
}

impl<'a> Bind<'a> {
    /// Binds a whole buffer.
    pub fn whole(buffer: &'a wgpu::Buffer) -> Self {
        Self { buffer, offset: 0, size: None }
    }
}

/// Bindings whose number depends on the variant of a kernel, stored without an allocation.
pub struct Binds<'a> {
    /// The bindings, followed by copies of the first.
    all: [Bind<'a>; MOST_BUFFERS],
    count: usize,
}

impl<'a> Binds<'a> {
    /// Creates a list of one binding.
    pub fn new(first: Bind<'a>) -> Self {
        Self { all: [first; MOST_BUFFERS], count: 1 }
    }

    /// Appends bindings. Bindings beyond [`MOST_BUFFERS`] are dropped, and the dispatch then panics because some are
    /// missing.
    pub fn and(mut self, binds: impl IntoIterator<Item = Bind<'a>>) -> Self {
        for bind in binds {
            if let Some(place) = self.all.get_mut(self.count) {
                *place = bind;
                self.count += 1;
            }
        }
        self
    }
}

impl<'a> Deref for Binds<'a> {
    type Target = [Bind<'a>];

    fn deref(&self) -> &[Bind<'a>] {
        &self.all[..self.count]
    }
}

/// The amount of work of a dispatch.
#[derive(Clone, Copy)]
pub enum Size<'a> {
    /// Number of invocations, in workgroups of [`GROUP`](super::GROUP).
    Items(u64),
    /// Number of workgroups.
    Groups(u64),
    /// The number of items is a counter on the device times `per`. For every `group` items there are `times`
    /// workgroups.
    Counted {
        /// Counters on the device.
        counts: &'a wgpu::Buffer,
        /// Index of the counter.
        counter: u32,
        /// Items per unit of the counter.
        per: u32,
        /// Items that a workgroup covers.
        group: u32,
        /// Workgroups that cover the same items.
        times: u32,
    },
}
