//! Decisions for tri-mip planes: the width of texels, the level bias, and the mip levels that no camera needs.

use super::decision::{Context, Proposal};
use super::fineness::{self, Fineness};
use super::leave_out::saved;
use super::radii;
use crate::config::EncoderKind;
use crate::field::encoders::tri_mip::Pyramid;
use crate::{Aabb, Config};
use toml::Value;

/// Number of mip levels above that of the largest sphere that are kept, for cameras farther away.
const SPARE_LEVELS: u32 = 1;

/// Best width of a texel in pixel footprints, for budgets of fewer samples than the first number: finer texels are hit by
/// fewer rays, and every step visits all texels.
const TEXELS: [(f64, f64); 3] = [(1e8, 2.4), (1e9, 2.1), (f64::INFINITY, 1.6)];

/// Fewest texels along a side: smaller planes are too coarse for their mip levels.
pub(super) const LEAST_TEXELS: f64 = 64.0;

/// Most texels along a side: the limit of `encoder.plane_size`.
const MOST_TEXELS: u32 = 4096;

/// Texels that are finer by less than this share count as equal.
const SAME_TEXEL: f64 = 1e-3;

/// Level bias for fine texels: coarse views gain more than the finest ones lose.
const LEVEL_BIAS: f64 = -0.5;

/// Texels of up to this many pixel footprints count as fine. With wider texels most spheres read the base level, and blur
/// helps training.
const FINE_TEXELS: f64 = 3.0;

/// Sets the size of the planes so that texels follow the footprint of a pixel.
pub(super) fn detail(context: &Context<'_>) -> Fineness {
    let width = texel(context);
    let size = sets_planes(context).then(|| plane_size(context.now, width));
    let change = size.map(|size| ("encoder.plane_size", Value::Integer(size.into())));
    Fineness { what: "texels", width, changes: change.into_iter().collect() }
}

/// Returns true if this decision sets the size of the planes.
pub(super) fn sets_planes(context: &Context<'_>) -> bool {
    fineness::acts(context, "encoder.plane_size")
}

/// Returns the world width of a texel along the longest side of the box, from the settings or this decision.
pub(super) fn texel(context: &Context<'_>) -> f64 {
    let longest = Aabb::<f64>::new(&context.now.scene).longest();
    match fineness::footprint(context.facts.train, &Aabb::new(&context.now.scene))
        .filter(|_| sets_planes(context))
    {
        Some(footprint) => {
            let most = f64::from(context.configured.encoder.plane_size);
            (width_for_budget(context) * footprint).clamp(longest / most, longest / LEAST_TEXELS.min(most))
        }
        None => configured_texel(context.configured),
    }
}

/// Returns the width of a texel in pixel footprints; `None` without photographs.
pub(super) fn texel_in_pixels(context: &Context<'_>) -> Option<f64> {
    let footprint = fineness::footprint(context.facts.train, &Aabb::new(&context.now.scene))?;
    Some(texel(context) / footprint)
}

/// Returns the width of a texel in pixel footprints for the budget.
pub(super) fn width_for_budget(context: &Context<'_>) -> f64 {
    let samples = context.budget();
    TEXELS.iter().find(|(most, _)| samples < *most).map_or(1.6, |(_, width)| *width)
}

/// Returns the world width of a texel of the configured planes, along the longest side.
pub(super) fn configured_texel(configured: &Config) -> f64 {
    Aabb::<f64>::new(&configured.scene).longest() / f64::from(configured.encoder.plane_size)
}

/// Returns the smallest valid number of texels along the longest side that makes them no wider than `texel`.
pub(super) fn plane_size(config: &Config, texel: f64) -> u32 {
    let unit = config.encoder.texel_unit();
    let longest = Aabb::<f64>::new(&config.scene).longest();
    let enough = (longest / texel * (1.0 - SAME_TEXEL)).ceil().clamp(1.0, MOST_TEXELS.into()) as u32;
    enough.next_multiple_of(unit).clamp(unit.max(4), MOST_TEXELS / unit * unit)
}

/// Returns a level bias, if texels are fine.
pub(super) fn level_bias(context: &Context<'_>) -> Option<(&'static str, Value)> {
    let fine = texel_in_pixels(context).is_some_and(|width| width <= FINE_TEXELS);
    fine.then_some(("encoder.level_bias", Value::Float(LEVEL_BIAS)))
}

pub(super) fn levels(context: &Context<'_>) -> Proposal {
    let Context { now, facts, .. } = *context;
    if now.encoder.kind != EncoderKind::TriMip {
        return Proposal::Keep("the encoder has no mip levels".into());
    }
    if !now.encoder.mipmap || now.encoder.halvings.values().any(|halvings| halvings > 0.0) {
        return Proposal::Keep("encoder.mipmap = false or encoder.halvings determines the levels".into());
    }
    let aabb = Aabb::<f64>::new(&now.scene);
    let train = facts.train.views.iter().map(|view| &view.camera);
    let Some([least, most]) = radii::range(train.chain(facts.test), &aabb) else {
        return Proposal::Keep("there is no camera".into());
    };
    let levels = now.encoder.levels;
    // The range of the spheres' levels over all planes of a configuration.
    let range = |config: &Config| {
        let base = Pyramid::new(&config.encoder, &aabb).log2_base_radius;
        let lowest = base.map(|base| least.log2() - base).into_iter().fold(f64::INFINITY, f64::min);
        let highest = base.map(|base| most.log2() - base).into_iter().fold(f64::NEG_INFINITY, f64::max);
        [lowest, highest]
    };
    let [lowest, highest] = range(now);
    // The finest levels, which lie below those of all spheres, are dropped.
    let below = (lowest.floor().max(0.0) as u32).min(levels - 1);
    let above = (highest.ceil().max(0.0) as u32 + 1 + SPARE_LEVELS).min(levels);
    let reach = match lowest.is_finite() {
        true => format!("spheres lie between the levels {lowest:.1} and {highest:.1} of {levels}"),
        false => format!("spheres lie below level {highest:.1} of {levels}: some cameras are within the box"),
    };
    if below == 0 && above == levels {
        return Proposal::Keep(reach);
    }
    let mut smaller = now.clone();
    smaller.encoder.levels = (above - below).max(1);
    let texel = texel(context) * f64::from(1_u32 << below);
    // Fewer levels allow coarser planes, and coarser planes need fewer levels.
    loop {
        smaller.encoder.plane_size = plane_size(&smaller, texel).min(now.encoder.plane_size);
        let needed = (range(&smaller)[1].ceil().max(0.0) as u32 + 2).min(smaller.encoder.levels);
        if needed == smaller.encoder.levels {
            break;
        }
        smaller.encoder.levels = needed;
    }
    let sizes = [now, &smaller].map(|config| {
        let pyramid = Pyramid::new(&config.encoder, &aabb);
        pyramid.base_len() + pyramid.derived_len()
    });
    Proposal::LeaveOut {
        reason: format!("{reach}{}", saved("planes and levels", sizes[1], sizes[0])),
        changes: vec![
            ("encoder.levels", Value::Integer(smaller.encoder.levels.into())),
            ("encoder.plane_size", Value::Integer(smaller.encoder.plane_size.into())),
        ],
    }
}
