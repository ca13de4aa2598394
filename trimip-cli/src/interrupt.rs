//! Ctrl-C: the first asks the run to stop and save, a second ends the program immediately.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use trimip_core::{Error, Result};

/// Exit code of a run that was stopped by Ctrl-C: 128 + SIGINT, the shell convention.
pub const EXIT_CODE: u8 = 130;

/// The flag of the single signal handler.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Installs the handler once. The first signal (interrupt, terminate or hang-up) sets the returned flag.
pub fn install() -> Result<Arc<AtomicBool>> {
    if let Some(stop) = STOP.get() {
        return Ok(Arc::clone(stop));
    }
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::SeqCst) {
            std::process::exit(EXIT_CODE.into());
        }
        crate::terminal::note("\nstopping after this step and saving; press Ctrl-C again to end at once");
    })
    .map_err(|error| {
        Error::device(format!("cannot watch for Ctrl-C: {error}; raise the limit of processes (ulimit -u)"))
    })?;
    Ok(Arc::clone(STOP.get_or_init(|| stop)))
}
