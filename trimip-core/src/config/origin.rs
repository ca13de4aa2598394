//! Where values of settings come from.

use serde::{Deserialize, Serialize};

/// Source of an effective value.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Origin {
    /// The table of defaults.
    Default,
    /// A configuration file: `file:line:column`.
    File(String),
    /// The command line.
    CommandLine,
    /// A program that uses the library.
    Code,
    /// The scene plan.
    Plan,
}

impl std::fmt::Display for Origin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Default => f.write_str("default"),
            Self::File(place) => f.write_str(place),
            Self::CommandLine => f.write_str("command line"),
            Self::Code => f.write_str("settings"),
            Self::Plan => f.write_str("scene plan"),
        }
    }
}

/// Parses the text that [`Display`](std::fmt::Display) writes.
impl From<&str> for Origin {
    fn from(text: &str) -> Self {
        let known = [Self::Default, Self::CommandLine, Self::Code, Self::Plan];
        // Reports of earlier versions name the command line `--set`.
        let text = if text == "--set" { "command line" } else { text };
        let found = known.into_iter().find(|origin| origin.to_string() == text);
        found.unwrap_or_else(|| Self::File(text.into()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_are_read_back() {
        let file = Origin::File("run.toml:3:1".into());
        for origin in [Origin::Default, file, Origin::CommandLine, Origin::Code, Origin::Plan] {
            assert_eq!(Origin::from(&*origin.to_string()), origin);
        }
    }
}
