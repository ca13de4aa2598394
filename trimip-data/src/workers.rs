//! The threads that read photographs.

use rayon::ThreadPoolBuilder;
use std::error::Error as _;
use trimip_core::{Error, Result};

/// Starts them, one for each core, unless they run already. Left to itself the pool starts at its first use, and panics if
/// the system refuses a thread.
///
/// # Errors
/// When the system refuses a thread.
pub fn start() -> Result<()> {
    match ThreadPoolBuilder::new().build_global() {
        // Without a source, the error says that the pool is there.
        Err(error) if error.source().is_some() => Err(Error::device(format!(
            "cannot start a thread for each core: {error}; raise the limits of processes and memory (ulimit -u, ulimit -v)"
        ))),
        _ => Ok(()),
    }
}
