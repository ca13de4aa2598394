//! Lines to the user: wrapped to a terminal's width, whole elsewhere. A reader that goes away (`| head`) ends no run: failed
//! writes to standard streams are dropped.

use std::io::{IsTerminal, Write};
use trimip::Error;
pub use trimip::units::{bytes, count, duration, many, number};

/// Columns of a terminal that does not tell its width.
const USUAL_WIDTH: usize = 80;

/// Columns that text is wrapped to at least, however narrow the terminal.
const LEAST_WIDTH: usize = 40;

/// Columns that the further lines of a wrapped text begin at.
const INDENT: usize = 4;

/// One line on standard output.
pub fn line(text: impl std::fmt::Display) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

/// Sentences on standard output, wrapped to the width of a terminal; one line elsewhere.
pub fn prose(text: impl std::fmt::Display) {
    match width(&console::Term::stdout()) {
        Some(width) => line(wrapped(&text.to_string(), width)),
        None => line(text),
    }
}

/// Sentences on standard error for someone who watches; silent where nobody does.
pub fn note(text: impl std::fmt::Display) {
    if watched() {
        let width = width(&console::Term::stderr()).unwrap_or(USUAL_WIDTH);
        let _ = writeln!(std::io::stderr().lock(), "{}", wrapped(&text.to_string(), width));
    }
}

/// One line on standard error, for people and logs; standard output stays what a program reads.
pub fn aside(text: impl std::fmt::Display) {
    let _ = writeln!(std::io::stderr().lock(), "{text}");
}

/// The one line that says why the program failed.
pub fn error(error: &Error) {
    let _ = writeln!(std::io::stderr().lock(), "error: {error}");
}

/// True when a person watches both streams: then a bar and tables, else one JSON object a line.
pub fn watched() -> bool {
    std::io::stdout().is_terminal() && std::io::stderr().is_terminal()
}

/// Columns of a terminal; `None` where the stream is none.
fn width(terminal: &console::Term) -> Option<usize> {
    let told = || terminal.size_checked().map_or(USUAL_WIDTH, |(_, columns)| columns.into());
    terminal.is_term().then(|| told().max(LEAST_WIDTH))
}

/// Text in lines of at most `width` characters, broken between words, further lines indented. A word that no line holds
/// (a path) is left whole; spaces within a line stay as they are.
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
        let text = "evaluation: 4 times on the way on 4 of 12 test views, at the end on 12 of 12 test views; fails below";
        for width in 40..=110 {
            let wrapped = wrapped(text, width);
            let lines: Vec<&str> = wrapped.lines().collect();
            assert!(lines.iter().all(|line| line.chars().count() <= width), "{width}: {wrapped}");
            assert!(lines[1..].iter().all(|line| line.starts_with("    ") && !line.starts_with("     ")));
            assert_eq!(lines.iter().map(|line| line.trim()).collect::<Vec<_>>().join(" "), text);
            // A line is broken where the next word has no room, not before.
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
