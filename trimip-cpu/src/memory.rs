//! What a training run will need, by parts, before anything of it is allocated.

use crate::scatter::BANDS;
use trimip_core::batch::{Interval, Radiance, Sphere};
use trimip_core::params::{Kind, color_layers, density_layers};
use trimip_core::tri_mip::{FEATURES, Pyramid};
use trimip_core::{Aabb, Config, Layout, ViewSet};

/// Rows of the largest span: a few rays through a grid that is still occupied everywhere.
const LARGEST_SPAN: usize = 4 * 1024;

/// Name and bytes of each part; `threads` workers.
pub fn predict(config: &Config, views: &ViewSet, threads: usize, deposits: usize) -> Vec<(String, u64)> {
    let layout = Layout::new(config);
    let pyramid = Pyramid::new(&config.encoder, &Aabb::new(&config.scene));
    let floats = |count: usize| 4 * count as u64;
    let weights: usize = layout.slots.iter().filter(|s| s.kind == Kind::Network).map(|s| s.range.len()).sum();
    let cells = (config.occupancy.resolution as usize).pow(3);
    let sample = 4 * FEATURES + size_of::<Sphere>() + 4 * 3 * 2;
    // Activations of both networks, features and gradients there and back.
    let widths: usize = density_layers(config).iter().chain(&color_layers(config)).map(|[_, n]| n).sum();
    let widest = 2 * config.field.hidden as usize;
    let row = 4 * (2 * FEATURES + 32 + widths + widest)
        + size_of::<Sphere>()
        + size_of::<Interval>()
        + 2 * size_of::<Radiance>()
        + 8;
    // Deposits are filled unevenly, up to twice their share, and their lists grow by doubling.
    let grown = |bytes: usize| 4 * bytes as u64;
    vec![
        ("training images".into(), views.bytes() as u64),
        ("parameters".into(), floats(layout.len())),
        ("gradient".into(), floats(layout.len())),
        ("AdamW moments".into(), floats(2 * layout.len())),
        ("mip levels and their gradient".into(), floats(2 * pyramid.derived_len())),
        ("feature gradients of a step".into(), grown(sample * config.train.samples_per_step as usize)),
        ("network gradients".into(), floats(deposits * weights) + (deposits * 3 * BANDS * 24) as u64),
        ("occupancy grid".into(), (cells * (4 + 4 + size_of::<Radiance>()) + cells / 8) as u64),
        ("activations of all workers".into(), (threads * LARGEST_SPAN * row) as u64),
        ("copies while a checkpoint is written".into(), floats(4 * layout.len() + cells)),
    ]
}
