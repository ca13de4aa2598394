//! A decision of the scene plan: its inputs, its possible results, and its rule.

use super::facts::Facts;
use crate::config::PlanChoice;
use crate::{Config, Origin, Settings};
use toml::Value;

/// Inputs of a decision.
pub(super) struct Context<'a> {
    /// The settings with all decisions so far.
    pub(super) now: &'a Config,
    /// The settings as the user gave them.
    pub(super) configured: &'a Config,
    pub(super) facts: &'a Facts<'a>,
    /// The settings as layers, as the user gave them.
    pub(super) given: &'a Settings,
}

impl Context<'_> {
    /// Returns true for a setting that the user gave.
    pub(super) fn given(&self, path: &str) -> bool {
        *self.given.origin(path) != Origin::Default
    }

    /// Returns the expected number of kept samples: the target for a budget in steps, otherwise the number that this
    /// machine trains in the time.
    pub(super) fn budget(&self) -> f64 {
        let train = &self.now.train;
        match train.steps {
            0 => train.seconds * self.facts.compute.samples_per_second,
            steps => steps as f64 * f64::from(train.samples_per_step),
        }
    }
}

/// Result of a decision.
pub(super) enum Proposal {
    /// Nothing changes; holds the reason.
    Keep(String),
    /// The decision cannot be taken; holds the reason and advice.
    Unknown(String, &'static str),
    /// Settings derived from the data or the budget.
    Set { reason: String, changes: Vec<(&'static str, Value)> },
    /// Settings that drop what the scene does not need.
    LeaveOut { reason: String, changes: Vec<(&'static str, Value)> },
}

pub(super) type Decide = fn(&Context<'_>) -> Proposal;

/// A decision: its key, the settings it owns, and its rule. With `auto`, the decision is not taken if the user set one of
/// the settings it owns.
pub(super) struct Decision {
    pub(super) key: &'static str,
    pub(super) owns: &'static [&'static str],
    pub(super) choice: fn(&Config) -> PlanChoice,
    pub(super) decide: Decide,
}
