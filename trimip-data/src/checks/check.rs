//! The result of a check: its figure, its limit, its conclusion and the views beyond the limit.

use super::views::name;
use trimip_core::ViewSet;

/// Conclusion of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Verdict {
    /// Nothing is beyond a limit.
    Fine,
    /// Something is beyond a limit; the text says what to do.
    Suspicious(&'static str),
    /// The data do not allow the check.
    Unknown,
}

/// A training view beyond a limit.
#[derive(Clone, Debug, PartialEq)]
pub struct Suspect {
    /// Index among the views of the finest scale.
    pub view: usize,
    /// Its measured value, in words.
    pub figure: String,
}

/// A quantity that was measured for each training view.
#[derive(Clone, Debug, PartialEq)]
pub struct Values {
    /// Name of the quantity, with its unit.
    pub name: &'static str,
    /// One value per view of the finest scale; `None` where it is unknown.
    pub of: Vec<Option<f64>>,
}

/// The result of a check.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// Name of the check.
    pub name: &'static str,
    /// The measurement, in words.
    pub figure: String,
    /// The condition that would be suspicious, with the reason.
    pub limit: String,
    /// The conclusion.
    pub verdict: Verdict,
    /// Views beyond a limit, the worst first.
    pub suspects: Vec<Suspect>,
    /// Quantities measured for all views, if there are any.
    pub values: Vec<Values>,
}

/// Most views named in a warning.
const NAMED: usize = 4;

impl Check {
    /// Creates the result of a check that the data do not allow; the figure is the reason.
    pub(super) fn unknown(name: &'static str, limit: String, reason: &str) -> Self {
        let verdict = Verdict::Unknown;
        Self { name, figure: reason.into(), limit, verdict, suspects: Vec::new(), values: Vec::new() }
    }

    /// Returns the warning of a suspicious check, in one line; `train` holds the names of the views.
    pub fn warning(&self, train: &ViewSet) -> Option<String> {
        let Verdict::Suspicious(advice) = self.verdict else { return None };
        let named = |suspect: &Suspect| Some(format!("{} ({})", name(train, suspect.view)?, suspect.figure));
        let mut names: Vec<String> = self.suspects.iter().take(NAMED).filter_map(named).collect();
        if self.suspects.len() > NAMED {
            names.push(format!("{} more", self.suspects.len() - NAMED));
        }
        let views = if names.is_empty() { String::new() } else { format!(": {}", names.join(", ")) };
        Some(format!("{}: {}{views}; {advice}", self.name, self.figure))
    }
}
