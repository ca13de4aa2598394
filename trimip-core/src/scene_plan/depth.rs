//! Decides whether a run starts near the points of structure from motion or the surfaces of depth images, and whether rays
//! are drawn to end there.

use super::decision::{Context, Proposal};
use crate::config::Contraction;
use crate::{Config, ViewSet};
use toml::Value;

/// Weight of the depth term over a run: known points show where surfaces are, photographs show how they look. In the second half of the
/// run only the photographs count, so that wrong points leave no trace.
const WEIGHTS: [[f64; 2]; 5] = [[0.0, 0.01], [0.125, 0.0075], [0.25, 0.005], [0.375, 0.0025], [0.5, 0.0]];

/// Fraction of the run in which only cells near points can be occupied.
const SEEDED: f64 = 0.3;

/// Fraction of the run in which cells that photographs look through stay empty.
const CLEARED: f64 = 1.0;

pub(super) fn decide(context: &Context<'_>) -> Proposal {
    if context.now.scene.contraction == Contraction::None {
        return Proposal::Keep("the scene is bounded".into());
    }
    let known = context.facts.train.depths.len();
    if known == 0 {
        let reason = "the data set has no points that training photographs show, and no depth images";
        return Proposal::Unknown(reason.into(), "use photographs with a COLMAP model or with depth images");
    }
    let weights = WEIGHTS.iter().map(|piece| Value::Array(piece.map(Value::Float).to_vec())).collect();
    let mut changes = vec![
        ("loss.depth", Value::Array(weights)),
        ("occupancy.seeded", Value::Float(SEEDED)),
        ("occupancy.cleared", Value::Float(CLEARED)),
    ];
    changes.retain(|(path, _)| !context.given(path));
    Proposal::Set {
        reason: format!(
            "points that photographs show, or depth images, give the distances of {known} pixels: the run begins near the points, the space in front of them stays empty, and until half of the run rays are drawn to end at them"
        ),
        changes,
    }
}

/// Returns the first setting in use that needs known points, if no point is known.
pub(super) fn without_points(config: &Config, views: &ViewSet) -> Option<&'static str> {
    let settings = [
        ("loss.depth", config.loss.depth.values().any(|weight| weight > 0.0)),
        ("occupancy.seeded", config.occupancy.seeded > 0.0),
        ("occupancy.cleared", config.occupancy.cleared > 0.0),
    ];
    let used = settings.into_iter().find(|(_, used)| *used);
    used.filter(|_| views.depths.is_empty()).map(|(setting, _)| setting)
}
