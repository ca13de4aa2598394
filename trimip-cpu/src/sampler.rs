//! Ray generation on the CPU: random pixels of the training views, or all pixels of a camera.

use crate::buffer::Buffer;
use crate::simd::fetch;
use crate::{CpuBackend, WorkerScratch};
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering::Relaxed};
use trimip_core::engine::backend::Sampler;
use trimip_core::engine::batch::{Ray, Rays, Segment, Target};
use trimip_core::engine::error_map::{CellErrors, Drawn, ErrorMap, UNIT, error_of};
use trimip_core::engine::policy::SamplerPolicy;
use trimip_core::engine::ray_allocation::RayAllocation;
use trimip_core::math::rng::Sequence;
use trimip_core::scene::cones::PixelPattern;
use trimip_core::scene::depths::{DepthIndex, KnownDepth};
use trimip_core::scene::views::composite_pixel;
use trimip_core::{Camera, Config, ViewSet};

/// Number of pixels that are drawn and prefetched before the first of them is read.
const AHEAD: usize = 32;

/// The training views, and the policy that draws a step's pixels from them.
pub struct CpuSampler {
    policy: SamplerPolicy,
    views: Option<ViewSet>,
    depths: DepthIndex,
    /// Sum of errors and number of pixels of each cell of the error map. They are integers, so that their sums do not
    /// depend on the order of threads.
    errors: Vec<[AtomicU64; 2]>,
}

impl CpuSampler {
    /// Creates a sampler over `views`. Without views it generates only camera rays.
    pub fn new(config: &Config, views: Option<ViewSet>) -> Self {
        let depths = views.as_ref().map(|views| DepthIndex::new(&views.depths)).unwrap_or_default();
        let policy = SamplerPolicy::new(config, views.as_ref());
        let cells = policy.error_map().map_or(0, ErrorMap::len);
        let errors = (0..cells).map(|_| Default::default()).collect();
        Self { policy, views, depths, errors }
    }

    /// Returns the known depth of a pixel. Its deviation is 0 if the depth is unknown or unused.
    #[inline]
    fn known_depth(&self, views: &ViewSet, pixel: usize) -> KnownDepth {
        if !self.policy.knows_depths() {
            return KnownDepth::default();
        }
        self.depths.find(&views.depths, pixel).copied().unwrap_or_default()
    }
}

/// Appends the cones of a tile's next pixel to `rays`.
#[inline]
fn divide(camera: &Camera, [x, y]: [u32; 2], pattern: PixelPattern, rays: &mut Rays<CpuBackend>) {
    let (start, count) = (rays.rays.len() as u32, pattern.count());
    rays.groups.push(Segment { start, count });
    // A pixel of one cone, the usual case, needs no divisions.
    if pattern == PixelPattern::WHOLE {
        rays.rays.push(camera.cone(x, y).into());
        return;
    }
    for index in 0..count {
        rays.rays.push(camera.cone_in(x, y, index, pattern).into());
    }
}

impl Sampler<CpuBackend> for CpuSampler {
    fn policy(&self) -> &SamplerPolicy {
        &self.policy
    }

    fn policy_mut(&mut self) -> &mut SamplerPolicy {
        &mut self.policy
    }

    fn set_cameras(&mut self, cameras: &[Camera]) {
        let views = self.views.iter_mut().flat_map(|views| &mut views.views);
        views.zip(cameras).for_each(|(view, camera)| view.camera = *camera);
    }

