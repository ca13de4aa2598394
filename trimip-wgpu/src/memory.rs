//! Predicts the GPU memory of a training run, by parts, before anything is allocated.

use crate::capacity::Capacity;
use crate::gpu::largest_binding;
use crate::mlp::CHUNKS;
use crate::products::padded;
use crate::settings::{Photographs, WgpuConfig};
use std::collections::BTreeSet;
use trimip_core::config::CameraPoses;
use trimip_core::engine::batch::{Interval, Radiance, Ray, Segment, Sphere, Target};
use trimip_core::field::encoders;
use trimip_core::field::params::{color_layers, density_layers};
use trimip_core::scene::depths::KnownDepth;
use trimip_core::{Config, Layout, Pixel, Space, ViewSet};

/// Bytes of an f32.
const FLOAT: usize = size_of::<f32>();

/// Number of kept samples per ray of a trained model.
const KEPT_PER_RAY: usize = 4;

/// Capacity for rays relative to their expected number, as a fraction: [numerator, denominator].
const RAYS_SPARE: [usize; 2] = [5, 4];

/// Number of arrays as long as the parameters: parameters, gradient and two AdamW moments.
const PARAMETER_COPIES: usize = 4;

/// Number of copies of a layer's matrix: the matrix and its transpose. The chunks of its gradient are counted
/// separately.
const MATRIX_COPIES: usize = 2;

/// Returns the name and bytes of each part, on the configured adapter.
pub fn memory(config: &Config, views: &ViewSet) -> Vec<(String, u64)> {
    // If there is no such adapter, or a setting is refused, the run does not start and its limits do not matter.
    let Ok(own) = config.section::<WgpuConfig>() else { return Vec::new() };
    predict(config, &own, views, largest_binding(&own.adapter).unwrap_or(u64::MAX))
}

/// Predicts the memory as [`memory`] does, for a device whose largest binding has `binding` bytes.
fn predict(config: &Config, own: &WgpuConfig, views: &ViewSet, binding: u64) -> Vec<(String, u64)> {
    let layout = Layout::new(config);
    let derived = encoders::of(config).derived_bytes(config) as usize;
    let parameters: usize = layout.encoder().iter().map(|slot| slot.padded().len()).sum();
    let Capacity { marched, kept } = Capacity::new(config, true, binding);
    // A step has the same number of samples, however many cones a pixel has.
    let rays = config.train.samples_per_step as usize / KEPT_PER_RAY * RAYS_SPARE[0] / RAYS_SPARE[1];
    let widths = |layers: &[[usize; 2]]| layers.iter().map(|[_, outputs]| padded(*outputs)).sum::<usize>();
    let (density, color) = (density_layers(config), color_layers(config));

    // Arrays that are gathered exist twice: for marched and for kept samples.
    let samples = size_of::<Sphere>() + size_of::<Interval>() + size_of::<u32>();
    let encoding = encoders::stride(config) + encoders::of(config).context(config);
    let asked = (encoding + widths(&density)) * FLOAT;
    let per_marched = 2 * (samples + asked) + size_of::<Radiance>() + size_of::<u32>();
    let hidden = padded(config.field.hidden.max(config.field.color_hidden) as usize);
    let color_inputs = color.first().map_or(0, |[inputs, _]| padded(*inputs));
    let last = |layers: &[[usize; 2]]| layers.last().map_or(padded(1), |[_, outputs]| padded(*outputs));
    let by_outputs = last(&color) + 2 * hidden;
    let refines = config.train.cameras == CameraPoses::Refine;
    // The samples again on displaced rays, and one slope per sample.
    let displaced = if refines { size_of::<Sphere>() + (encoding + 1) * FLOAT } else { 0 };
    // For the draw of samples: one mark per sample, and one spare array per width for gradients and the colour
    // network's activations.
    let draws = config.train.backward_fraction.values().any(|fraction| fraction < 1.0);
    let outputs = color.iter().map(|[_, outputs]| padded(*outputs));
    let spares: BTreeSet<usize> = outputs.chain([color_inputs, size_of::<Radiance>() / FLOAT]).collect();
    let drawn = if draws { (1 + spares.iter().sum::<usize>()) * FLOAT } else { 0 };
    // The colour network runs once per sample, or once per ray with deferred shading.
    let per_color = (2 * color_inputs + widths(&color) + by_outputs) * FLOAT;
    let (of_rays, of_kept) = match config.field.deferred {
        true => (per_color + last(&density) * FLOAT, (2 * hidden + 1) * FLOAT),
        false => (0, per_color),
    };
    let per_kept = of_kept
        + (last(&density) + encoders::stride(config)) * FLOAT
        + drawn
        + size_of::<Radiance>()
        + size_of::<u32>()
        + displaced;

    let words = Space::<f32>::new(&config.scene).most_steps(config.step_length()).div_ceil(32);
    let per_ray = size_of::<Ray>() * (1 + usize::from(refines))
        + size_of::<Target>()
        + 2 * size_of::<Pixel>()
        + size_of::<[f32; 4]>()
        + 3 * size_of::<Segment>()
        + words * size_of::<u32>()
        + of_rays;
    let cells = (config.occupancy.resolution as usize).pow(3);
    let layers = density.iter().chain(&color);
    let matrices: usize = layers.map(|[inputs, outputs]| padded(*inputs) * padded(*outputs)).sum();
    let bytes = 4 * views.pixels.len();
    let streamed = own.photographs == Photographs::Host || bytes as u64 > binding;
    let high = if own.deterministic { parameters * FLOAT + derived / 2 } else { 0 };
    let part = |name: &str, bytes: usize| (name.to_string(), bytes as u64);
    vec![
        match streamed {
            true => part("pixels of a step, sent from the host", 4 * rays),
            false => part("training images", bytes),
        },
        part("known depths of pixels", size_of::<KnownDepth>() * views.depths.len()),
        part("parameters, gradient and moments", PARAMETER_COPIES * layout.len() * FLOAT),
        part("values derived from the parameters, and their gradient", derived),
        part("high words of the gradient in fixed point", high),
        part("rays", rays * per_ray),
        part("marched samples, their features and densities", marched * per_marched),
        part("kept samples, their colours and gradients", kept * per_kept),
        part("matrices and their gradients", matrices * (MATRIX_COPIES + CHUNKS as usize) * FLOAT),
        part("occupancy grid", cells * (2 * FLOAT + size_of::<Radiance>()) + cells / 8),
    ]
}
