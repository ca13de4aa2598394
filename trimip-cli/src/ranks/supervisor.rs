//! The guard of a rank. The process that a launcher starts for a rank starts this program once more, and that second process is the rank.
//! If the rank is killed, because memory ran out or a library crashed, its guard reports that like any other error; a launcher would only
//! end with 128 + the signal. A pipe connects guard and rank: a byte in the pipe asks the rank to stop, and its closing ends the rank.

use crate::{interrupt, terminal};
use std::io::{Read, Write};
use std::process::{ChildStdin, Command, ExitStatus, Stdio};
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex, PoisonError};
use trimip_core::{Error, Result};

/// Environment variable that is set in the process of a rank.
const GUARDED: &str = "TRIMIP_RANK_IS_GUARDED";

/// Exit code of a rank that was killed.
const KILLED: u8 = 3;

/// How a rank ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum End {
    /// The rank ended with this exit code.
    Code(u8),
    /// A signal that requests a stop ended the rank before the rank could react.
    Stopped,
    /// Another signal or a crash ended the rank.
    Killed,
}

impl End {
    fn of(status: ExitStatus) -> Self {
        #[cfg(unix)]
        {
            use nix::libc::{SIGHUP, SIGINT, SIGTERM};
            use std::os::unix::process::ExitStatusExt;
            if status.signal().is_some_and(|signal| [SIGHUP, SIGINT, SIGTERM].contains(&signal)) {
                return Self::Stopped;
            }
        }
        status.code().and_then(|code| u8::try_from(code).ok()).map_or(Self::Killed, Self::Code)
    }
}

/// Returns true in a rank, and false in its guard.
pub fn is_there() -> bool {
    std::env::var_os(GUARDED).is_some()
}

/// Starts the rank, waits for its end, and returns its exit code.
///
/// # Errors
/// When no process can be started.
pub fn watch() -> Result<u8> {
    let tie: Arc<Mutex<Option<ChildStdin>>> = Arc::default();
    let ask = {
        let tie = Arc::clone(&tie);
        move || {
            if let Some(tie) = &mut *tie.lock().unwrap_or_else(PoisonError::into_inner) {
                // The write fails if the rank has ended, which needs no message.
                let _ = tie.write_all(b".");
            }
        }
    };
    // Some launchers send a signal to all processes of a rank, others only to the guard.
    let signalled = interrupt::outlive(ask.clone())?;
    let cannot = |error| Error::device(format!("cannot start the process of a rank: {error}"));
    let mut process = std::env::current_exe()
        .and_then(|program| {
            Command::new(program)
                .args(std::env::args_os().skip(1))
                .env(GUARDED, "1")
                .stdin(Stdio::piped())
                .spawn()
        })
        .map_err(cannot)?;
    *tie.lock().unwrap_or_else(PoisonError::into_inner) = process.stdin.take();
    if signalled.load(Ordering::SeqCst) {
        ask();
    }
    let status = process.wait().map_err(cannot)?;
    let rank = trimip_mpi::launched().id;
    Ok(match End::of(status) {
        End::Code(code) => code,
        End::Stopped => interrupt::EXIT_CODE,
        // After asking a rank to stop, a launcher waits for a while and then kills the rank.
        End::Killed if signalled.load(Ordering::SeqCst) => {
            terminal::aside(format!("warning: rank {rank} was killed while it stopped ({status})"));
            KILLED
        }
        End::Killed => {
            terminal::error(&Error::device(format!(
                "rank {rank} was killed ({status}); if the machine ran out of memory, give it fewer ranks; the same command \
                 resumes from the last checkpoint"
            )));
            KILLED
        }
    })
}

/// Stops this rank when its guard sends a byte, and kills it when the guard is gone. This is needed because a launcher kills only the
/// process that it started, which is the guard.
///
/// # Errors
/// When no thread can be started.
pub fn heed() -> Result<()> {
    let tie = || {
        let mut guard = std::io::stdin().lock();
        let mut byte = [0];
        while guard.read_exact(&mut byte).is_ok() {
            interrupt::ask();
        }
        #[cfg(unix)]
        let _ = nix::sys::signal::raise(nix::sys::signal::SIGKILL);
        std::process::abort();
    };
    let started = std::thread::Builder::new().name("guard".into()).spawn(tie);
    started.map(drop).map_err(|error| Error::device(format!("cannot start a thread: {error}")))
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;

    #[test]
    fn an_end_is_a_code_a_stop_or_a_kill() {
        let end = |script: &str| End::of(Command::new("sh").args(["-c", script]).status().unwrap());
        assert_eq!(end("exit 0"), End::Code(0));
        assert_eq!(end("exit 130"), End::Code(130));
        assert_eq!(end("kill -TERM $$"), End::Stopped);
        assert_eq!(end("kill -INT $$"), End::Stopped);
        assert_eq!(end("kill -KILL $$"), End::Killed);
        assert_eq!(end("kill -SEGV $$"), End::Killed);
    }
}
