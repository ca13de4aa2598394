//! Decisions for the hash grid: the resolution of its finest level.

use super::decision::Context;
use super::fineness::{self, Fineness};
use crate::Aabb;
use toml::Value;

/// Best width of the finest cells in pixel footprints: finer ones are hit by fewer rays and collide more often.
const CELL: f64 = 1.3;

/// A finest level whose cells follow the footprint of a pixel, never finer than configured.
pub(super) fn detail(context: &Context<'_>) -> Fineness {
    let (aabb, grid) = (Aabb::<f64>::new(&context.now.scene), &context.configured.hash_grid);
    let footprint = fineness::footprint(context.facts.train, &aabb);
    let footprint = footprint.filter(|_| fineness::acts(context, "hash_grid.finest"));
    let finest = footprint.map(|footprint| {
        let cells = (aabb.longest() / (CELL * footprint)).ceil() as u32;
        cells.clamp(grid.coarsest, grid.finest)
    });
    Fineness {
        what: "the finest cells",
        width: aabb.longest() / f64::from(finest.unwrap_or(grid.finest)),
        changes: finest
            .map(|finest| ("hash_grid.finest", Value::Integer(finest.into())))
            .into_iter()
            .collect(),
    }
}
