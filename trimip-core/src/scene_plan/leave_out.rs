//! What a scene does not need: mip levels that no sphere reaches, occupancy cells smaller than its texels ask for,
//! directions of view, half of the model file's bits.

use super::{Context, Proposal, detail, radii};
use crate::config::{FilePrecision, PlanChoice};
use crate::tri_mip::{CHANNELS, Pyramid};
use crate::{Aabb, Config};
use toml::Value;

fn megabytes(floats: usize) -> String {
    format!("{:.1} MB", floats as f64 * 4e-6)
}

/// `; planes of 12.6 MB instead of 50.3 MB`: what is saved of f32 values; nothing where nothing is.
pub(super) fn saved(what: &str, after: usize, before: usize) -> String {
    let [less, more] = [after, before].map(megabytes);
    if after >= before || less == more {
        String::new()
    } else {
        format!("; {what} of {less} instead of {more}")
    }
}

pub(super) fn levels(context: &Context<'_>) -> Proposal {
    let Context { now, facts, .. } = *context;
    if !now.encoder.mipmap || now.encoder.halvings.values().any(|halvings| halvings > 0.0) {
        return Proposal::Keep("the levels are what the configuration is about".into());
    }
    let aabb = Aabb::<f64>::new(&now.scene);
    let train = facts.train.views.iter().map(|view| &view.camera);
    let Some([least, most]) = radii::range(train.chain(facts.test), &aabb) else {
        return Proposal::Keep("there is no camera".into());
    };
    let levels = now.encoder.levels;
    // The range of levels over the planes of a configuration.
    let range = |config: &Config| {
        let base = Pyramid::new(&config.encoder, &aabb).log2_base_radius;
        let lowest = base.map(|base| least.log2() - base).into_iter().fold(f64::INFINITY, f64::min);
        let highest = base.map(|base| most.log2() - base).into_iter().fold(f64::NEG_INFINITY, f64::max);
        [lowest, highest]
    };
    let [lowest, highest] = range(now);
    // The finest levels that every sphere lies above, and one level more than any sphere reaches, for whoever steps back.
    let below = (lowest.floor().max(0.0) as u32).min(levels - 1);
    let above = (highest.ceil().max(0.0) as u32 + 2).min(levels);
    let reach = match lowest.is_finite() {
        true => format!("spheres lie between the levels {lowest:.1} and {highest:.1} of {levels}"),
        false => format!("spheres lie below level {highest:.1} of {levels}, cameras within the box"),
    };
    if below == 0 && above == levels {
        return Proposal::Keep(reach);
    }
    let mut smaller = now.clone();
    smaller.encoder.levels = (above - below).max(1);
    let texel = detail::texel(context) * f64::from(1_u32 << below);
    // Fewer levels let planes be as coarse as asked for, and coarser planes need fewer levels.
    loop {
        smaller.encoder.plane_size = detail::plane_size(&smaller, texel).min(now.encoder.plane_size);
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

pub(super) fn occupancy(context: &Context<'_>) -> Proposal {
    let now = context.now.occupancy.resolution;
    let needed = ((detail::box_side(context.now) / detail::cell(context)).ceil().clamp(16.0, 1024.0) as u32)
        .next_multiple_of(8);
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
            "the photographs alone do not tell whether colours change with the view".into(),
        );
    }
    Proposal::LeaveOut {
        reason: "colours depend on the place alone".into(),
        changes: vec![("field.directions", Value::Boolean(false))],
    }
}

pub(super) fn half_precision(context: &Context<'_>) -> Proposal {
    let now = context.now;
    if now.file.planes == FilePrecision::F16 {
        return Proposal::Keep("texels are written as f16 already".into());
    }
    let floats = Pyramid::new(&now.encoder, &Aabb::new(&now.scene)).base_len();
    Proposal::LeaveOut {
        reason: format!(
            "texels are written as f16: {} instead of {} ({} texels of {CHANNELS} channels)",
            megabytes(floats / 2),
            megabytes(floats),
            floats / CHANNELS
        ),
        changes: vec![("file.planes", Value::String("f16".into()))],
    }
}
