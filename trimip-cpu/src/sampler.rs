//! Ray generation on the CPU: random pixels of the training views, or all pixels of a camera.

use crate::simd::fetch;
use crate::{CpuBackend, Lane};
use std::ops::Range;
use trimip_core::backend::Sampler;
use trimip_core::balance::{Balance, Draw, Shares};
use trimip_core::batch::{Rays, Segment, Target};
use trimip_core::cones::{self, Division};
use trimip_core::config::{Exposure, PhotographsConfig, TrainConfig};
use trimip_core::exposure::photographs;
use trimip_core::rng::{Random, Stream, below};
use trimip_core::views::composite_pixel;
use trimip_core::{Camera, Config, ViewSet};

/// Number of pixels that are drawn and prefetched before the first of them is read.
const AHEAD: usize = 32;

/// The training views, and the distribution of a step's pixels among their scales.
pub struct CpuSampler {
    training: Option<(ViewSet, Shares)>,
    /// The photograph of each view, with `loss.exposure`.
    photographs: Vec<u32>,
    balance: Balance,
    division: Division,
    data: PhotographsConfig,
    train: TrainConfig,
    /// Fraction of the pixels that get a random background.
    random_share: f32,
    random: Random,
}

impl CpuSampler {
    /// A sampler over `views`. Without views it generates camera rays only.
    pub fn new(config: &Config, views: Option<ViewSet>) -> Self {
        let shares = |views: ViewSet| {
            let shares = Shares::new(config, &views);
            (views, shares)
        };
        let exposed = config.loss.exposure == Exposure::Gain;
        let mut sampler = Self {
            photographs: views.iter().filter(|_| exposed).flat_map(photographs).collect(),
            training: views.map(shares),
            balance: Balance::default(),
            division: Division::new(config),
            data: config.data.clone(),
            train: config.train.clone(),
            random_share: 0.0,
            random: Random::new(config.seed),
        };
        sampler.follow(0.0);
        sampler
    }
}

/// Generates the cones of the next pixel of a span, `side` along each side.
#[inline]
fn divide(camera: &Camera, [x, y]: [u32; 2], side: u32, rays: &mut Rays<CpuBackend>) {
    let (start, count) = (rays.rays.len() as u32, cones::count(side));
    rays.groups.push(Segment { start, count });
    // The usual case, without divisions.
    if side == 1 {
        rays.rays.push(camera.cone(x, y).into());
        return;
    }
    for index in 0..count {
        rays.rays.push(camera.cone_in(x, y, index, side).into());
    }
}

impl Sampler<CpuBackend> for CpuSampler {
    fn follow(&mut self, progress: f64) {
        if let Some((_, shares)) = &self.training {
            self.balance = shares.at(progress);
        }
        self.random_share = self.train.random_share(progress);
    }

    fn balance(&self) -> &Balance {
        &self.balance
    }

    fn training_rays(
        &self,
        _: &mut Lane,
        step: u64,
        draw: &Draw,
        range: Range<u32>,
        rays: &mut Rays<CpuBackend>,
    ) {
        rays.rays.clear();
        rays.groups.clear();
        rays.targets.clear();
        rays.photographs.clear();
        rays.first = draw.cones_before(range.start);
        let Some((views, _)) = &self.training else { return };
        // Random pixels are not in any cache: several are prefetched before the first is read.
        let mut drawn = [(0, 0); AHEAD];
        for (slot, index) in range.clone().enumerate() {
            if slot % AHEAD == 0 {
                for (drawn, index) in drawn.iter_mut().zip(index..range.end) {
                    let scale = draw.scale(index);
                    let pixels = &views.scales[scale].pixels;
                    let bits = self.random.bits(Stream::Pixel, step, index);
                    *drawn = (scale, pixels.start + below(bits[0], pixels.len() as u32) as usize);
                    fetch(&raw const views.pixels[drawn.1]);
                }
            }
            let (scale, pixel) = drawn[slot % AHEAD];
            let (mut weight, side) = (self.balance.weight(scale), draw.sides()[scale]);
            let scale = &views.scales[scale];
            let exponent = self.data.edge_exponent(scale.factor);
            let in_scale = &views.views[scale.views.clone()];
            let place = in_scale.partition_point(|view| view.offset <= pixel) - 1;
            let view = &in_scale[place];
            if let Some(&photograph) = self.photographs.get(scale.views.start + place) {
                rays.photographs.push(photograph);
            }
            let within = (pixel - view.offset) as u32;
            let width = view.camera.intrinsics.width;
            let first = rays.rays.len();
            divide(&view.camera, [within % width, within / width], side, rays);
            // Nothing is learned from pixels that the lens has no ray for.
            if rays.rays[first..].iter().any(|ray| ray.slope == 0.0) {
                weight = 0.0;
            }
            let mut background = self.data.background;
            if self.random_share > 0.0 {
                let [r, g, b, chance] = self.random.uniform(Stream::Background, step, index);
                if chance < self.random_share {
                    background = [r, g, b];
                }
            }
            rays.targets.push(Target {
                rgb: composite_pixel(views.pixels[pixel], views.alpha, background),
                weight: weight * views.alpha.share(views.pixels[pixel]),
                background,
                opacity: views.alpha.opacity(views.pixels[pixel]),
                exponent,
            });
        }
    }

    fn camera_rays(&self, _: &mut Lane, camera: &Camera, range: Range<u32>, rays: &mut Rays<CpuBackend>) {
        rays.rays.clear();
        rays.groups.clear();
        rays.targets.clear();
        rays.photographs.clear();
        let (width, side) = (camera.intrinsics.width, self.division.side(camera));
        rays.first = 0;
        for index in range {
            divide(camera, [index % width, index / width], side, rays);
        }
    }
}
