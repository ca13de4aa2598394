//! The process that a launcher starts for a rank starts the program again, and that is the rank: a rank that is killed, by the
//! system that has no memory left or by a crash in a library, is then told as any other error. A launcher alone would end with
//! 128 + the signal.

use crate::{interrupt, terminal};
use std::process::{Command, Stdio};
use std::sync::atomic::Ordering;
use trimip_core::{Error, Result};

/// Set in the environment of a rank.
const GUARDED: &str = "TRIMIP_RANK_IS_GUARDED";

/// Exit code of a rank that was killed.
const KILLED: u8 = 3;

/// True in a rank; false in the process that a launcher started.
pub fn is_there() -> bool {
    std::env::var_os(GUARDED).is_some()
}

/// Starts the rank, waits for its end, and returns its exit code.
///
/// # Errors
/// When no process can be started.
pub fn watch() -> Result<u8> {
    // The rank gets the same signals, and decides what they mean.
    let signal = interrupt::outlive()?;
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
    // Open as long as this process lives.
    let _tie = process.stdin.take();
    let status = process.wait().map_err(cannot)?;
    if status.code().is_none() && !signal.load(Ordering::SeqCst) {
        terminal::error(&Error::device(format!(
            "rank {} was killed ({status}); if the machine ran out of memory, give it fewer ranks; the same command goes on from \
             the last checkpoint",
            trimip_mpi::launched().rank
        )));
    }
    Ok(status.code().map_or(KILLED, |code| code as u8))
}

/// Ends this rank when its guard is gone: a launcher kills the process that it knows.
///
/// # Errors
/// When no thread can be started.
pub fn heed() -> Result<()> {
    let tie = || {
        let _ = std::io::copy(&mut std::io::stdin().lock(), &mut std::io::sink());
        #[cfg(unix)]
        let _ = nix::sys::signal::raise(nix::sys::signal::SIGKILL);
        std::process::abort();
    };
    let started = std::thread::Builder::new().name("guard".into()).spawn(tie);
    started.map(drop).map_err(|error| Error::device(format!("cannot start a thread: {error}")))
}
