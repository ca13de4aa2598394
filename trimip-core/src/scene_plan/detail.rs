//! Resolution of a scene: texels, marching steps and occupancy cells follow the footprint of a pixel of the photographs at
//! the distance of the box, within the budget.

use super::{Context, Proposal, hash_grid, rip_map, tri_mip};
use crate::config::{EncoderKind, PlanChoice};
use crate::scene::cones::median_footprint;
use crate::{Aabb, Config, ViewSet};
use toml::Value;

/// Length of a uniform marching step in pixel footprints.
const STEP: f64 = 1.4;

/// Width of an occupancy cell in pixel footprints.
const CELL: f64 = 6.4;

/// Fewest steps along the diagonal, for photographs of few pixels, and most: more are shorter than texels.
const STEPS: [f64; 2] = [512.0, 1024.0];

/// Fewest occupancy cells along a side, for photographs of few pixels.
const LEAST_CELLS: u32 = 64;

/// How fine an encoder resolves the scene.
pub(super) struct Fineness {
    /// Name of its smallest parts.
    pub(super) what: &'static str,
    /// World width of one.
    pub(super) width: f64,
    /// Settings of the encoder that follow.
    pub(super) changes: Vec<(&'static str, Value)>,
}

/// Decides how fine an encoder resolves the scene.
type Detail = fn(&Context<'_>) -> Fineness;

/// The decision of each encoder about its own detail.
const ENCODERS: &[(EncoderKind, Detail)] = &[
    (EncoderKind::TriMip, tri_mip::detail),
    (EncoderKind::HashGrid, hash_grid::detail),
    (EncoderKind::RipMap, rip_map::detail),
];

/// True if this decision sets `path`.
pub(super) fn acts(context: &Context<'_>, path: &str) -> bool {
    match context.configured.plan.detail {
        PlanChoice::Off => false,
        PlanChoice::Auto => !context.given(path),
        PlanChoice::On => true,
    }
}

/// World width of an occupancy cell, from the settings or this decision.
pub(super) fn cell(context: &Context<'_>) -> f64 {
    let pixel = footprint(context.facts.train, &Aabb::new(&context.now.scene));
    if let Some(pixel) = pixel.filter(|_| acts(context, "occupancy.resolution")) {
        return (CELL * pixel).min(box_side(context.now) / f64::from(LEAST_CELLS));
    }
    box_side(context.configured) / f64::from(context.configured.occupancy.resolution)
}

/// Side of a cube with the volume of the box.
pub(super) fn box_side(config: &Config) -> f64 {
    Aabb::<f64>::new(&config.scene).extent().iter().product::<f64>().cbrt()
}

pub(super) fn decide(context: &Context<'_>) -> Proposal {
    let aabb = Aabb::<f64>::new(&context.now.scene);
    let Some(footprint) = footprint(context.facts.train, &aabb) else {
        return Proposal::Keep("there is no photograph".into());
    };
    let own = ENCODERS.iter().find(|(kind, _)| *kind == context.now.encoder.kind);
    let Some((_, own)) = own else { return Proposal::Keep("the encoder has a detail of its own".into()) };
    let Fineness { what, width, mut changes } = own(context);
    if acts(context, "renderer.steps_per_diagonal") {
        // The configured box is arbitrary: only the step matters.
        let steps = (aabb.longest() * 3_f64.sqrt() / (STEP * footprint)).clamp(STEPS[0], STEPS[1]);
        changes.push(("renderer.steps_per_diagonal", Value::Integer(steps.ceil() as i64)));
    }
    if changes.is_empty() {
        return Proposal::Keep("the encoder's detail and the steps are given".into());
    }
    let reason = format!(
        "a pixel sees {} units at the distance of the box; {what} are {:.1} and steps {:.1} times as wide",
        significant(footprint),
        width / footprint,
        changes.iter().find(|(path, _)| path.starts_with("renderer")).map_or(
            f64::from(context.now.step_length()) / footprint,
            |(_, steps)| aabb.longest() * 3_f64.sqrt() / steps.as_integer().unwrap_or(1) as f64 / footprint
        )
    );
    Proposal::Set { reason, changes }
}

/// World width of a pixel of the finest photographs in the middle of the box: the median over the views.
pub(super) fn footprint(views: &ViewSet, aabb: &Aabb<f64>) -> Option<f64> {
    median_footprint(views, 0, aabb)
}

/// Three significant digits.
pub(super) fn significant(value: f64) -> String {
    let digits = (2.0 - value.abs().log10().floor()).clamp(0.0, 12.0) as usize;
    format!("{value:.digits$}")
}
