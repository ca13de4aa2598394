//! The decisions of the scene plan: their inputs, their possible results, and their order.

use super::{aabb, cones, detail, facts::Facts, leave_out, recipe, tri_mip};
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
    /// True for a setting that the user gave.
    pub(super) fn given(&self, path: &str) -> bool {
        *self.given.origin(path) != Origin::Default
    }
}

/// Result of a decision.
pub(super) enum Proposal {
    /// Nothing changes, with the reason.
    Keep(String),
    /// It cannot be decided, with the reason and advice.
    Unknown(String, &'static str),
    /// Settings derived from the data or the budget.
    Set { reason: String, changes: Vec<(&'static str, Value)> },
    /// Settings that drop what the scene does not need.
    LeaveOut { reason: String, changes: Vec<(&'static str, Value)> },
}

pub(super) type Decide = fn(&Context<'_>) -> Proposal;

/// A decision: its key, the settings it owns (with `auto` it is not taken if the user set one of them), and its rule.
pub(super) struct Decision {
    pub(super) key: &'static str,
    pub(super) owns: &'static [&'static str],
    pub(super) choice: fn(&Config) -> PlanChoice,
    pub(super) decide: Decide,
}

/// In order: each decision sees the changes of the earlier ones.
pub(super) const DECISIONS: [Decision; 12] = [
    Decision {
        key: "aabb",
        owns: &["scene.aabb_min", "scene.aabb_max", "encoder.shape"],
        choice: |config| config.plan.aabb,
        decide: aabb::find,
    },
    Decision {
        key: "background",
        owns: &["data.background"],
        choice: |config| config.plan.background,
        decide: recipe::background,
    },
    Decision {
        key: "edges",
        owns: &["data.edge_exponents"],
        choice: |config| config.plan.edges,
        decide: recipe::edges,
    },
    Decision {
        key: "hull",
        owns: &["occupancy.hull"],
        choice: |config| config.plan.hull,
        decide: recipe::hull,
    },
    Decision {
        key: "solids",
        owns: &["loss.opacity", "train.background"],
        choice: |config| config.plan.solids,
        decide: recipe::solids,
    },
    Decision { key: "schedule", owns: &[], choice: |config| config.plan.schedule, decide: recipe::schedule },
    Decision { key: "detail", owns: &[], choice: |config| config.plan.detail, decide: detail::decide },
    Decision {
        key: "cones",
        owns: &["renderer.cones", "renderer.cone_width"],
        choice: |config| config.plan.cones,
        decide: cones::decide,
    },
    Decision {
        key: "levels",
        owns: &["encoder.levels"],
        choice: |config| config.plan.levels,
        decide: tri_mip::levels,
    },
    Decision {
        key: "occupancy",
        owns: &[],
        choice: |config| config.plan.occupancy,
        decide: leave_out::occupancy,
    },
    Decision {
        key: "directions",
        owns: &["field.directions"],
        choice: |config| config.plan.directions,
        decide: leave_out::directions,
    },
    Decision {
        key: "file",
        owns: &["file.planes"],
        choice: |config| config.plan.file,
        decide: leave_out::half_precision,
    },
];
