//! Ctrl-C: the first asks the run to stop and save, a second ends the program at once.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use trimip_core::{Error, Result};

/// Exit code of a run that was stopped by Ctrl-C: 128 + SIGINT, as shells have it.
pub const EXIT_CODE: u8 = 130;

/// The flag of the program's one handler.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Installs the handler, once; the flag it returns is set by the first signal (interrupt, terminate or hang-up).
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
    .map_err(|error| Error::run(format!("cannot watch for Ctrl-C: {error}")))?;
    Ok(Arc::clone(STOP.get_or_init(|| stop)))
}
