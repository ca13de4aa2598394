//! Predicts the peak resident memory of a training run, by parts, before anything is allocated.

use crate::encoder::gradient_memory;
use crate::mlp::BLOCK;
use crate::worker::SAMPLES_AT_ONCE;
use trimip_core::config::CameraPoses;
use trimip_core::engine::batch::{Interval, Radiance, Sphere};
use trimip_core::engine::trainer::{first_rays, most_kept};
use trimip_core::field::networks::geometry_width;
use trimip_core::field::params::{color_layers, density_layers};
use trimip_core::{Config, Layout, Pixel, ViewSet, field::encoders};

/// Bytes of the program, its libraries and its threads' allocators, on Linux.
const PROGRAM: u64 = 20_000_000;

/// Number of samples that a worker renders at once, relative to the target number. It varies because the number of
/// samples per ray is estimated from earlier rays.
const AT_ONCE: f64 = 1.3;

/// Capacity of partial gradients relative to the target number of samples: their fill level varies, and they grow by doubling.
const GRADIENTS_GROWN: f64 = 2.5;

/// Bytes of a float or an index.
const WORD: usize = 4;

/// Worst-case capacity of an array that grows by doubling, relative to its length.
const DOUBLED: usize = 2;

/// Fraction of the cells that an update samples, relative to `occupancy.fraction`: it samples uniformly drawn cells,
/// and occupied cells in addition.
const DRAWN_TWICE: f32 = 2.0;

/// Number of copies of a block's gradients in a backward pass: of a layer's outputs and of its inputs, each in f32 and
/// as pairs of bf16.
const BLOCK_COPIES: usize = 4;

/// Number of copies of a view's pixels during its evaluation: the device's and the frame's.
const RENDERED_COPIES: usize = 2;

/// Number of f32 RGB images during the evaluation of a view: rendering and photograph on two backgrounds each, the copy
/// for the file, and the difference.
const PICTURES: usize = 6;

/// Number of 8-bit RGB images on a sheet: rendering, photograph, difference.
const SHEET_PICTURES: usize = 3;

/// Returns the name and bytes of each part, for `threads` workers.
pub fn predict(config: &Config, views: &ViewSet, threads: usize, partials: usize) -> Vec<(String, u64)> {
    let layout = Layout::new(config);
    let floats = |count: usize| (WORD * count) as u64;
    let grown = |bytes: usize, factor: f64| (bytes as f64 * factor) as u64;
    let weights: usize = layout.networks().iter().map(|slot| slot.range.len()).sum();
    let cells = (config.occupancy.resolution as usize).pow(3);
    let gradient_memory = gradient_memory(config);
    let copies = floats(3 * layout.len() + cells);
    // Indices of the sampled cells, in an array that grows by doubling, and the densities of these cells.
    let probe = DOUBLED * WORD + size_of::<Radiance>();
    let asked = config.occupancy.warmup_fraction.max(DRAWN_TWICE * config.occupancy.fraction);
    let probes = (asked.min(1.0) * (cells * probe) as f32) as usize;
    vec![
        ("program".into(), PROGRAM),
        ("training images".into(), views.bytes() as u64),
        ("parameters".into(), floats(layout.len())),
        ("gradient".into(), floats(layout.len())),
        ("AdamW moments".into(), floats(2 * layout.len())),
        (
            "values derived from the parameters, and their gradient".into(),
            encoders::of(config).derived_bytes(config),
        ),
        (
            "feature gradients of a step".into(),
            grown(gradient_memory.by_sample * config.train.samples_per_step as usize, GRADIENTS_GROWN)
                .max((gradient_memory.by_sample * first_rays(config) as usize * most_kept(config)) as u64),
        ),
        (
            "network gradients".into(),
            floats(partials * weights) + (partials * gradient_memory.by_partial) as u64,
        ),
        ("occupancy grid and its probes".into(), (cells * WORD + cells / 8 + probes) as u64),
        ("activations of all workers".into(), threads as u64 * worker(config)),
        ("copies for a checkpoint, or a view being measured".into(), moments([copies, measured(views)])),
    ]
}

/// Returns the bytes of two temporary allocations that are never alive together: the larger one, and half of the
/// smaller one, which the allocator does not return.
fn moments(mut two: [u64; 2]) -> u64 {
    two.sort_unstable();
    two[1] + two[0] / 2
}

/// Returns the bytes that a worker holds while it renders rays through fog, which are more than during training.
fn worker(config: &Config) -> u64 {
    let outputs = |layers: &[[usize; 2]]| layers.iter().map(|[_, n]| n.next_multiple_of(4)).sum::<usize>();
    let sample = size_of::<Sphere>() + size_of::<Interval>() + size_of::<Radiance>() + size_of::<u32>();
    let encoding = encoders::stride(config) + encoders::of(config).context(config);
    let seen = sample + WORD * (encoding + outputs(&density_layers(config)));
    // The samples again on displaced rays, and one slope per sample.
    let displaced = match config.train.cameras {
        CameraPoses::Fixed => 0,
        CameraPoses::Refine => size_of::<Sphere>() + WORD * (encoding + 1),
    };
    // Visible samples are stored twice: front to back over all rays, and ray by ray with the colour network's
    // outputs.
    let row = displaced + 2 * seen + WORD * (outputs(&color_layers(config)) + geometry_width(config));
    // A block's gradients of a layer's outputs and inputs, in f32 and as pairs of bf16.
    let passing = BLOCK_COPIES * WORD * BLOCK * config.field.hidden.max(config.field.color_hidden) as usize;
    // A ray is never split, however many samples it has.
    let samples = SAMPLES_AT_ONCE.max(most_kept(config));
    (AT_ONCE * (samples * row + passing) as f64) as u64
}

/// Returns the bytes for the evaluation of a view: the device's pixels and the frame's; six f32 RGB images (rendering
/// and photograph on two backgrounds each, the store's copy, the difference); the photograph at all scales; and the
/// sheet of three images.
fn measured(views: &ViewSet) -> u64 {
    let sizes = views
        .views
        .iter()
        .map(|view| view.camera.intrinsics)
        .map(|k| u64::from(k.width) * u64::from(k.height));
    // The photograph at all scales has 4/3 of the pixels of the finest one, at 4 bytes per pixel.
    let photograph = 4 * 4 / 3;
    let sheets = SHEET_PICTURES * 3 + 3;
    let pixel = RENDERED_COPIES * size_of::<Pixel>() + PICTURES * size_of::<[f32; 3]>() + photograph + sheets;
    sizes.max().unwrap_or(0) * pixel as u64
}
