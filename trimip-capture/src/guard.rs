//! The process between this program and another that it calls. It ends that one, with all that it started, once this program is
//! gone, however it ended: a pipe ties the two, and its end is the sign. Both are in a group of processes of their own, so Ctrl-C of
//! a terminal reaches this program alone, which then ends the group.

use std::{
    ffi::OsString,
    io::Read,
    path::{Path, PathBuf},
    process::{Command, ExitStatus, Stdio},
    sync::OnceLock,
    thread,
};
use trimip::{Error, Result};

/// The program that becomes a guard, and its first arguments.
static PROGRAM: OnceLock<(PathBuf, Vec<OsString>)> = OnceLock::new();

/// Set in the environment of a guard.
const GUARD: &str = "TRIMIP_GUARDS_A_PROGRAM";

/// Exit code of a guard whose program cannot be started, by the convention of shells.
pub(crate) const NOT_STARTED: u8 = 127;

/// Makes `program`, called with `arguments` and the words of a guarded program, the guard. By default it is this program. What becomes
/// one calls [`run`] first of all where [`is_one`].
pub fn set_program(program: PathBuf, arguments: Vec<OsString>) {
    PROGRAM.get_or_init(|| (program, arguments));
}

/// A guarded program, to which arguments are added. While the pipe to its standard input is open it may run.
///
/// # Errors
/// When this program does not know its own path.
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

/// True in a guard.
pub fn is_one() -> bool {
    std::env::var_os(GUARD).is_some()
}

/// Runs the program that `words` name, with its arguments, and returns its exit code: 128 + the signal where one ended it.
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
        // Nobody writes: the read ends with the pipe.
        let _ = std::io::stdin().lock().read(&mut [0]);
        end_group(id);
    };
    if thread::Builder::new().name("tie".into()).spawn(tie).is_err() {
        let _ = child.kill();
        return NOT_STARTED;
    }
    child.wait().map_or(NOT_STARTED, code)
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
