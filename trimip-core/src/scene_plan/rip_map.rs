//! Decisions for planes with ripmaps: the width of their texels, and the levels that a camera needs.

use super::decision::Context;
use super::fineness::{self, Fineness};
use super::{radii, tri_mip};
use crate::Aabb;
use toml::Value;

/// Number of levels above that of the largest Gaussian that are kept, for cameras farther away.
const SPARE_LEVELS: f64 = 1.0;

/// Sets the size of the planes and the number of levels. Texels follow the footprint of a pixel and the budget, like those of
/// tri-mip planes, and are never finer than configured. The levels are those that the cameras of the set need.
pub(super) fn detail(context: &Context<'_>) -> Fineness {
    let (aabb, given) = (Aabb::<f64>::new(&context.now.scene), &context.configured.rip_map);
    let footprint = fineness::footprint(context.facts.train, &aabb);
    let size = footprint.filter(|_| fineness::acts(context, "rip_map.size")).map(|footprint| {
        let width = tri_mip::width_for_budget(context) * footprint;
        let enough = (aabb.longest() / width).ceil().max(tri_mip::LEAST_TEXELS) as u32;
        enough.min(given.size)
    });
    let texel = aabb.longest() / f64::from(size.unwrap_or(given.size));
    let cameras = context.facts.train.views.iter().map(|view| &view.camera).chain(context.facts.test);
    let levels = radii::range(cameras, &aabb).filter(|_| fineness::acts(context, "rip_map.levels"));
    let levels = levels.map(|[_, radius]| {
        // The larger of the standard deviations of a disc and of an interval.
        let widest = (radius / 2.0).max(f64::from(context.now.step_length()) / 12_f64.sqrt());
        let highest = (4.0 * widest / texel).log2() + f64::from(given.level_bias);
        ((highest + SPARE_LEVELS).ceil().max(0.0) as u32 + 1).min(given.levels)
    });
    let change = |path, value: Option<u32>| value.map(|value| (path, Value::Integer(value.into())));
    let changes = [change("rip_map.size", size), change("rip_map.levels", levels)];
    Fineness { what: "texels", width: texel, changes: changes.into_iter().flatten().collect() }
}
