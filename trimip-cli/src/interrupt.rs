//! Ctrl-C: the first asks the run to stop and save, a second ends the program at once.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use trimip_core::{Error, Result};

/// Exit code of a run that was stopped by Ctrl-C: 128 + SIGINT, as shells have it.
pub const EXIT_CODE: u8 = 130;

/// Installs the handler; the flag it returns is set by the first signal (interrupt, terminate or hang-up).
pub fn install() -> Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::SeqCst) {
            std::process::exit(EXIT_CODE.into());
        }
        crate::terminal::note("\nstopping after this step and saving; press Ctrl-C again to end at once");
    })
    .map_err(|error| Error::run(format!("cannot watch for Ctrl-C: {error}")))?;
    Ok(stop)
}
