//! Ray generation on the CPU: random pixels of the training views, or all pixels of a camera.

use crate::simd::fetch;
use crate::{CpuBackend, Lane};
use std::ops::Range;
use trimip_core::backend::Sampler;
use trimip_core::balance::Balance;
use trimip_core::batch::{Rays, Segment, Target};
use trimip_core::config::TrainConfig;
use trimip_core::rng::{Random, Stream, below};
use trimip_core::views::composite_pixel;
use trimip_core::{Camera, Config, ViewSet};

/// Number of pixels that are drawn and prefetched before the first of them is read.
const AHEAD: usize = 32;

/// The training views, and the distribution of rays among their scales.
pub struct CpuSampler {
    views: Option<ViewSet>,
    balance: Balance,
    background: [f32; 3],
    train: TrainConfig,
    /// Fraction of the pixels that get a random background.
    random_share: f32,
    /// Cones along a side of a pixel.
    side: u32,
    random: Random,
}

impl CpuSampler {
    /// A sampler over `views`. Without views it generates camera rays only.
    pub fn new(config: &Config, views: Option<ViewSet>) -> Self {
        let mut sampler = Self {
            views,
            balance: Balance::default(),
            background: config.data.background,
            train: config.train.clone(),
            random_share: 0.0,
            side: config.renderer.cones,
            random: Random::new(config.seed),
        };
        sampler.follow(0.0);
        sampler
    }

    /// Assigns a group of cones to each of the pixels `range`.
    fn group(&self, range: &Range<u32>, rays: &mut Rays<CpuBackend>) {
        let count = self.side * self.side;
        rays.first = range.start * count;
        rays.rays.resize(range.len() * count as usize);
        rays.groups.resize(range.len());
        for (group, i) in rays.groups.iter_mut().zip(0..) {
            *group = Segment { start: i * count, count };
        }
    }

    /// Generates the cones of a pixel, which is number `slot` of the span.
    #[inline]
    fn cones(&self, camera: &Camera, [x, y]: [u32; 2], rays: &mut Rays<CpuBackend>, slot: usize) {
        // The usual case, without divisions.
        if self.side == 1 {
            rays.rays[slot] = camera.cone(x, y).into();
            return;
        }
        let count = (self.side * self.side) as usize;
        let own = &mut rays.rays[slot * count..][..count];
        for (ray, index) in own.iter_mut().zip(0..) {
            *ray = camera.cone_in(x, y, index, self.side).into();
        }
    }
}

impl Sampler<CpuBackend> for CpuSampler {
    fn follow(&mut self, progress: f64) {
        if let Some(views) = &self.views {
            self.balance = Balance::new(&views.scales, self.train.scale_balance.at(progress));
        }
        self.random_share = self.train.random_share(progress);
    }

    fn training_rays(
        &self,
        _: &mut Lane,
        step: u64,
        total: u32,
        range: Range<u32>,
        rays: &mut Rays<CpuBackend>,
    ) {
        rays.targets.resize(range.len());
        self.group(&range, rays);
        let Some(views) = &self.views else {
            rays.rays.clear();
            rays.groups.clear();
            rays.targets.clear();
            return;
        };
        let begins: Vec<u32> = self.balance.begins(total).collect();
        // Random pixels are not in any cache: several are prefetched before the first is read.
        let mut drawn = [(0, 0); AHEAD];
        for (slot, index) in range.clone().enumerate() {
            if slot % AHEAD == 0 {
                for (drawn, index) in drawn.iter_mut().zip(index..range.end) {
                    let scale = begins.iter().rposition(|&begin| index >= begin).unwrap_or(0);
                    let pixels = &views.scales[scale].pixels;
                    let bits = self.random.bits(Stream::Pixel, step, index);
                    *drawn = (scale, pixels.start + below(bits[0], pixels.len() as u32) as usize);
                    fetch(&raw const views.pixels[drawn.1]);
                }
            }
            let (scale, pixel) = drawn[slot % AHEAD];
            let weight = self.balance.weight(scale);
            let scale = &views.scales[scale];
            let in_scale = &views.views[scale.views.clone()];
            let view = &in_scale[in_scale.partition_point(|view| view.offset <= pixel) - 1];
            let within = (pixel - view.offset) as u32;
            let width = view.camera.intrinsics.width;
            self.cones(&view.camera, [within % width, within / width], rays, slot);
            let mut background = self.background;
            if self.random_share > 0.0 {
                let [r, g, b, chance] = self.random.uniform(Stream::Background, step, index);
                if chance < self.random_share {
                    background = [r, g, b];
                }
            }
            rays.targets[slot] = Target {
                rgb: composite_pixel(views.pixels[pixel], views.alpha, background),
                weight,
                background,
                opacity: f32::from(views.pixels[pixel][3]) / 255.0,
            };
        }
    }

    fn camera_rays(&self, _: &mut Lane, camera: &Camera, range: Range<u32>, rays: &mut Rays<CpuBackend>) {
        rays.targets.clear();
        self.group(&range, rays);
        let width = camera.intrinsics.width;
        for (slot, index) in range.enumerate() {
            self.cones(camera, [index % width, index / width], rays, slot);
        }
    }
}
