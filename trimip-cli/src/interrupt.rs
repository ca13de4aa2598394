//! Ctrl-C: the first asks the run to stop and save, a second ends the program immediately.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, OnceLock};
use trimip_core::{Error, Result};

pub use trimip_core::STOPPED as EXIT_CODE;

/// The flag of the single signal handler.
static STOP: OnceLock<Arc<AtomicBool>> = OnceLock::new();

/// Installs the handler once. The first signal (interrupt, terminate or hang-up) sets the returned flag.
pub fn install() -> Result<Arc<AtomicBool>> {
    install_for("stopping after this step and saving; press Ctrl-C again to end at once")
}

/// The same; `answer` is what a signal prints.
pub fn install_for(answer: &'static str) -> Result<Arc<AtomicBool>> {
    catch(move |again| {
        if again {
            std::process::exit(EXIT_CODE.into());
        }
        crate::terminal::note(format!("\n{answer}"));
    })
}

/// Signals do nothing but set the returned flag.
#[cfg(feature = "mpi")]
pub fn outlive() -> Result<Arc<AtomicBool>> {
    catch(|_| {})
}

/// Calls `act` at every signal, with false at the first.
fn catch(act: impl Fn(bool) + Send + 'static) -> Result<Arc<AtomicBool>> {
    if let Some(stop) = STOP.get() {
        return Ok(Arc::clone(stop));
    }
    let stop = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&stop);
    let ignored = hang_up::ignore();
    ctrlc::set_handler(move || act(flag.swap(true, Ordering::SeqCst))).map_err(|error| {
        Error::device(format!("cannot watch for Ctrl-C: {error}; raise the limit of processes (ulimit -u)"))
    })?;
    if ignored {
        hang_up::ignore();
    }
    Ok(Arc::clone(STOP.get_or_init(|| stop)))
}

/// The signal of a terminal that closes. `nohup` starts a program with it ignored, and it has to stay so.
#[cfg(unix)]
#[allow(unsafe_code)] // a signal has no safe door
mod hang_up {
    use nix::sys::signal::{SigHandler, Signal, signal};

    /// Ignores the signal. True if it was ignored before.
    pub fn ignore() -> bool {
        // SAFETY: an ignored signal runs no code.
        let before = unsafe { signal(Signal::SIGHUP, SigHandler::SigIgn) };
        before.is_ok_and(|handler| matches!(handler, SigHandler::SigIgn))
    }
}

/// This system has no such signal.
#[cfg(not(unix))]
mod hang_up {
    /// Does nothing.
    pub fn ignore() -> bool {
        false
    }
}
