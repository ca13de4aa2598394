//! What a training run will need on the GPU, by parts, before anything of it is allocated.

use crate::backend::MARCHED_PER_KEPT;
use crate::field::CHUNKS;
use trimip_core::batch::{Interval, Radiance, Sphere};
use trimip_core::params::{Kind, color_layers, density_layers};
use trimip_core::tri_mip::{FEATURES, Pyramid};
use trimip_core::{Aabb, Config, Layout, ViewSet};

/// Name and bytes of each part.
pub fn memory(config: &Config, views: &ViewSet) -> Vec<(String, u64)> {
    let layout = Layout::new(config);
    let pyramid = Pyramid::new(&config.encoder, &Aabb::new(&config.scene));
    let floats = |count: usize| 4 * count as u64;
    let room = MARCHED_PER_KEPT * config.train.samples_per_step as usize;
    let cells = (config.occupancy.resolution as usize).pow(3);
    let outputs = |layers: Vec<[usize; 2]>| {
        layers.iter().map(|[_, outputs]| outputs.next_multiple_of(16)).sum::<usize>()
    };
    let density = outputs(density_layers(config));
    let color = outputs(color_layers(config));
    // Rows that are gathered are there twice.
    let sample = 2 * (FEATURES + density) * 4
        + 2 * (size_of::<Sphere>() + size_of::<Interval>() + size_of::<Radiance>() + 4)
        + (color + 32 + 16 + 32 + 16 + FEATURES + 2 * config.field.hidden as usize) * 4
        + size_of::<Radiance>()
        + 8;
    let weights: usize = layout.slots.iter().filter(|s| s.kind == Kind::Network).map(|s| s.range.len()).sum();
    vec![
        ("training images".into(), 4 * views.pixels.len() as u64),
        ("parameters, gradient and moments".into(), floats(4 * layout.len())),
        ("mip levels and their gradient".into(), floats(2 * pyramid.derived_len())),
        (
            "high words of the gradient in fixed point".into(),
            match config.wgpu.deterministic {
                true => floats(pyramid.base_len() + pyramid.derived_len()),
                false => 0,
            },
        ),
        ("samples and activations".into(), (room * sample) as u64),
        ("network gradients".into(), floats(weights * CHUNKS as usize)),
        ("occupancy grid".into(), (cells * (4 + 4 + size_of::<Radiance>()) + cells / 8) as u64),
    ]
}
