//! How fine a scene is resolved: texels, marching steps and occupancy cells follow what a pixel of the photographs sees at
//! the distance of the box, as far as the budget goes.

use super::{Context, Proposal, recipe};
use crate::config::PlanChoice;
use crate::{Aabb, Config, ViewSet};
use toml::Value;

/// Samples of a budget below which each width of a texel serves best, and the width in widths of what a pixel sees: finer
/// texels are met by fewer rays, and every step passes over all of them.
const TEXELS: [(f64, f64); 3] = [(1e8, 2.4), (1e9, 2.1), (f64::INFINITY, 1.6)];

/// Length of a uniform marching step in widths of what a pixel sees.
const STEP: f64 = 1.4;

/// Width of an occupancy cell in widths of what a pixel sees.
const CELL: f64 = 6.4;

/// Steps along the diagonal at least, for photographs of few pixels, and at most: more are shorter than texels.
const STEPS: [f64; 2] = [512.0, 1024.0];

/// Occupancy cells along a side at least, for photographs of few pixels.
const LEAST_CELLS: u32 = 64;

/// Texels along a side at least: a plane of fewer is smaller than its mip levels are good for.
const LEAST_TEXELS: f64 = 64.0;

/// True where this decision sets the planes' size.
pub(super) fn sets_planes(context: &Context<'_>) -> bool {
    acts(context, "encoder.plane_size")
}

/// True where this decision sets `path`.
fn acts(context: &Context<'_>, path: &str) -> bool {
    match context.configured.plan.detail {
        PlanChoice::Off => false,
        PlanChoice::Auto => !context.given(path),
        PlanChoice::On => true,
    }
}

/// World width of a texel of the planes, along the box's longest side, that the settings or this decision ask for.
pub(super) fn texel(context: &Context<'_>) -> f64 {
    let longest = Aabb::<f64>::new(&context.now.scene).longest();
    match footprint(context.facts.train, &Aabb::new(&context.now.scene)).filter(|_| sets_planes(context)) {
        Some(footprint) => {
            let most = f64::from(context.configured.encoder.plane_size);
            (width_for_budget(context) * footprint).clamp(longest / most, longest / LEAST_TEXELS.min(most))
        }
        None => configured_texel(context.configured),
    }
}

/// Width of the texels to be, in widths of what a pixel sees; `None` where there is no photograph.
pub(super) fn texel_in_pixels(context: &Context<'_>) -> Option<f64> {
    let footprint = footprint(context.facts.train, &Aabb::new(&context.now.scene))?;
    Some(texel(context) / footprint)
}

/// Width of a texel in widths of what a pixel sees, for the budget.
fn width_for_budget(context: &Context<'_>) -> f64 {
    let samples = recipe::budget(context.now, context.facts.compute.samples_per_second);
    TEXELS.iter().find(|(most, _)| samples < *most).map_or(1.6, |(_, width)| *width)
}

/// World width of an occupancy cell that the settings or this decision ask for.
pub(super) fn cell(context: &Context<'_>) -> f64 {
    let pixel = footprint(context.facts.train, &Aabb::new(&context.now.scene));
    if let Some(pixel) = pixel.filter(|_| acts(context, "occupancy.resolution")) {
        return (CELL * pixel).min(box_side(context.now) / f64::from(LEAST_CELLS));
    }
    box_side(context.configured) / f64::from(context.configured.occupancy.resolution)
}

/// Side of the cube that is as large as the box.
pub(super) fn box_side(config: &Config) -> f64 {
    Aabb::<f64>::new(&config.scene).extent().iter().product::<f64>().cbrt()
}

/// World width of a texel of the configured planes, along the longest side.
pub(super) fn configured_texel(configured: &Config) -> f64 {
    Aabb::<f64>::new(&configured.scene).longest() / f64::from(configured.encoder.plane_size)
}

/// The smallest number of texels along the longest side that is no coarser than `texel`.
pub(super) fn plane_size(config: &Config, texel: f64) -> u32 {
    let unit = config.encoder.texel_unit();
    let longest = Aabb::<f64>::new(&config.scene).longest();
    // One part in a thousand less is the same texel.
    let enough = (longest / texel * 0.999).ceil().clamp(1.0, 4096.0) as u32;
    enough.next_multiple_of(unit).clamp(unit.max(4), 4096 / unit * unit)
}

pub(super) fn decide(context: &Context<'_>) -> Proposal {
    let aabb = Aabb::<f64>::new(&context.now.scene);
    let Some(footprint) = footprint(context.facts.train, &aabb) else {
        return Proposal::Keep("there is no photograph".into());
    };
    let mut changes = Vec::new();
    let texel = texel(context);
    if sets_planes(context) {
        let size = plane_size(context.now, texel);
        changes.push(("encoder.plane_size", Value::Integer(size.into())));
    }
    if acts(context, "renderer.steps_per_diagonal") {
        // The configured box may be any: what counts is the step.
        let steps = (aabb.longest() * 3_f64.sqrt() / (STEP * footprint)).clamp(STEPS[0], STEPS[1]);
        changes.push(("renderer.steps_per_diagonal", Value::Integer(steps.ceil() as i64)));
    }
    if changes.is_empty() {
        return Proposal::Keep("planes and steps are given".into());
    }
    let reason = format!(
        "a pixel sees {} units at the distance of the box; texels are {:.1} and steps {:.1} times as wide",
        significant(footprint),
        texel / footprint,
        changes.iter().find(|(path, _)| path.starts_with("renderer")).map_or(
            f64::from(context.now.step_length()) / footprint,
            |(_, steps)| aabb.longest() * 3_f64.sqrt() / steps.as_integer().unwrap_or(1) as f64 / footprint
        )
    );
    Proposal::Set { reason, changes }
}

/// World width of what a pixel of the finest photographs sees at the centre of the box: the median over the views.
fn footprint(views: &ViewSet, aabb: &Aabb<f64>) -> Option<f64> {
    let centre = glam::DVec3::from_array(std::array::from_fn(|axis| 0.5 * (aabb.min[axis] + aabb.max[axis])));
    let mut widths: Vec<f64> = views
        .scales
        .first()?
        .views
        .clone()
        .map(|view| &views.views[view].camera)
        // A camera within the box sees what is half a box away.
        .map(|camera| {
            let distance = (camera.origin - centre).length().max(0.25 * aabb.longest());
            distance / (camera.intrinsics.fx * camera.intrinsics.fy).sqrt()
        })
        .collect();
    widths.sort_by(f64::total_cmp);
    widths.get(widths.len() / 2).copied().filter(|width| width.is_finite() && *width > 0.0)
}

/// Three significant digits.
fn significant(value: f64) -> String {
    let digits = (2.0 - value.abs().log10().floor()).clamp(0.0, 12.0) as usize;
    format!("{value:.digits$}")
}
