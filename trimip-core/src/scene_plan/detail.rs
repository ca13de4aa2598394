//! Resolution of a scene: texels, marching steps and occupancy cells follow the footprint of a pixel of the photographs at
//! the distance of the box, within the budget.

use super::decision::{Context, Proposal};
use super::fineness::{Fineness, acts, footprint, significant};
use super::{hash_grid, rip_map, tri_mip};
use crate::Aabb;
use crate::config::EncoderKind;
use toml::Value;

/// Length of a uniform marching step in pixel footprints.
const STEP: f64 = 1.4;

/// Fewest and most steps along the diagonal. The minimum is for photographs of few pixels; with more than the maximum,
/// steps are shorter than texels.
const STEPS: [f64; 2] = [512.0, 1024.0];

/// Rule that decides how fine an encoder resolves the scene.
type Detail = fn(&Context<'_>) -> Fineness;

/// The rule of each encoder.
const ENCODERS: &[(EncoderKind, Detail)] = &[
    (EncoderKind::TriMip, tri_mip::detail),
    (EncoderKind::HashGrid, hash_grid::detail),
    (EncoderKind::RipMap, rip_map::detail),
];

pub(super) fn decide(context: &Context<'_>) -> Proposal {
    let aabb = Aabb::<f64>::new(&context.now.scene);
    let Some(footprint) = footprint(context.facts.train, &aabb) else {
        return Proposal::Keep("there is no photograph".into());
    };
    let own = ENCODERS.iter().find(|(kind, _)| *kind == context.now.encoder.kind);
    let Some((_, own)) = own else {
        return Proposal::Keep("the plan sets no resolution for this encoder".into());
    };
    let Fineness { what, width, mut changes } = own(context);
    if acts(context, "renderer.steps_per_diagonal") {
        // The configured box is arbitrary, so only the length of the step matters.
        let steps = (aabb.longest() * 3_f64.sqrt() / (STEP * footprint)).clamp(STEPS[0], STEPS[1]);
        changes.push(("renderer.steps_per_diagonal", Value::Integer(steps.ceil() as i64)));
    }
    if changes.is_empty() {
        return Proposal::Keep("the encoder's detail and the steps are given".into());
    }
    let reason = format!(
        "a pixel covers {} units at the distance of the box; {what} are {:.1} and steps {:.1} times as wide",
        significant(footprint),
        width / footprint,
        changes.iter().find(|(path, _)| path.starts_with("renderer")).map_or(
            f64::from(context.now.step_length()) / footprint,
            |(_, steps)| aabb.longest() * 3_f64.sqrt() / steps.as_integer().unwrap_or(1) as f64 / footprint
        )
    );
    Proposal::Set { reason, changes }
}
