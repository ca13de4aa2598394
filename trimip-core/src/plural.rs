//! Counts with their nouns, for messages: `1 view`, `12 views`.

use std::fmt::Display;

/// Returns a noun whose plural ends in s for a count: `view` for 1, `views` for all other counts.
pub fn noun<N: PartialEq + From<u8>>(count: N, singular: &str) -> String {
    if count == N::from(1) { singular.into() } else { format!("{singular}s") }
}

/// Returns a count with a noun whose plural ends in s: `1 view`, `12 views`.
pub fn count<N: Copy + Display + PartialEq + From<u8>>(count: N, singular: &str) -> String {
    format!("{count} {}", noun(count, singular))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn one_thing_has_no_s() {
        assert_eq!([0_u64, 1, 2].map(|n| count(n, "view")), ["0 views", "1 view", "2 views"]);
        assert_eq!([0_usize, 1, 2].map(|n| noun(n, "scale")), ["scales", "scale", "scales"]);
    }
}
