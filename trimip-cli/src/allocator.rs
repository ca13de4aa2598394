//! The allocator of the program: the system's, with two differences. Where memory runs out the program ends with one line and
//! the exit code of a device that is too small; by itself, Rust aborts. And Linux is asked to back large blocks with huge pages:
//! training reads photographs, planes and grids in random order, and pages of 4 KB make most of these reads wait for an address
//! first.

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::Write;

#[global_allocator]
static ALLOCATOR: Ending = Ending;

/// The system's allocator, which ends the program where it has nothing to give.
struct Ending;

/// Ends the program if `memory` is null. Nothing is allocated for the message.
fn given(memory: *mut u8, layout: Layout) -> *mut u8 {
    if memory.is_null() {
        let _ = writeln!(
            std::io::stderr(),
            "error: memory: {} bytes more are not to be had; free memory or raise its limit (ulimit -v), or lower the settings \
             that take it",
            layout.size()
        );
        std::process::exit(3);
    }
    memory
}

/// Blocks of this size and larger are backed with huge pages.
const LARGE: usize = 8 << 20;

/// The kernel's own zeros are used up to this alignment, so that pages that nobody touches take no memory.
const USUAL: usize = 16;

/// Asks for huge pages in a block of `size` bytes. Nothing happens where there are none.
#[cfg(target_os = "linux")]
fn advise(memory: *mut u8, size: usize) {
    const PAGE: usize = 2 << 20;
    let before = memory.align_offset(PAGE);
    let within = size.saturating_sub(before) / PAGE * PAGE;
    if within > 0 {
        // SAFETY: the pages lie within the block, and the advice changes none of their contents.
        unsafe {
            nix::libc::madvise(memory.wrapping_add(before).cast(), within, nix::libc::MADV_HUGEPAGE);
        }
    }
}

#[cfg(not(target_os = "linux"))]
fn advise(_: *mut u8, _: usize) {}

/// The block, after advice if it is large.
fn advised(memory: *mut u8, size: usize) -> *mut u8 {
    if size >= LARGE {
        advise(memory, size);
    }
    memory
}

// SAFETY: every call is passed on to the system's allocator as it came, and its answer is returned unless it is null.
unsafe impl GlobalAlloc for Ending {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promises are those that the system's allocator asks for.
        advised(given(unsafe { System.alloc(layout) }, layout), layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        if layout.size() < LARGE || layout.align() <= USUAL {
            // SAFETY: as above.
            return advised(given(unsafe { System.alloc_zeroed(layout) }, layout), layout.size());
        }
        // Here the system's allocator would write the zeros itself, and pages must be huge before.
        // SAFETY: as above.
        let memory = unsafe { self.alloc(layout) };
        // SAFETY: the block has as many bytes.
        unsafe { memory.write_bytes(0, layout.size()) };
        memory
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: as above.
        advised(given(unsafe { System.realloc(memory, layout, size) }, layout), size)
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(memory, layout) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn large_blocks_of_any_alignment_are_zero_where_they_should_be() {
        for align in [1, 16, 64, 4096] {
            let layout = Layout::from_size_align(LARGE + 12_345, align).unwrap();
            // The second block may be memory that was written to.
            for _ in 0..2 {
                // SAFETY: the layout has a size, and the block is freed with it.
                unsafe {
                    let memory = ALLOCATOR.alloc_zeroed(layout);
                    assert_eq!(memory as usize % align, 0);
                    let bytes = std::slice::from_raw_parts_mut(memory, layout.size());
                    assert!(bytes.iter().all(|byte| *byte == 0));
                    bytes.fill(7);
                    let grown = ALLOCATOR.realloc(memory, layout, 2 * layout.size());
                    assert!(std::slice::from_raw_parts(grown, layout.size()).iter().all(|byte| *byte == 7));
                    ALLOCATOR.dealloc(grown, Layout::from_size_align(2 * layout.size(), align).unwrap());
                }
            }
        }
    }
}
