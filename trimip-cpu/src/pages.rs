//! Zeroed memory for buffers: small buffers lie on the heap, large buffers in large pages. A training step reads tables of
//! features and gradients at random addresses. With pages of 4 KiB, most of these reads would wait for a lookup in the page
//! table.

use bytemuck::{Pod, Zeroable};
use std::ops::{Deref, DerefMut};

/// A cache line.
#[repr(C, align(64))]
#[derive(Clone, Copy, Pod, Zeroable)]
pub(crate) struct Line([u8; 64]);

const ZERO: Line = Line([0; 64]);

/// Growable memory of zeroed lines.
pub(crate) struct Lines(Memory);

enum Memory {
    Heap(Vec<Line>),
    #[cfg(target_os = "linux")]
    Mapped(memmap2::MmapMut),
}

impl Lines {
    /// Creates `count` lines of zeros.
    pub fn zeros(count: usize) -> Self {
        Self(mapped(count).unwrap_or_else(|| Memory::Heap(vec![ZERO; count])))
    }

    /// Adds zeros until there are at least `count` lines.
    pub fn grow(&mut self, count: usize) {
        let before = self.len();
        if count <= before {
            return;
        }
        match (mapped(count.max(2 * before)), &mut self.0) {
            (Some(memory), _) => {
                let mut larger = Self(memory);
                larger[..before].copy_from_slice(self);
                *self = larger;
            }
            (None, Memory::Heap(lines)) => lines.resize(count, ZERO),
            #[cfg(target_os = "linux")]
            (None, Memory::Mapped(_)) => {
                let mut lines = self.to_vec();
                lines.resize(count, ZERO);
                self.0 = Memory::Heap(lines);
            }
        }
    }
}

/// Returns memory in large pages, if the system has them and `lines` are enough to fill one page.
#[cfg(target_os = "linux")]
fn mapped(lines: usize) -> Option<Memory> {
    /// Minimum number of lines with which a block contains a whole page of 2 MiB at any alignment.
    const LEAST: usize = (4 << 20) / size_of::<Line>();
    if lines < LEAST {
        return None;
    }
    // If the mapping fails, the caller allocates on the heap.
    let map = memmap2::MmapMut::map_anon(lines.checked_mul(size_of::<Line>())?).ok()?;
    // An error is ignored, because the mapping also works with small pages.
    let _ = map.advise(memmap2::Advice::HugePage);
    Some(Memory::Mapped(map))
}

#[cfg(not(target_os = "linux"))]
fn mapped(_: usize) -> Option<Memory> {
    None
}

impl Deref for Lines {
    type Target = [Line];
    #[inline]
    fn deref(&self) -> &[Line] {
        match &self.0 {
            Memory::Heap(lines) => lines,
            #[cfg(target_os = "linux")]
            Memory::Mapped(map) => bytemuck::cast_slice(map),
        }
    }
}

impl DerefMut for Lines {
    #[inline]
    fn deref_mut(&mut self) -> &mut [Line] {
        match &mut self.0 {
            Memory::Heap(lines) => lines,
            #[cfg(target_os = "linux")]
            Memory::Mapped(map) => bytemuck::cast_slice_mut(map),
        }
    }
}
