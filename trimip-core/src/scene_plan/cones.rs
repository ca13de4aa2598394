//! The width of a cone: about that of a pixel of the finest photographs. Wider pixels, of coarser photographs or more distant
//! cameras, are the mean of several cones.

use super::decision::{Context, Proposal};
use super::fineness;
use crate::Aabb;
use toml::Value;

/// Width of a cone in pixel footprints. In photographs reduced to half their width a pixel is four cones, at three quarters it
/// is one.
const WIDTH: f64 = 1.25;

/// Most cones along a side of a pixel: with four, a view at 1/8 costs a quarter of one at 1/1.
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
