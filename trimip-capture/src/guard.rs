//! The guard: a process between this program and a program that it calls. When this program ends, for whatever reason, the guard ends the
//! called program and all processes that it started. The guard notices the end by a pipe, which closes together with this program. The
//! guard and its program form a process group of their own, so Ctrl-C in a terminal reaches only this program, which then ends the group.

use std::{
    ffi::OsString,
    io::Read,
    path::{Path, PathBuf},
    process::{Command, ExitStatus, Stdio},
    sync::OnceLock,
    thread,
};
use trimip::{Error, Result};

/// The program that acts as the guard, and its first arguments.
static PROGRAM: OnceLock<(PathBuf, Vec<OsString>)> = OnceLock::new();

/// Environment variable that is set in the guard process.
const GUARD: &str = "TRIMIP_GUARDS_A_PROGRAM";

/// Exit code of a guard whose program cannot be started, by shell convention.
pub(crate) const NOT_STARTED: u8 = 127;

/// Sets the program that acts as the guard. It is called with `arguments`, followed by the path of the guarded program and its arguments.
/// The default is this program itself. The main function of such a program must call [`run`] before anything else if [`is_one`] is true.
pub fn set_program(program: PathBuf, arguments: Vec<OsString>) {
    PROGRAM.get_or_init(|| (program, arguments));
}

/// Returns a command for a guarded program; the caller adds its arguments. The program may run as long as the pipe to the command's
/// standard input is open.
///
/// # Errors
/// When the path of this program cannot be determined.
pub(crate) fn command(program: &Path) -> Result<Command> {
    let (own, arguments) = match PROGRAM.get() {
        Some((own, arguments)) => (own.clone(), &arguments[..]),
        None => {
            let own = std::env::current_exe();
            let unknown = |error| Error::device(format!("cannot find the path of this program: {error}"));
            (own.map_err(unknown)?, &[][..])
        }
    };
    let mut command = Command::new(own);
    command.args(arguments).arg(program).env(GUARD, "1").stdin(Stdio::piped());
    #[cfg(unix)]
    std::os::unix::process::CommandExt::process_group(&mut command, 0);
    Ok(command)
}

/// Returns true if this process is a guard.
pub fn is_one() -> bool {
    std::env::var_os(GUARD).is_some()
}

/// Runs the program given by `words` (its path, then its arguments). Returns the program's exit code, or 128 + the signal that ended it.
pub fn run(words: impl IntoIterator<Item = OsString>) -> u8 {
    let mut words = words.into_iter();
    let Some(program) = words.next() else { return NOT_STARTED };
    let mut command = Command::new(&program);
    command.args(words).env_remove(GUARD).stdin(Stdio::null());
    let mut child = match command.spawn() {
        Ok(child) => child,
        Err(error) => {
            eprintln!("{}: {error}", program.to_string_lossy());
            return NOT_STARTED;
        }
    };
    let id = child.id();
    let tie = move || {
        // Nothing is ever written to the pipe: the read returns when the pipe closes.
        let _ = std::io::stdin().lock().read(&mut [0]);
        end_group(id);
    };
    if thread::Builder::new().name("tie".into()).spawn(tie).is_err() {
        let _ = child.kill();
        return NOT_STARTED;
    }
    child.wait().map_or(NOT_STARTED, code)
}

/// Returns the exit code of a program, or 128 + the signal that ended it.
fn code(status: ExitStatus) -> u8 {
    #[cfg(unix)]
    {
        use std::os::unix::process::ExitStatusExt;
        if let Some(signal) = status.signal() {
            return 128_u8.wrapping_add(signal as u8);
        }
    }
    // Windows uses larger codes for programs that the system ends. They must not wrap to 0, which means success.
    status.code().map_or(255, |code| u8::try_from(code).unwrap_or(255))
}

/// Ends the whole process group, including the guard.
#[cfg(unix)]
fn end_group(_: u32) {
    use nix::{
        sys::signal::{Signal, kill},
        unistd::Pid,
    };
    let _ = kill(Pid::from_raw(0), Signal::SIGKILL);
}

/// Ends the program with all processes that it started, and then the guard.
#[cfg(not(unix))]
fn end_group(id: u32) {
    let mut command = Command::new("taskkill");
    command.args(["/T", "/F", "/PID", &id.to_string()]).stdout(Stdio::null()).stderr(Stdio::null());
    let _ = command.status();
    std::process::exit(1);
}
