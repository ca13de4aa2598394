//! Where rays come from on the CPU: random pixels of the training views, or all pixels of a camera.

use crate::simd::fetch;
use crate::{CpuBackend, Lane};
use std::ops::Range;
use trimip_core::backend::Sampler;
use trimip_core::batch::{Rays, Target};
use trimip_core::config::TrainBackground;
use trimip_core::rng::{Random, Stream, below};
use trimip_core::views::composite_pixel;
use trimip_core::{Camera, Config, ViewSet};

/// Pixels that are drawn before the first of them is read.
const AHEAD: usize = 32;

/// Training views and the share of each scale.
pub struct CpuSampler {
    views: Option<ViewSet>,
    /// Share of a batch's rays per scale, ∝ 1/weight: each scale then has the same part of the loss.
    shares: Vec<f64>,
    background: [f32; 3],
    train_background: TrainBackground,
    random: Random,
}

impl CpuSampler {
    /// A sampler over `views`; without them it makes camera rays only.
    pub fn new(config: &Config, views: Option<ViewSet>) -> Self {
        let weights: Vec<f64> = views
            .iter()
            .flat_map(|views| &views.scales)
            .map(|scale| if scale.pixels.is_empty() { 0.0 } else { 1.0 / f64::from(scale.weight) })
            .collect();
        let sum: f64 = weights.iter().sum();
        Self {
            views,
            shares: weights.into_iter().map(|weight| weight / sum).collect(),
            background: config.data.background,
            train_background: config.train.background,
            random: Random::new(config.seed),
        }
    }

    /// Scale of ray `index` of `total`: coarse scales take their rounded-down share from the end, the finest the rest.
    fn scale_of(&self, index: u32, total: u32) -> usize {
        let mut end = total;
        for (scale, share) in self.shares.iter().enumerate().skip(1).rev() {
            end -= (f64::from(total) * share) as u32;
            if index >= end {
                return scale;
            }
        }
        0
    }
}

impl Sampler<CpuBackend> for CpuSampler {
    fn training_rays(
        &self,
        _: &mut Lane,
        step: u64,
        total: u32,
        range: Range<u32>,
        rays: &mut Rays<CpuBackend>,
    ) {
        rays.first = range.start;
        rays.rays.resize(range.len());
        rays.targets.resize(range.len());
        let Some(views) = &self.views else {
            rays.rays.clear();
            rays.targets.clear();
            return;
        };
        // Random pixels are out of every cache: some are asked for before the first is read.
        let mut drawn = [(0, 0); AHEAD];
        for (slot, index) in range.clone().enumerate() {
            if slot % AHEAD == 0 {
                for (drawn, index) in drawn.iter_mut().zip(index..range.end) {
                    let scale = self.scale_of(index, total);
                    let pixels = &views.scales[scale].pixels;
                    let bits = self.random.bits(Stream::Pixel, step, index);
                    *drawn = (scale, pixels.start + below(bits[0], pixels.len() as u32) as usize);
                    fetch(&raw const views.pixels[drawn.1]);
                }
            }
            let (scale, pixel) = drawn[slot % AHEAD];
            let scale = &views.scales[scale];
            let in_scale = &views.views[scale.views.clone()];
            let view = &in_scale[in_scale.partition_point(|view| view.offset <= pixel) - 1];
            let within = (pixel - view.offset) as u32;
            let width = view.camera.intrinsics.width;
            rays.rays[slot] = view.camera.cone(within % width, within / width).into();
            let background = match self.train_background {
                TrainBackground::Fixed => self.background,
                TrainBackground::Random => {
                    let [r, g, b, _] = self.random.uniform(Stream::Background, step, index);
                    [r, g, b]
                }
            };
            rays.targets[slot] = Target {
                rgb: composite_pixel(views.pixels[pixel], views.alpha, background),
                weight: scale.weight,
                background,
            };
        }
    }

    fn camera_rays(&self, _: &mut Lane, camera: &Camera, range: Range<u32>, rays: &mut Rays<CpuBackend>) {
        rays.first = range.start;
        rays.targets.clear();
        rays.rays.resize(range.len());
        let width = camera.intrinsics.width;
        for (ray, index) in rays.rays.iter_mut().zip(range) {
            *ray = camera.cone(index % width, index / width).into();
        }
    }
}
