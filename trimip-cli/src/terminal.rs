//! Lines to the user. A reader that goes away (`| head`) ends no run: failed writes to standard streams are dropped.

use std::io::{IsTerminal, Write};
use trimip_core::Error;

/// One line on standard output.
pub fn line(text: impl std::fmt::Display) {
    let _ = writeln!(std::io::stdout().lock(), "{text}");
}

/// One line on standard error for someone who watches; silent where nobody does.
pub fn note(text: impl std::fmt::Display) {
    if watched() {
        let _ = writeln!(std::io::stderr().lock(), "{text}");
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

/// `1.5 GB`: bytes in decimal units, as disks and papers count.
pub fn bytes(count: u64) -> String {
    number(count as f64, "B")
}

/// `92.5 M`: a large count with a decimal prefix and a unit.
pub fn number(value: f64, unit: &str) -> String {
    let (mut value, mut prefix) = (value, "");
    for next in ["k", "M", "G", "T"] {
        if value.abs() < 999.5 {
            break;
        }
        (value, prefix) = (value / 1e3, next);
    }
    let digits = if prefix.is_empty() || value.abs() >= 99.95 {
        0
    } else if value.abs() >= 9.995 {
        1
    } else {
        2
    };
    // A symbol joins its prefix (MB), a word stands apart (M samples).
    let gap = if unit.len() > 1 && !prefix.is_empty() { " " } else { "" };
    format!("{value:.digits$} {prefix}{gap}{unit}").trim_end().to_string()
}

/// `4 min 03 s`: a duration for people.
pub fn duration(seconds: f64) -> String {
    if !seconds.is_finite() {
        return "unknown".into();
    }
    let whole = seconds.round() as u64;
    match whole {
        0..10 => format!("{seconds:.1} s"),
        10..60 => format!("{whole} s"),
        60..3600 => format!("{} min {:02} s", whole / 60, whole % 60),
        _ => format!("{} h {:02} min", whole / 3600, whole / 60 % 60),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_keep_three_figures() {
        assert_eq!(bytes(48_200_000), "48.2 MB");
        assert_eq!(bytes(0), "0 B");
        assert_eq!(number(999_999.0, ""), "1.00 M");
        assert_eq!(number(123.0, "samples/s"), "123 samples/s");
    }

    #[test]
    fn durations_are_read_at_a_glance() {
        assert_eq!(duration(3.26), "3.3 s");
        assert_eq!(duration(243.2), "4 min 03 s");
        assert_eq!(duration(7260.0), "2 h 01 min");
        assert_eq!(duration(f64::NAN), "unknown");
    }
}
