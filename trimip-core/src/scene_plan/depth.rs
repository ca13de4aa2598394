//! Whether rays should end at points of structure from motion.

use super::decision::{Context, Proposal};
use crate::config::Contraction;
use crate::{Config, ViewSet};
use toml::Value;

/// Weight of the depth term over a run: points show where surfaces are, photographs how they look. In the second half photographs
/// alone decide, so that wrong points leave no trace.
const WEIGHTS: [[f64; 2]; 5] = [[0.0, 0.01], [0.125, 0.0075], [0.25, 0.005], [0.375, 0.0025], [0.5, 0.0]];

pub(super) fn decide(context: &Context<'_>) -> Proposal {
    if context.now.scene.contraction == Contraction::None {
        return Proposal::Keep("the scene is bounded".into());
    }
    let known = context.facts.train.depths.len();
    if known == 0 {
        let reason = "the data state no points that training photographs saw";
        return Proposal::Unknown(reason.into(), "use photographs with a COLMAP model");
    }
    let weights = WEIGHTS.iter().map(|piece| Value::Array(piece.map(Value::Float).to_vec())).collect();
    Proposal::Set {
        reason: format!(
            "points that photographs saw tell where the rays of {known} pixels end; until half of the run they are drawn there"
        ),
        changes: vec![("loss.depth", Value::Array(weights))],
    }
}

/// True if the depth term is at work and no point is known.
pub(super) fn is_missing(config: &Config, views: &ViewSet) -> bool {
    views.depths.is_empty() && config.loss.depth.values().any(|weight| weight > 0.0)
}
