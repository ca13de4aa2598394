//! The error type of the workspace. Its kind is the cause: the user's input, the run, the device, or a stop. A message is
//! one line: what was found, where, and what to do.

/// Exit code of a program that was stopped: 128 + SIGINT, the shell convention.
pub const STOPPED: u8 = 130;

/// Cause of an [`Error`]; determines the exit code of the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[non_exhaustive]
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

impl ErrorKind {
    /// 1 the run failed, 2 the input is wrong, 3 the device failed, 130 the user stopped the program.
    pub fn exit_code(self) -> u8 {
        match self {
            Self::Run => 1,
            Self::Input => 2,
            Self::Device => 3,
            Self::Stopped => STOPPED,
        }
    }
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
        Self { kind: ErrorKind::Input, message: format!("{}: {}; {}", told(place), told(what), told(advice)) }
    }

    /// The run failed with valid input.
    pub fn run(message: impl std::fmt::Display) -> Self {
        Self { kind: ErrorKind::Run, message: told(message) }
    }

    /// The device failed.
    pub fn device(message: impl std::fmt::Display) -> Self {
        Self { kind: ErrorKind::Device, message: told(message) }
    }

    /// The user stopped the program before it changed anything.
    pub fn stopped() -> Self {
        let message = "stopped before anything was changed; the same command begins again";
        Self { kind: ErrorKind::Stopped, message: message.into() }
    }

    /// The exit code of the error's kind.
    pub fn exit_code(&self) -> u8 {
        self.kind.exit_code()
    }
}

/// Largest number of characters of a part of a message. Paths and lists of names are shorter; a longer part is a value of
/// a user or a file, and its ends suffice.
const MOST: usize = 600;

/// A part of a message: one line, shortened, and without characters that act on a terminal. Messages of other libraries
/// may span lines.
fn told(part: impl std::fmt::Display) -> String {
    let text = part.to_string();
    let lines = text.split(['\n', '\r']).map(str::trim).filter(|line| !line.is_empty());
    let line = lines.collect::<Vec<_>>().join(" ");
    let length = line.chars().count();
    let kept =
        line.chars().enumerate().filter(|(i, _)| length <= MOST || *i < MOST / 2 || *i >= length - MOST / 4);
    let mut told = String::new();
    for (i, character) in kept {
        if length > MOST && i == length - MOST / 4 {
            told += &format!(" .. ({length} characters) .. ");
        }
        // Control characters are escaped, and those that change the direction of the text.
        match character.is_control() || matches!(character, '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}')
        {
            true => told.extend(character.escape_unicode()),
            false => told.push(character),
        }
    }
    told
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_message_is_one_short_line_without_control_characters() {
        let error = Error::input("a\n  b.toml", "\u{1b}[31mred\u{202e}\t", "x".repeat(100_000));
        assert!(error.message.starts_with("a b.toml: \\u{1b}[31mred\\u{202e}"), "{error}");
        assert!(error.message.contains("xx .. (100000 characters) .. xx"), "{error}");
        assert!(error.message.chars().count() < 700 && !error.message.contains(char::is_control), "{error}");
        assert_eq!(Error::run("60 % of ×").message, "60 % of ×");
    }
}
