//! The program's allocator. It forwards to the system's allocator, but when memory runs out it ends the program with
//! one line and exit code 3 (the device is too small). Rust's default is to abort.

use std::alloc::{GlobalAlloc, Layout, System};
use std::io::Write;

#[global_allocator]
static ALLOCATOR: Ending = Ending;

/// Forwards to the system's allocator, and ends the program when no memory is left.
struct Ending;

/// Returns `memory`, or ends the program if it is null. The message needs no allocation.
fn given(memory: *mut u8, layout: Layout) -> *mut u8 {
    if memory.is_null() {
        let _ = writeln!(
            std::io::stderr(),
            "error: memory: cannot allocate {} more bytes; free memory, raise its limit (ulimit -v), or lower the settings \
             that use it",
            layout.size()
        );
        std::process::exit(3);
    }
    memory
}

// SAFETY: every call is forwarded unchanged to the system's allocator, and its result is returned unless it is null.
unsafe impl GlobalAlloc for Ending {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        // SAFETY: the caller upholds the contract of `GlobalAlloc`, which is also that of the system's allocator.
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
