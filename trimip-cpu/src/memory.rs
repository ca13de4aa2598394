//! What a training run will need, by parts, before anything of it is allocated: resident bytes at the worst moment.

use crate::backend::SAMPLES_AT_ONCE;
use crate::mlp::BLOCK;
use crate::scatter::BANDS;
use trimip_core::batch::{Interval, Radiance, Sphere};
use trimip_core::params::{Kind, color_layers, density_layers};
use trimip_core::tri_mip::{FEATURES, Pyramid};
use trimip_core::{Aabb, Config, Layout, Pixel, ViewSet};

/// The program itself with its libraries, and the threads' own allocators, on Linux.
const PROGRAM: u64 = 10_000_000;

/// Samples of the rays that a worker renders at once, in parts of what they should have: the longest ray is guessed from
/// the rays before.
const AT_ONCE: f64 = 1.3;

/// Room that deposits take for the samples that a step aims at: their fill varies from step to step, and they grow by
/// doubling.
const DEPOSITS_GROWN: f64 = 2.5;

/// Name and bytes of each part; `threads` workers.
pub fn predict(config: &Config, views: &ViewSet, threads: usize, deposits: usize) -> Vec<(String, u64)> {
    let layout = Layout::new(config);
    let pyramid = Pyramid::new(&config.encoder, &Aabb::new(&config.scene));
    let floats = |count: usize| 4 * count as u64;
    let grown = |bytes: usize, factor: f64| (bytes as f64 * factor) as u64;
    let weights: usize = layout.slots.iter().filter(|s| s.kind == Kind::Network).map(|s| s.range.len()).sum();
    let cells = (config.occupancy.resolution as usize).pow(3);
    // A sample's gradient, its place, and its number in the lists of the bands that it touches.
    let deposit = 4 * FEATURES + size_of::<Sphere>() + 4 * 3 * 2;
    let copies = floats(4 * layout.len() + cells);
    // Numbers of the cells that are asked at once, gathered by doubling, and their densities.
    let probe = 2 * 4 + size_of::<Radiance>();
    let asked = config.occupancy.warmup_fraction.max(2.0 * config.occupancy.fraction);
    let probes = (asked.min(1.0) * (cells * probe) as f32) as usize;
    vec![
        ("program".into(), PROGRAM),
        ("training images".into(), views.bytes() as u64),
        ("parameters".into(), floats(layout.len())),
        ("gradient".into(), floats(layout.len())),
        ("AdamW moments".into(), floats(2 * layout.len())),
        ("mip levels and their gradient".into(), floats(2 * pyramid.derived_len())),
        (
            "feature gradients of a step".into(),
            grown(deposit * config.train.samples_per_step as usize, DEPOSITS_GROWN),
        ),
        ("network gradients".into(), floats(deposits * weights) + (deposits * 3 * BANDS * 24) as u64),
        ("occupancy grid and its probes".into(), (cells * 4 + cells / 8 + probes) as u64),
        ("activations of all workers".into(), grown(threads * worker(config), AT_ONCE)),
        ("copies for a checkpoint, or a view being measured".into(), copies.max(measured(views))),
    ]
}

/// Bytes that a worker holds while it renders rays through fog, which is more than while it trains.
fn worker(config: &Config) -> usize {
    let outputs = |layers: &[[usize; 2]]| layers.iter().map(|[_, n]| n.next_multiple_of(4)).sum::<usize>();
    let sample = size_of::<Sphere>() + size_of::<Interval>() + size_of::<Radiance>() + size_of::<u32>();
    let seen = sample + 4 * (FEATURES + outputs(&density_layers(config)));
    // What is seen is there twice: front to back over all rays, and ray by ray, where the colour network follows.
    let row = 2 * seen + 4 * outputs(&color_layers(config));
    // A block's gradients above and below a layer, in f32 and as pairs of bf16.
    let passing = 4 * 4 * BLOCK * config.field.hidden as usize;
    SAMPLES_AT_ONCE * row + passing
}

/// Bytes of a view while it is measured: rendered as the device's pixels and the frame's, then six pictures of f32 RGB (two
/// backgrounds of either, the store's copy, the difference), the photograph at all scales, and the sheet of three pictures.
fn measured(views: &ViewSet) -> u64 {
    let sizes = views
        .views
        .iter()
        .map(|view| view.camera.intrinsics)
        .map(|k| u64::from(k.width) * u64::from(k.height));
    let pixel = 2 * size_of::<Pixel>() + 6 * size_of::<[f32; 3]>() + 4 * 4 / 3 + 3 * 3 + 3;
    sizes.max().unwrap_or(0) * pixel as u64
}
