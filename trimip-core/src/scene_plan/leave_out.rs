//! Parts that a scene does not need: occupancy cells that are too fine, view dependence, and half of the bits of the
//! model file.

use super::decision::{Context, Proposal};
use super::fineness;
use crate::Layout;
use crate::config::{FilePrecision, PlanChoice};
use toml::Value;

fn megabytes(floats: usize) -> String {
    format!("{:.1} MB", floats as f64 * 4e-6)
}

/// Fewest and most occupancy cells along a side; their number is a multiple of `CELL_UNIT`.
const CELLS: [f64; 2] = [16.0, 1024.0];
const CELL_UNIT: u32 = 8;

/// Returns a text about saved f32 values, such as `; planes of 12.6 MB instead of 50.3 MB`; empty if nothing is saved.
pub(super) fn saved(what: &str, after: usize, before: usize) -> String {
    let [less, more] = [after, before].map(megabytes);
    if after >= before || less == more {
        String::new()
    } else {
        format!("; {what} of {less} instead of {more}")
    }
}

pub(super) fn occupancy(context: &Context<'_>) -> Proposal {
    let now = context.now.occupancy.resolution;
    let needed =
        ((fineness::box_side(context.now) / fineness::cell(context)).ceil().clamp(CELLS[0], CELLS[1]) as u32)
            .next_multiple_of(CELL_UNIT);
    if needed >= now {
        return Proposal::Keep(format!("{now}³ cells are needed"));
    }
    Proposal::LeaveOut {
        reason: format!(
            "{needed}³ cells are enough for the box: {:.1} times fewer",
            (f64::from(now) / f64::from(needed)).powi(3)
        ),
        changes: vec![("occupancy.resolution", Value::Integer(needed.into()))],
    }
}

pub(super) fn directions(context: &Context<'_>) -> Proposal {
    let Context { now, configured, .. } = *context;
    if configured.plan.directions == PlanChoice::Auto || !now.field.directions {
        return Proposal::Keep(
            "the photographs alone do not show whether colours depend on the viewing direction".into(),
        );
    }
    Proposal::LeaveOut {
        reason: "colours depend on the position alone".into(),
        changes: vec![("field.directions", Value::Boolean(false))],
    }
}

pub(super) fn half_precision(context: &Context<'_>) -> Proposal {
    let now = context.now;
    if now.file.planes == FilePrecision::F16 {
        return Proposal::Keep("features are written as f16 already".into());
    }
    let floats: usize = Layout::new(now).encoder().iter().map(|slot| slot.range.len()).sum();
    Proposal::LeaveOut {
        reason: format!("features are written as f16{}", saved("features", floats / 2, floats)),
        changes: vec![("file.planes", Value::String("f16".into()))],
    }
}
