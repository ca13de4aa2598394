//! Decisions of the scene plan as they are printed and stored in `plan.json`.

use super::origin;
use crate::config::PlanChoice;
use serde::{Deserialize, Serialize};

/// A setting that a decision changed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Change {
    /// Its dotted path.
    pub path: String,
    /// Value before, as TOML.
    pub from: String,
    /// Value after.
    pub to: String,
}

/// One decision.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Finding {
    /// Key in `[plan]`.
    pub decision: String,
    /// The configured choice.
    pub choice: PlanChoice,
    /// True if something is left out.
    pub left_out: bool,
    /// The reason, and the saving if there is one.
    pub reason: String,
    /// The settings that changed.
    pub changes: Vec<Change>,
}

impl std::fmt::Display for Finding {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let verdict = match (self.left_out, self.changes.is_empty()) {
            (true, _) => "left out",
            (false, false) => "set",
            (false, true) => "kept",
        };
        let section = if self.decision == origin::KEY { "data" } else { "plan" };
        write!(f, "{section}.{}: {verdict}: {}", self.decision, self.reason)
    }
}
