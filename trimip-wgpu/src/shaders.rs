//! The parts of WGSL that several stages share, and the constants that WGSL shares with Rust. Most parts mirror core's
//! mathematics.

use crate::gpu::Source::{self, Constant, Parts, Text};
use crate::gpu::Value;
use std::mem::offset_of;
use trimip_core::Pixel;
use trimip_core::config::DensityFunction;
use trimip_core::engine::batch::{Ray, Target};
use trimip_core::field::activation::LARGEST_ARGUMENT;
use trimip_core::geometry::camera::FARTHEST_APEX;
use trimip_core::math::compositing::BRIGHTEST;
use trimip_core::math::sh::FACTORS;
use trimip_core::math::voronoi::SITES;

/// Number of cells along a side of a block of the occupancy grid, and number of blocks along a side of a block of
/// blocks.
pub const SIDE: u32 = 4;

/// Fixed-point value of 1: gradients have 30 fractional bits.
pub const POINT: u32 = 1 << 30;

mirror!(Ray as Ray { origin: [f32; 3], slope: f32, direction: [f32; 3], cosine: f32, radius: f32 });

/// Shader source: the axis of a cone.
pub const RAY: Source = Parts(&[
    Source::of::<Ray>(),
    Source::real("FARTHEST_APEX", FARTHEST_APEX as f32),
    Text(include_str!("shaders/ray.wgsl")),
]);

/// Returns the number of words in `bytes` bytes.
pub const fn words(bytes: usize) -> u32 {
    (bytes / size_of::<u32>()) as u32
}

/// Shader constant: number of floats of a pixel in an array of floats.
pub const PIXEL: Source = Source::whole("PIXEL_FLOATS", words(size_of::<Pixel>()));

/// Shader constants for the layout of targets in an array of floats: the number of floats of a target, and the offsets
/// of its members. The colour comes first.
pub const TARGET: Source = Parts(&[
    Source::whole("TARGET_FLOATS", words(size_of::<Target>())),
    Source::whole("TARGET_WEIGHT", words(offset_of!(Target, weight))),
    Source::whole("TARGET_BACKGROUND", words(offset_of!(Target, background))),
    Source::whole("TARGET_OPACITY", words(offset_of!(Target, opacity))),
    Source::whole("TARGET_EXPONENT", words(offset_of!(Target, exponent))),
    Source::whole("TARGET_DISTANCE", words(offset_of!(Target, distance))),
    Source::whole("TARGET_DEVIATION", words(offset_of!(Target, deviation))),
    Source::whole("TARGET_IMPORTANCE", words(offset_of!(Target, importance))),
]);

/// Shader source: two unit vectors perpendicular to a direction.
pub const BASIS: Source = Text(include_str!("shaders/basis.wgsl"));

/// Shader source: random numbers.
pub const RANDOM: Source = Text(include_str!("shaders/random.wgsl"));

/// Shader source: location of a cell's bit.
pub const BLOCKS: Source = Parts(&[Source::whole("SIDE", SIDE), Text(include_str!("shaders/blocks.wgsl"))]);

/// Shader source: the part of a segment that fits into its arrays.
pub const SEGMENTS: Source = Text(include_str!("shaders/segments.wgsl"));

/// Shader source: opacity of a sample.
pub const COMPOSITING: Source =
    Parts(&[Source::real("BRIGHTEST", BRIGHTEST as f32), Text(include_str!("shaders/compositing.wgsl"))]);

/// Shader source: the rule that determines which samples of a ray are kept.
pub const PRUNING: Source = Text(include_str!("shaders/pruning.wgsl"));

/// Shader source: activation functions of the networks' outputs.
pub const ACTIVATION: Source = Parts(&[
    Source::whole("EXP", DensityFunction::Exp as u32),
    Source::whole("SOFTPLUS", DensityFunction::Softplus as u32),
    Source::real("LARGEST_ARGUMENT", LARGEST_ARGUMENT as f32),
    Text(include_str!("shaders/activation.wgsl")),
]);

/// Shader source: spherical harmonics of a direction.
pub const HARMONICS: Source =
    Parts(&[Constant("SH", Value::Reals(&FACTORS)), Text(include_str!("shaders/harmonics.wgsl"))]);

/// Shader source: weights of soft Voronoi cells for a direction.
pub const VORONOI: Source =
    Parts(&[Constant("SITES", Value::Reals(&SITES)), Text(include_str!("shaders/voronoi.wgsl"))]);

/// Shader source: 64-bit fixed point.
pub const FIXED: Source =
    Parts(&[Source::real("POINT", POINT as f32), Text(include_str!("shaders/fixed.wgsl"))]);

const SUMS: Source = Text(include_str!("shaders/sums.wgsl"));

/// Shader source: sums of an f32 over a workgroup.
pub const SUM: Source = Parts(&[Text("alias Sum = f32;\n"), SUMS]);

/// Shader source: sums of four f32 over a workgroup.
pub const SUM_OF_FOUR: Source = Parts(&[Text("alias Sum = vec4<f32>;\n"), SUMS]);

/// Largest f16.
const MOST_HALF: f32 = 65504.0;

/// Shader source: conversion to f16.
pub const HALF: Source =
    Parts(&[Source::real("MOST_HALF", MOST_HALF), Text(include_str!("shaders/half.wgsl"))]);
