//! The origin of a run: its command line, the version that ran it, and its end time.

use crate::machine;
use std::ffi::OsString;
use std::path::Path;
use std::time::{SystemTime, UNIX_EPOCH};
use trimip_core::engine::events::Provenance;

/// Returns the provenance of this process, for a test split of `test_views` views.
pub fn here_and_now(test_views: usize) -> Provenance {
    Provenance {
        command: Some(command(std::env::args_os())),
        version: Some(machine::version()),
        ended_unix: SystemTime::now().duration_since(UNIX_EPOCH).ok().map(|since| since.as_secs()),
        test_views: Some(test_views),
    }
}

/// Returns arguments as a shell command line. The program is given by name, without its folder.
fn command(arguments: impl Iterator<Item = OsString>) -> String {
    let words = arguments.enumerate().map(|(i, word)| match i {
        0 => quoted(&Path::new(&word).file_stem().unwrap_or(&word).to_string_lossy()),
        _ => quoted(&word.to_string_lossy()),
    });
    words.collect::<Vec<_>>().join(" ")
}

/// Puts a word in single quotes if a shell would interpret it.
fn quoted(word: &str) -> String {
    let plain = |c: char| c.is_alphanumeric() || "-_./=:,+@%".contains(c);
    if !word.is_empty() && word.chars().all(plain) {
        return word.into();
    }
    format!("'{}'", word.replace('\'', "'\\''"))
}

/// Formats seconds since the beginning of 1970 as `2024-02-29 13:05 UTC` (days to civil date after H. Hinnant,
/// chrono-Compatible Low-Level Date Algorithms).
pub fn date(unix: u64) -> String {
    let days = unix / 86_400 + 719_468;
    let era = days / 146_097;
    let day_of_era = days % 146_097;
    let year_of_era = (day_of_era - day_of_era / 1460 + day_of_era / 36_524 - day_of_era / 146_096) / 365;
    let day_of_year = day_of_era - (365 * year_of_era + year_of_era / 4 - year_of_era / 100);
    // The year begins in March, so the leap day is its last day.
    let march = (5 * day_of_year + 2) / 153;
    let day = day_of_year - (153 * march + 2) / 5 + 1;
    let month = if march < 10 { march + 3 } else { march - 9 };
    let year = 400 * era + year_of_era + u64::from(month <= 2);
    let minutes = unix % 86_400 / 60;
    format!("{year}-{month:02}-{day:02} {:02}:{:02} UTC", minutes / 60, minutes % 60)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_reads_the_recorded_command_as_it_was_typed() {
        let words = ["/opt/bin/trimip-cli", "--set", "train.steps=30", "a b", "it's", ""];
        let line = command(words.into_iter().map(OsString::from));
        assert_eq!(line, r"trimip-cli --set train.steps=30 'a b' 'it'\''s' ''");
    }

    #[test]
    fn dates_are_those_of_the_calendar() {
        assert_eq!(date(0), "1970-01-01 00:00 UTC");
        assert_eq!(date(951_827_696), "2000-02-29 12:34 UTC");
        assert_eq!(date(1_735_689_599), "2024-12-31 23:59 UTC");
        assert_eq!(date(4_107_542_400), "2100-03-01 00:00 UTC");
    }
}
