//! The thread pool that reads photographs.

use rayon::ThreadPoolBuilder;
use std::error::Error as _;
use trimip_core::{Error, Result};

/// Starts the global thread pool, one thread for each core, unless it runs already. Without this call, the pool starts
/// at its first use and panics if the system refuses a thread.
///
/// # Errors
/// When the system refuses a thread.
pub fn start() -> Result<()> {
    match ThreadPoolBuilder::new().build_global() {
        // An error without a source means that the pool exists already.
        Err(error) if error.source().is_some() => Err(Error::device(format!(
            "cannot start a thread for each core: {error}; raise the limits of processes and memory (ulimit -u, ulimit -v)"
        ))),
        _ => Ok(()),
    }
}