    fn training_rays(
        &self,
        _: &mut WorkerScratch,
        step: u64,
        allocation: &RayAllocation,
        range: Range<u32>,
        rays: &mut Rays<CpuBackend>,
    ) {
        rays.rays.clear();
        rays.groups.clear();
        rays.targets.clear();
        rays.photographs.clear();
        rays.first = allocation.cones_before(range.start);
        let (policy, Some(views)) = (&self.policy, &self.views) else { return };
        let (scale_weights, random_background) = (policy.scale_weights(), policy.random_background());
        // Random pixels are not in any cache, so several pixels are prefetched before the first of them is read.
        let mut drawn = [Drawn { scale: 0, view: 0, pixel: 0, importance: 1.0 }; AHEAD];
        for (slot, index) in range.clone().enumerate() {
            if slot % AHEAD == 0 {
                for (drawn, index) in drawn.iter_mut().zip(index..range.end) {
                    *drawn = policy.pixel(&views.views, step, allocation, index);
                    fetch(&raw const views.pixels[drawn.pixel]);
                }
            }
            let Drawn { scale, view: place, pixel, importance } = drawn[slot % AHEAD];
            let pattern = allocation.patterns()[scale];
            let mut weight = scale_weights.weight(scale) * importance;
            let exponent = policy.exponents[scale];
            let scale = &views.scales[scale];
            let place = scale.views.start + place;
            let view = &views.views[place];
            if let Some(&photograph) = policy.photographs.get(place) {
                rays.photographs.push(photograph);
            }
            let within = (pixel - view.offset) as u32;
            let width = view.camera.intrinsics.width;
            let first = rays.rays.len();
            divide(&view.camera, [within % width, within / width], pattern, rays);
            // Pixels for which the lens has no ray get no weight.
            if rays.rays[first..].iter().any(Ray::is_none) {
                weight = 0.0;
            }
            let mut background = policy.background;
            if random_background > 0.0 {
                let [r, g, b, chance] = policy.random.uniform(Sequence::Background, step, index);
                if chance < random_background {
                    background = [r, g, b];
                }
            }
            let known = self.known_depth(views, pixel);
            rays.targets.push(Target {
                rgb: composite_pixel(views.pixels[pixel], views.alpha, background),
                weight: weight * views.alpha.fraction(views.pixels[pixel]),
                background,
                opacity: views.alpha.opacity(views.pixels[pixel]),
                exponent,
                distance: known.distance,
                deviation: known.deviation,
                importance,
            });
        }
    }

    fn observe(
        &self,
        _: &mut WorkerScratch,
        step: u64,
        range: Range<u32>,
        rays: &Rays<CpuBackend>,
        pixel_gradients: &Buffer<[f32; 4]>,
    ) {
        let Some(map) = self.policy.error_map() else { return };
        // The error cells are as random as the pixels, so they are prefetched in the same way.
        let mut cells = [0; AHEAD];
        let tiles = rays.targets.chunks(AHEAD).zip(pixel_gradients.chunks(AHEAD));
        for (first, (targets, gradients)) in range.step_by(AHEAD).zip(tiles) {
            for (cell, index) in cells[..targets.len()].iter_mut().zip(first..) {
                *cell = self.policy.cell(map, step, index);
                fetch(&raw const self.errors[*cell]);
            }
            for ((target, gradient), cell) in targets.iter().zip(gradients).zip(cells) {
                if target.weight > 0.0 {
                    let [error, count] = &self.errors[cell];
                    error.fetch_add((error_of(*gradient, target.weight) * UNIT) as u64, Relaxed);
                    count.fetch_add(1, Relaxed);
                }
            }
        }
    }

    fn take_errors(&mut self) -> Vec<CellErrors> {
        self.errors.iter_mut().map(|sums| sums.each_mut().map(|sum| std::mem::take(sum.get_mut()))).collect()
    }

    fn set_error_map(&mut self, map: ErrorMap) {
        self.policy.set_error_map(map);
    }

    fn camera_rays(
        &self,
        _: &mut WorkerScratch,
        camera: &Camera,
        range: Range<u32>,
        rays: &mut Rays<CpuBackend>,
    ) {
        rays.rays.clear();
        rays.groups.clear();
        rays.targets.clear();
        rays.photographs.clear();
        let (width, pattern) = (camera.intrinsics.width, self.policy.division.pattern(camera));
        rays.first = 0;
        for index in range {
            divide(camera, [index % width, index / width], pattern, rays);
        }
    }
}
