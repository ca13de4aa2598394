//! Decisions for the hash grid: whether it is the encoder, its levels, and the resolution of its finest level. A place is a scene
//! in contracted space.

use super::decision::{Context, Proposal};
use super::fineness::{self, Fineness};
use super::recipe;
use crate::Aabb;
use crate::config::{Config, Contraction, EncoderKind, PlanChoice};
use toml::Value;

/// Levels and features per entry for places: a step reads half as many entries as with instant-ngp's 16 levels of two features.
const LEVELS: [i64; 2] = [8, 4];

/// log2 of the entries per level for places, in a small, a large and the largest table. A small table stays in a processor's cache,
/// and many rays hit each entry; a large one has fewer collisions.
const ENTRIES: [i64; 3] = [17, 19, 20];

/// Number of training photographs from which a place needs the large table even in short runs. After 120 s the large table loses
/// 0.4 dB on *fox* (43 photographs) and gains 0.2 dB on *bonsai* (255).
const MANY_VIEWS: usize = 100;

/// Budgets, in samples, from which the table is large and from which it is the largest: for fewer than [`MANY_VIEWS`] photographs,
/// and for at least that many.
const MANY_SAMPLES: [[f64; 2]; 2] = [[1e9, f64::INFINITY], [8e7, 4e9]];

/// Learning rates for places: of the networks, and of the features as a multiple of the networks' rate. With the networks' rate
/// for planes, *fox* loses 0.7 dB after 90 s.
const RATES: [f64; 2] = [5e-3, 16.0];

/// Fraction of the occupancy cells sampled per update for places, whose steps are small.
const PROBED: f64 = 0.02;

/// Best width of the finest cells in pixel footprints: finer cells are hit by fewer rays and collide more often.
const CELL: f64 = 1.3;

/// Samples per second with the hash grid relative to planes: for small tables, whose log2 of the entries per level is at most
/// the last number, and for larger ones (*fox* in 60 s, *bonsai* in 300 s, two cores).
const PACES: ([f64; 2], u32) = ([0.7, 0.6], 17);

/// Returns the samples per second with the configured encoder relative to planes. The plan prints budgets in samples of the
/// encoder; its limits are in samples of planes.
pub(super) fn pace(config: &Config) -> f64 {
    let ([small, large], most) = PACES;
    match config.encoder.kind {
        EncoderKind::HashGrid if config.hash_grid.log2_entries <= most => small,
        EncoderKind::HashGrid => large,
        _ => 1.0,
    }
}

/// Returns true if [`for_places`] will choose the hash grid once space is contracted: there are many pixels, and the user set
/// neither the encoder nor a setting of another encoder.
pub(super) fn encodes_places(context: &Context<'_>) -> bool {
    let of_another = |path: &str| context.given(path) && !EncoderKind::HashGrid.takes(path);
    match context.configured.plan.encoder {
        PlanChoice::Auto => {
            recipe::has_many_pixels(context.facts.train)
                && !context.given("encoder.kind")
                && !context.given.iter().any(|(path, ..)| of_another(path))
        }
        // A given encoder stays, and settings of other encoders are refused.
        PlanChoice::On => !context.given("encoder.kind") || context.now.encoder.kind == EncoderKind::HashGrid,
        PlanChoice::Off => false,
    }
}

/// Proposes the hash grid for places: product planes can hold one object, but a room has more detail than they can hold.
pub(super) fn for_places(context: &Context<'_>) -> Proposal {
    if context.now.scene.contraction == Contraction::None {
        return Proposal::Keep("the scene is bounded".into());
    }
    if !encodes_places(context) {
        let reason = match recipe::has_many_pixels(context.facts.train) {
            true => "settings of another encoder are given",
            false => "the photographs have few pixels: planes are smoother where no camera looks",
        };
        return Proposal::Keep(reason.into());
    }
    let budgets = MANY_SAMPLES[usize::from(context.facts.train.photographs() >= MANY_VIEWS)];
    let entries = ENTRIES[budgets.iter().filter(|&&least| context.budget() >= least).count()];
    let [levels, features] = LEVELS;
    let mut changes = vec![
        ("encoder.kind", Value::String("hash-grid".into())),
        ("hash_grid.levels", Value::Integer(levels)),
        ("hash_grid.features", Value::Integer(features)),
        ("hash_grid.log2_entries", Value::Integer(entries)),
        ("hash_grid.downweight", Value::Boolean(true)),
        ("occupancy.fraction", Value::Float(PROBED)),
        ("optimizer.learning_rate", Value::Float(RATES[0])),
        ("hash_grid.rate", Value::Float(RATES[1])),
    ];
    changes.retain(|(path, _)| !context.given(path));
    Proposal::Set {
        reason: "places have more detail than three planes can hold; features of cells narrower than a sample are down-weighted".into(),
        changes,
    }
}

/// Sets the finest level so that its cells follow the footprint of a pixel, but are never finer than configured.
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
