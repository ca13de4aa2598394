//! How the page marks a system, and which rows summarise all scenes.

use crate::comparison::{Comparison, Scales, TableRow};
use crate::svg::{COLORS, DASHED};
use trimip::systems::SYSTEMS;

/// Returns the colour of a system, and whether its lines are dashed. Both are the same on every page.
pub fn look(system: &str) -> (&'static str, bool) {
    let place = SYSTEMS.iter().position(|own| own.name == system).unwrap_or(0);
    (COLORS[place % COLORS.len()], place >= COLORS.len())
}

/// Returns the mark of a system as HTML.
pub fn mark(system: &str) -> String {
    let (color, dashed) = look(system);
    let dashed = if dashed { format!(" {DASHED}") } else { String::new() };
    format!("<i class=\"mark{dashed}\" style=\"color:{color}\"></i>")
}

/// Returns the rows that summarise all scenes: those of the only scene, or the means over several.
pub fn headline(comparison: &Comparison, scales: Scales) -> Vec<TableRow> {
    match &comparison.scenes[..] {
        [scene] => comparison.scene_rows(scales, scene),
        _ => comparison.whole_rows(scales),
    }
}
