//! Output to the user. On a terminal it is wrapped to the terminal's width. A failed write to standard output does not end a run. It is
//! reported when the program ends, unless the reader closed the pipe (`| head`).

use std::io::{ErrorKind, IsTerminal, Write};
use std::sync::OnceLock;
pub use trimip::formatting::{bytes, count, duration, many, number};
use trimip::{Error, Result};

/// Width that is assumed for a terminal that reports none, columns.
const USUAL_WIDTH: usize = 80;

/// Minimum wrap width, columns.
const LEAST_WIDTH: usize = 40;

/// Indentation of the continuation lines of wrapped text, columns.
const INDENT: usize = 4;

/// The first failed write to standard output.
static UNPRINTED: OnceLock<std::io::Error> = OnceLock::new();

/// Prints one line on standard output.
pub fn line(text: impl std::fmt::Display) {
    note_failure(writeln!(std::io::stdout().lock(), "{text}"));
}

/// Succeeds if all lines on standard output were written.
///
/// # Errors
/// When a line was not written, unless the reason is a closed pipe.
pub fn printed() -> Result<()> {
    note_failure(std::io::stdout().flush());
    match UNPRINTED.get() {
        Some(error) if error.kind() != ErrorKind::BrokenPipe => Err(Error::input(
            "standard output",
            format!("cannot write: {error}"),
            "redirect it to a place with free space, and run the command again",
        )),
        _ => Ok(()),
    }
}

/// Stores the first failure to write to standard output, for [`printed`].
pub fn note_failure(written: std::io::Result<()>) {
    if let Err(error) = written {
        let _ = UNPRINTED.set(error);
    }
}

/// Prints prose on standard output, wrapped to the width of a terminal. If the output is not a terminal, prints one line.
pub fn prose(text: impl std::fmt::Display) {
    match width(&console::Term::stdout()) {
        Some(width) => line(wrapped(&text.to_string(), width)),
        None => line(text),
    }
}

/// Prints prose on standard error if both outputs are terminals, otherwise nothing.
pub fn note(text: impl std::fmt::Display) {
    if watched() {
        let width = width(&console::Term::stderr()).unwrap_or(USUAL_WIDTH);
        let _ = writeln!(std::io::stderr().lock(), "{}", wrapped(&text.to_string(), width));
    }
}

/// Prints one line on standard error, for people and logs. Standard output stays machine-readable.
pub fn aside(text: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// Prints the line that states why the program failed.
pub fn error(error: &Error) {
    let _ = writeln!(std::io::stderr().lock(), "error: {}", crate::wording::text(error));
}

/// Returns true if standard output and standard error are terminals. The program then shows a bar and tables, otherwise one JSON object per
/// line.
pub fn watched() -> bool {
    std::io::stdout().is_terminal() && std::io::stderr().is_terminal()
}

/// Returns the width of a terminal in columns; `None` if the stream is not a terminal.
fn width(terminal: &console::Term) -> Option<usize> {
    let told = || terminal.size_checked().map_or(USUAL_WIDTH, |(_, columns)| columns.into());
    terminal.is_term().then(|| told().max(LEAST_WIDTH))
}

/// Wraps text to lines of at most `width` characters at word boundaries, with continuation lines indented. A word (a path) longer than a
/// line is not split; spaces within a line are kept.
pub fn wrapped(text: &str, width: usize) -> String {
    let length = |text: &str| text.chars().count();
    let mut lines = vec![String::new()];
    let mut gap = "";
    let mut rest = text.trim_end();
    while !rest.is_empty() {
        let word = &rest[..rest.find(' ').unwrap_or(rest.len())];
        rest = &rest[word.len()..];
        let (last, first) = (lines.len() - 1, lines.len() == 1);
        let empty = if first { lines[last].is_empty() } else { length(&lines[last]) <= INDENT };
        if !empty && length(&lines[last]) + length(gap) + length(word) > width {
            lines.push(" ".repeat(INDENT) + word);
        } else {
            lines[last] += gap;
            lines[last] += word;
        }
        gap = &rest[..rest.len() - rest.trim_start_matches(' ').len()];
        rest = &rest[gap.len()..];
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrapped_text_fits_and_keeps_its_words() {
        let text = "evaluation: 4 times during training on 4 of 12 test views, at the end on 12 of 12 test views; fails below";
        for width in 40..=110 {
            let wrapped = wrapped(text, width);
            let lines: Vec<&str> = wrapped.lines().collect();
            assert!(lines.iter().all(|line| line.chars().count() <= width), "{width}: {wrapped}");
            assert!(lines[1..].iter().all(|line| line.starts_with("    ") && !line.starts_with("     ")));
            assert_eq!(lines.iter().map(|line| line.trim()).collect::<Vec<_>>().join(" "), text);
            // A line breaks only if the next word does not fit.
            for pair in lines.windows(2) {
                let word = pair[1].split_whitespace().next().unwrap();
                assert!(pair[0].chars().count() + 1 + word.chars().count() > width, "{width}: {wrapped}");
            }
        }
        assert_eq!(wrapped(text, 200), text);
    }

    #[test]
    fn wrapping_keeps_columns_long_words_and_letters_of_several_bytes() {
        assert_eq!(wrapped("     12 s  step 3", 40), "     12 s  step 3");
        let path = "a/".repeat(30);
        assert_eq!(wrapped(&format!("folder: {path} end"), 40), format!("folder:\n    {path}\n    end"));
        assert_eq!(wrapped(&"×".repeat(40), 40), "×".repeat(40));
        assert_eq!(wrapped("", 40), "");
    }
}
