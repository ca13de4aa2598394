//! The allocator of the program: the system's, but where memory runs out the program ends with one line and the exit code of
//! a device that is too small. By itself, Rust aborts.

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

// SAFETY: every call is passed on to the system's allocator as it came, and its answer is returned unless it is null.
unsafe impl GlobalAlloc for Ending {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller's promises are those that the system's allocator asks for.
        given(unsafe { System.alloc(layout) }, layout)
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        // SAFETY: as above.
        given(unsafe { System.alloc_zeroed(layout) }, layout)
    }

    unsafe fn realloc(&self, memory: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        // SAFETY: as above.
        given(unsafe { System.realloc(memory, layout, size) }, layout)
    }

    unsafe fn dealloc(&self, memory: *mut u8, layout: Layout) {
        // SAFETY: as above.
        unsafe { System.dealloc(memory, layout) }
    }
}
