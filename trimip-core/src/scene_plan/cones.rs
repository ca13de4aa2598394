//! Width of a cone: about that of a pixel of the finest photographs. A wider pixel, of a coarser photograph or a more distant
//! camera, is the mean of several cones.

use super::decision::{Context, Proposal};
use super::fineness;
use crate::Aabb;
use toml::Value;

/// Width of a cone in pixel footprints. A pixel of photographs reduced to half their width has four cones; at three quarters
/// of the width it has one.
const WIDTH: f64 = 1.25;

/// Largest number of cones along a side of a pixel. With four, a view at 1/8 costs a quarter of a view at 1/1.
const MOST: i64 = 4;

pub(super) fn decide(context: &Context<'_>) -> Proposal {
    let Some(footprint) = fineness::footprint(context.facts.train, &Aabb::new(&context.now.scene)) else {
        return Proposal::Keep("there is no photograph".into());
    };
    let width = fineness::significant(WIDTH * footprint);
    let number = width.parse().unwrap_or(WIDTH * footprint);
    Proposal::Set {
        reason: format!(
            "pixels wider than {width} units in the middle of the box are divided into cones of that width, at most \
             {MOST} x {MOST}"
        ),
        changes: vec![
            ("renderer.cones", Value::Integer(MOST)),
            ("renderer.cone_width", Value::Float(number)),
        ],
    }
}
