//! Numbers formatted for people: counts, bytes and large numbers with a prefix, durations.

pub use trimip_core::plural::count;

/// Formats a large count with a noun whose plural ends in s: `1 pixel`, `92.5 M pixels`.
pub fn many(count: u64, thing: &str) -> String {
    if count == 1 { self::count(count, thing) } else { number(count as f64, &format!("{thing}s")) }
}

/// Formats bytes in decimal units, as on disks and in papers: `1.5 GB`.
pub fn bytes(count: u64) -> String {
    number(count as f64, "B")
}

/// Formats a large count with a decimal prefix and a unit: `92.5 M`.
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
    // A symbol joins its prefix (MB). A word is separated by a space (M samples).
    let gap = if unit.len() > 1 && !prefix.is_empty() { " " } else { "" };
    format!("{value:.digits$} {prefix}{gap}{unit}").trim_end().to_string()
}

/// Formats a duration: `4 min 03 s`.
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
    fn large_counts_have_a_prefix_and_one_thing_has_no_s() {
        assert_eq!([1, 1_000_000].map(|n| many(n, "pixel")), ["1 pixel", "1.00 M pixels"]);
    }

    #[test]
    fn durations_are_read_at_a_glance() {
        assert_eq!(duration(3.26), "3.3 s");
        assert_eq!(duration(243.2), "4 min 03 s");
        assert_eq!(duration(7260.0), "2 h 01 min");
        assert_eq!(duration(f64::NAN), "unknown");
    }
}
