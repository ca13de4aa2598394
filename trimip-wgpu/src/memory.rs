//! What a training run will need on the GPU, by parts, before anything of it is allocated.

use crate::adapter::largest_binding;
use crate::backend::rooms;

use crate::field::{CHUNKS, padded};
use trimip_core::batch::{Interval, Radiance, Ray, Segment, Sphere, Target};
use trimip_core::config::Photographs;
use trimip_core::params::{Kind, color_layers, density_layers};
use trimip_core::tri_mip::{FEATURES, Pyramid};
use trimip_core::{Aabb, Config, Layout, Pixel, ViewSet};

/// Bytes of an f32.
const FLOAT: usize = size_of::<f32>();

/// Name and bytes of each part, on the configured adapter.
pub fn memory(config: &Config, views: &ViewSet) -> Vec<(String, u64)> {
    // Where there is no such adapter the run will not begin: its limits do not matter.
    predict(config, views, largest_binding(&config.wgpu.adapter).unwrap_or(u64::MAX))
}

/// The same for a device that binds at most `binding` bytes at once.
fn predict(config: &Config, views: &ViewSet, binding: u64) -> Vec<(String, u64)> {
    let layout = Layout::new(config);
    let pyramid = Pyramid::new(&config.encoder, &Aabb::new(&config.scene));
    let (marched, kept) = rooms(config, true, binding);
    // One ray of the trained state has some four kept samples; a quarter is to spare.
    let rays = config.train.samples_per_step as usize / 4 * 5 / 4;
    let widths = |layers: &[[usize; 2]]| layers.iter().map(|[_, outputs]| padded(*outputs)).sum::<usize>();
    let (density, color) = (density_layers(config), color_layers(config));

    // What is gathered is there twice: marched and kept.
    let samples = size_of::<Sphere>() + size_of::<Interval>() + size_of::<u32>();
    let asked = (FEATURES + widths(&density)) * FLOAT;
    let per_marched = 2 * (samples + asked) + size_of::<Radiance>() + size_of::<u32>();
    let hidden = padded(config.field.hidden as usize);
    let by_inputs = padded(color[0][0]) + padded(density[density.len() - 1][1]) + FEATURES;
    let by_outputs = padded(color[color.len() - 1][1]) + 2 * hidden;
    let per_kept = (padded(color[0][0]) + widths(&color) + by_inputs + by_outputs) * FLOAT
        + size_of::<Radiance>()
        + size_of::<u32>();

    let words = (config.renderer.steps_per_diagonal as usize).div_ceil(32) + 1;
    let per_ray = size_of::<Ray>()
        + size_of::<Target>()
        + size_of::<Pixel>()
        + size_of::<[f32; 4]>()
        + 2 * size_of::<Segment>()
        + words * size_of::<u32>();
    let cells = (config.occupancy.resolution as usize).pow(3);
    let layers = density.iter().chain(&color);
    let matrices: usize = layers.map(|[inputs, outputs]| padded(*inputs) * padded(*outputs)).sum();
    debug_assert!(layout.slots.iter().any(|slot| slot.kind == Kind::Network));
    let bytes = 4 * views.pixels.len();
    let streamed = config.wgpu.photographs == Photographs::Host || bytes as u64 > binding;
    let high = if config.wgpu.deterministic { pyramid.base_len() + pyramid.derived_len() } else { 0 };
    let part = |name: &str, bytes: usize| (name.to_string(), bytes as u64);
    vec![
        match streamed {
            true => part("pixels of a step, sent from the host", 4 * rays),
            false => part("training images", bytes),
        },
        part("parameters, gradient and moments", 4 * layout.len() * FLOAT),
        part("mip levels and their gradient", 2 * pyramid.derived_len() * FLOAT),
        part("high words of the gradient in fixed point", high * FLOAT),
        part("rays", rays * per_ray),
        part("marched samples, their features and densities", marched * per_marched),
        part("kept samples, their colours and gradients", kept * per_kept),
        part("matrices and their gradients", matrices * (2 + CHUNKS as usize) * FLOAT),
        part("occupancy grid", cells * (2 * FLOAT + size_of::<Radiance>()) + cells / 8),
    ]
}
