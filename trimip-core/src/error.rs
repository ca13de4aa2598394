//! The error type of the workspace. Its kind tells the cause: the user's input, the run, the device, or a stop.
//! A message is one line: what was found, where, and what to do.

/// Exit code of a program that was stopped: 128 + SIGINT, the shell convention.
pub const STOPPED: u8 = 130;

/// Cause of an [`Error`]; determines the exit code of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ErrorKind {
    /// The user's files, settings or arguments are wrong (exit code 2).
    Input,
    /// The run failed, or missed its quality floor (exit code 1).
    Run,
    /// The device is missing, too small or lost (exit code 3).
    Device,
    /// The user stopped the program before it changed anything (exit code [`STOPPED`]).
    Stopped,
}

/// An error: its cause and one line of text.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{message}")]
pub struct Error {
    /// The cause.
    pub kind: ErrorKind,
    /// What, where, what to do.
    pub message: String,
}

/// Result type of the workspace.
pub type Result<T> = std::result::Result<T, Error>;

impl Error {
    /// The user's input is wrong: `place` (file, line, frame, key) has `what`; `advice` says what to do.
    pub fn input(
        place: impl std::fmt::Display,
        what: impl std::fmt::Display,
        advice: impl std::fmt::Display,
    ) -> Self {
        Self { kind: ErrorKind::Input, message: one_line(format!("{place}: {what}; {advice}")) }
    }

    /// The run failed with valid input.
    pub fn run(message: impl std::fmt::Display) -> Self {
        Self { kind: ErrorKind::Run, message: one_line(message.to_string()) }
    }

    /// The device failed.
    pub fn device(message: impl std::fmt::Display) -> Self {
        Self { kind: ErrorKind::Device, message: one_line(message.to_string()) }
    }

    /// The user stopped the program before it changed anything.
    pub fn stopped() -> Self {
        let message = "stopped before anything was changed; the same command begins again";
        Self { kind: ErrorKind::Stopped, message: message.into() }
    }

    /// 1 the run failed, 2 the input is wrong, 3 the device failed, 130 the user stopped the program.
    pub fn exit_code(&self) -> u8 {
        match self.kind {
            ErrorKind::Run => 1,
            ErrorKind::Input => 2,
            ErrorKind::Device => 3,
            ErrorKind::Stopped => STOPPED,
        }
    }
}

/// Messages of other libraries may span lines; errors here are one line.
fn one_line(text: String) -> String {
    text.split('\n').map(str::trim).filter(|line| !line.is_empty()).collect::<Vec<_>>().join(" ")
}
