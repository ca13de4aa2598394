//! Files of numbers separated by blanks, such as matrices and trajectories.

use std::path::Path;
use trimip_core::{Error, Place, Result, text};

/// Reads the lines of numbers of a file, without empty lines. `advice` says what to do if the file cannot be read.
///
/// # Errors
/// Of kind `Input`, with the line, if a word is not a finite number.
pub(crate) fn lines(path: &Path, advice: &str) -> Result<Vec<Vec<f64>>> {
    of_text(path, &text::read(path, advice)?, advice)
}

/// Parses the bytes of a file as [`lines`] does.
///
/// # Errors
/// As [`lines`], and if the bytes are not UTF-8.
pub(crate) fn parse(path: &Path, bytes: &[u8], advice: &str) -> Result<Vec<Vec<f64>>> {
    of_text(path, &text::of_bytes(path, bytes)?, advice)
}

fn of_text(path: &Path, text: &str, advice: &str) -> Result<Vec<Vec<f64>>> {
    let line = |(index, line): (usize, &str)| {
        let place = || Place::line(path, index + 1);
        line.split_ascii_whitespace()
            .map(|word| number(word).map_err(|what| Error::input(place(), what, advice)))
            .collect::<Result<Vec<f64>>>()
    };
    text.lines().enumerate().filter(|(_, line)| !line.trim_ascii().is_empty()).map(line).collect()
}

/// Parses a finite number. The error describes what is wrong.
pub(crate) fn number(word: &str) -> std::result::Result<f64, String> {
    let value = word.parse().ok().filter(|value: &f64| value.is_finite());
    value.ok_or_else(|| format!("\"{}\" is not a finite number", word.chars().take(40).collect::<String>()))
}
