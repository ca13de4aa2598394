//! Resolution of a scene: the footprint of a pixel, the width of occupancy cells, and the detail of an encoder.

use super::decision::Context;
use crate::config::PlanChoice;
use crate::scene::cones::median_footprint;
use crate::{Aabb, Config, ViewSet};
use toml::Value;

/// Width of an occupancy cell in pixel footprints.
const CELL: f64 = 6.4;

/// Fewest occupancy cells along a side, for photographs of few pixels.
const LEAST_CELLS: u32 = 64;

/// Detail with which an encoder resolves the scene.
pub(super) struct Fineness {
    /// Name of the encoder's smallest parts.
    pub(super) what: &'static str,
    /// World width of one such part.
    pub(super) width: f64,
    /// Settings of the encoder that follow from this width.
    pub(super) changes: Vec<(&'static str, Value)>,
}

/// Returns true if the decision on detail sets `path`.
pub(super) fn acts(context: &Context<'_>, path: &str) -> bool {
    match context.configured.plan.detail {
        PlanChoice::Off => false,
        PlanChoice::Auto => !context.given(path),
        PlanChoice::On => true,
    }
}

/// Returns the world width of an occupancy cell, from the settings or the decision on detail.
pub(super) fn cell(context: &Context<'_>) -> f64 {
    let pixel = footprint(context.facts.train, &Aabb::new(&context.now.scene));
    if let Some(pixel) = pixel.filter(|_| acts(context, "occupancy.resolution")) {
        return (CELL * pixel).min(box_side(context.now) / f64::from(LEAST_CELLS));
    }
    box_side(context.configured) / f64::from(context.configured.occupancy.resolution)
}

/// Returns the side of a cube with the volume of the box.
pub(super) fn box_side(config: &Config) -> f64 {
    Aabb::<f64>::new(&config.scene).extent().iter().product::<f64>().cbrt()
}

/// Returns the world width of a pixel of the finest photographs in the middle of the box: the median over the views.
pub(super) fn footprint(views: &ViewSet, aabb: &Aabb<f64>) -> Option<f64> {
    median_footprint(views, 0, aabb)
}

/// Formats a number with three significant digits.
pub(super) fn significant(value: f64) -> String {
    let digits = (2.0 - value.abs().log10().floor()).clamp(0.0, 12.0) as usize;
    format!("{value:.digits$}")
}
