//! Ctrl-C: the first one makes the run stop and save, the second one ends the program immediately. Before training begins there
//! is nothing to save, so the first one ends the program within [`GRACE`].

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, LazyLock, Mutex, PoisonError};
use std::time::Duration;
use trimip_core::{Error, Result};

/// Exit code of a stopped program: 128 + SIGINT, the shell convention.
pub const EXIT_CODE: u8 = 130;

/// True once the program has been asked to stop.
static STOP: LazyLock<Arc<AtomicBool>> = LazyLock::new(Arc::default);

/// True once a stop has something to save.
static SAVES: AtomicBool = AtomicBool::new(false);

/// A program that has nothing to save may clean up for this long after a signal. Then it ends.
const GRACE: Duration = Duration::from_secs(2);

/// True once the signal handler is installed.
static WATCHED: Mutex<bool> = Mutex::new(false);

/// Installs the handler once. The first signal (interrupt, terminate or hang-up) sets the returned flag.
pub fn install() -> Result<Arc<AtomicBool>> {
    install_for("stopping after this step and saving; press Ctrl-C again to end at once")
}

/// States that a stop has something to save from now on: a signal no longer ends the program after [`GRACE`].
pub fn saves() {
    SAVES.store(true, Ordering::SeqCst);
}

/// Like [`install`]; the first signal prints `answer` if there is something to save.
pub fn install_for(answer: &'static str) -> Result<Arc<AtomicBool>> {
    catch(move |again| {
        if again {
            std::process::exit(EXIT_CODE.into());
        }
        if SAVES.load(Ordering::SeqCst) {
            crate::terminal::note(format!("\n{answer}"));
            return;
        }
        crate::terminal::note("\nending");
        // A thread of its own, so that a second signal is answered meanwhile. If there can be none, the program ends now.
        let end = || {
            std::thread::sleep(GRACE);
            if !SAVES.load(Ordering::SeqCst) {
                std::process::exit(EXIT_CODE.into());
            }
        };
        if std::thread::Builder::new().spawn(end).is_err() {
            std::process::exit(EXIT_CODE.into());
        }
    })
}

/// Sets the stop flag, as a first signal would. Repeated calls never end the program.
#[cfg(feature = "mpi")]
pub fn ask() {
    STOP.store(true, Ordering::SeqCst);
}

/// Installs a handler that never ends the program: every signal sets the returned flag and calls `act`.
#[cfg(feature = "mpi")]
pub fn outlive(act: impl Fn() + Send + 'static) -> Result<Arc<AtomicBool>> {
    catch(move |_| act())
}

/// Installs the handler. Every signal sets the stop flag and calls `act`: the first time with false, then with true.
fn catch(act: impl Fn(bool) + Send + 'static) -> Result<Arc<AtomicBool>> {
    let mut watched = WATCHED.lock().unwrap_or_else(PoisonError::into_inner);
    if *watched {
        return Ok(Arc::clone(&STOP));
    }
    let ignored = hang_up::ignore();
    let before = AtomicBool::new(false);
    let signalled = move || {
        STOP.store(true, Ordering::SeqCst);
        act(before.swap(true, Ordering::SeqCst));
    };
    ctrlc::set_handler(signalled).map_err(|error| {
        Error::device(format!("cannot watch for Ctrl-C: {error}; raise the limit of processes (ulimit -u)"))
    })?;
    if ignored {
        hang_up::ignore();
    }
    *watched = true;
    Ok(Arc::clone(&STOP))
}

/// The hang-up signal, which a terminal sends when it closes. `nohup` starts a program with this signal ignored, and it must stay ignored.
#[cfg(unix)]
#[allow(unsafe_code)] // signal handlers have no safe interface
mod hang_up {
    use nix::sys::signal::{SigHandler, Signal, signal};

    /// Ignores the signal. Returns true if it was ignored already.
    pub fn ignore() -> bool {
        // SAFETY: an ignored signal runs no code.
        let before = unsafe { signal(Signal::SIGHUP, SigHandler::SigIgn) };
        before.is_ok_and(|handler| matches!(handler, SigHandler::SigIgn))
    }
}

/// This system has no hang-up signal.
#[cfg(not(unix))]
mod hang_up {
    /// Does nothing.
    pub fn ignore() -> bool {
        false
    }
}
