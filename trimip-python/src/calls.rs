//! Calls of the library, and what is checked before them: the process, and the memory that a result needs.

use crate::error::raised;
use pyo3::exceptions::PyMemoryError;
use pyo3::prelude::*;
use std::sync::atomic::{AtomicU32, Ordering};
use trimip_core::memory::available_memory;

/// Process that called the library first, whose worker threads exist; 0 before the first call.
static OWNER: AtomicU32 = AtomicU32::new(0);

/// Runs `work` with the interpreter lock released.
///
/// # Errors
/// In a process that was forked after a call of the library. A fork copies no threads, so the work would wait for the library's
/// threads for ever.
pub fn detached<T: Send>(py: Python<'_>, work: impl FnOnce() -> T + Send) -> PyResult<T> {
    let here = std::process::id();
    match OWNER.compare_exchange(0, here, Ordering::SeqCst, Ordering::SeqCst) {
        Err(owner) if owner != here => Err(raised(trimip::Error::run(
            "this process was forked from one that had used trimip, and has no worker threads; start processes with \
             multiprocessing.set_start_method(\"spawn\"), or use trimip only after the fork",
        ))),
        _ => Ok(py.detach(work)),
    }
}

/// Checks that `bytes` bytes are available for `what`.
///
/// # Errors
/// `MemoryError`, which says how many bytes are needed and how many are available.
pub fn expect_memory(what: &str, bytes: u64) -> PyResult<()> {
    match available_memory() {
        Some(available) if available < bytes => Err(PyMemoryError::new_err(format!(
            "{what} needs about {}, and {} are available; ask for less at once",
            trimip::formatting::bytes(bytes),
            trimip::formatting::bytes(available)
        ))),
        _ => Ok(()),
    }
}
