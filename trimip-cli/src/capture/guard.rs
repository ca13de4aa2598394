//! The process between this program and another that it calls. It ends that one, with all that it started, once this program is
//! gone, however it ended: a pipe ties the two, and its end is the sign. Both are in a group of processes of their own, so Ctrl-C of
//! a terminal reaches this program alone, which then ends the group.

use std::{
    io::Read,
    path::Path,
    process::{Command, ExitCode, ExitStatus, Stdio},
    thread,
};
use trimip::{Error, Result};

/// Set in the environment of a guard.
const GUARD: &str = "TRIMIP_GUARDS_A_PROGRAM";

/// Exit code of a guard whose program cannot be started, by the convention of shells.
pub const NOT_STARTED: u8 = 127;

/// A guarded program, to which arguments are added. While the pipe to its standard input is open it may run.
///
/// # Errors
/// When this program does not know its own path.
pub fn command(program: &Path) -> Result<Command> {
    let own = std::env::current_exe()
        .map_err(|error| Error::device(format!("cannot find the path of this program: {error}")))?;
    let mut command = Command::new(own);
    command.arg(program).env(GUARD, "1").stdin(Stdio::piped());
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    Ok(command)
}

/// True in a guard.
pub fn is_one() -> bool {
    std::env::var_os(GUARD).is_some()
}

/// Runs the program that the arguments name, and returns its exit code: 128 + the signal where one ended it.
pub fn run() -> ExitCode {
    let mut words = std::env::args_os().skip(1);
    let Some(program) = words.next() else { return ExitCode::from(NOT_STARTED) };
    let mut command = Command::new(&program);
    command.args(words).env_remove(GUARD).stdin(Stdio::null());
    let mut child = match command.spawn() {
        Ok(child) => child,
        Err(error) => {
            crate::terminal::aside(format!("{}: {error}", program.to_string_lossy()));
            return ExitCode::from(NOT_STARTED);
        }
    };
    let id = child.id();
    let tie = move || {
        // Nobody writes: the read ends with the pipe.
        let _ = std::io::stdin().lock().read(&mut [0]);
        end_group(id);
    };
    if thread::Builder::new().name("tie".into()).spawn(tie).is_err() {
        let _ = child.kill();
        return ExitCode::from(NOT_STARTED);
    }
    child.wait().map_or(ExitCode::from(NOT_STARTED), |status| ExitCode::from(code(status)))
}

/// The exit code of a program, or 128 + the signal that ended it.
fn code(status: ExitStatus) -> u8 {
    #[cfg(unix)]
    {
        use std::os::unix::process::ExitStatusExt;
        if let Some(signal) = status.signal() {
            return 128_u8.wrapping_add(signal as u8);
        }
    }
    // Windows has larger codes for what a system ends; they are no success.
    status.code().map_or(255, |code| u8::try_from(code).unwrap_or(255))
}

/// Ends the whole group, the guard with it.
#[cfg(unix)]
fn end_group(_: u32) {
    use nix::{
        sys::signal::{Signal, kill},
        unistd::Pid,
    };
    let _ = kill(Pid::from_raw(0), Signal::SIGKILL);
}

/// Ends the program with all that it started, and the guard.
#[cfg(not(unix))]
fn end_group(id: u32) {
    let mut command = Command::new("taskkill");
    command.args(["/T", "/F", "/PID", &id.to_string()]).stdout(Stdio::null()).stderr(Stdio::null());
    let _ = command.status();
    std::process::exit(1);
}
