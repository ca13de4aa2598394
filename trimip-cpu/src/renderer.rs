//! Marching, pruning and compositing on the CPU, ray by ray.

use crate::buffer::Buffer;
use crate::hybrid::Hybrid;
use crate::march::March;
use crate::occupancy::CpuOccupancy;
use crate::simd::Simd;
use crate::visibility::visibility_pass;
use crate::{CpuBackend, WorkerScratch};
use trimip_core::engine::backend::Stages;
use trimip_core::engine::batch::{
    Interval, Radiance, Ray, Rays, Samples, Segment, StepResult, Target, Tile, Workspace,
};
use trimip_core::engine::policy::RendererPolicy;
use trimip_core::engine::proxy::Guide;
use trimip_core::math::compositing::{Visibility, composite, composite_gradient};
use trimip_core::{Config, Pixel, Renderer, Result};

/// The renderer: its policy, and the guide of hybrid rendering.
pub struct CpuRenderer {
    pub(crate) simd: Simd,
    pub(crate) policy: RendererPolicy,
    /// Chooses the samples in hybrid rendering; `None` in training and volume rendering.
    pub(crate) hybrid: Option<Hybrid>,
}

impl CpuRenderer {
    /// Creates the renderer of a configuration.
    pub fn new(simd: Simd, config: &Config) -> Self {
        Self { simd, policy: RendererPolicy::new(config), hybrid: None }
    }
}

impl Renderer<CpuBackend> for CpuRenderer {
    fn policy(&self) -> &RendererPolicy {
        &self.policy
    }

    fn policy_mut(&mut self) -> &mut RendererPolicy {
        &mut self.policy
    }

    fn set_guide(&mut self, guide: Option<Guide>) -> Result<()> {
        self.hybrid = guide.map(Hybrid);
        Ok(())
    }

    fn visibility_pass(
        &self,
        stages: &Stages<CpuBackend>,
        parameters: &Buffer<f32>,
        workspace: &mut Workspace<CpuBackend>,
        jitter: Option<u64>,
    ) {
        visibility_pass(stages, parameters, workspace, jitter);
    }

    fn march(
        &self,
        _: &mut WorkerScratch,
        rays: &Rays<CpuBackend>,
        occupancy: &CpuOccupancy,
        jitter: Option<u64>,
        samples: &mut Samples<CpuBackend>,
    ) {
        self.simd.run(March { policy: &self.policy, rays, occupancy, jitter, samples });
    }

    fn prune(
        &self,
        _: &mut WorkerScratch,
        radiance: &Buffer<Radiance>,
        samples: &mut Samples<CpuBackend>,
        kept: &mut Buffer<u32>,
    ) {
        kept.clear();
        for segment in samples.segments.iter_mut() {
            let start = kept.len() as u32;
            let mut passed = self.policy.pruning.behind(0.0);
            for i in segment.start..segment.start + segment.count {
                let length = &mut samples.intervals[i as usize].length;
                let own = radiance[i as usize].density * *length;
                match self.policy.pruning.decide(&mut passed, own) {
                    Visibility::Keep(factor) => {
                        *length *= factor;
                        kept.push(i);
                    }
                    Visibility::Merge => {}
                    Visibility::Terminate => break,
                }
            }
            *segment = Segment { start, count: kept.len() as u32 - start };
        }
        samples.rays.keep_rows(kept, 1);
        samples.intervals.keep_rows(kept, 1);
        samples.spheres.keep_rows(kept, 1);
        samples.counts[0][1] = kept.len() as u32;
    }

    fn keep_drawn(
        &self,
        _: &mut WorkerScratch,
        marks: &Buffer<u32>,
        samples: &mut Samples<CpuBackend>,
        drawn: &mut Buffer<u32>,
        sums: &mut StepResult,
    ) {
        let kept = samples.spheres.len();
        drawn.clear();
        for segment in samples.segments.iter_mut() {
            let start = drawn.len() as u32;
            for row in segment.start..segment.start + segment.count {
                if marks[row as usize] == 1 {
                    drawn.push(row);
                }
            }
            *segment = Segment { start, count: drawn.len() as u32 - start };
        }
        // The loss has counted all kept samples as drawn.
        sums.sums.drawn = sums.sums.drawn.saturating_sub((kept - drawn.len()) as u64);
        samples.rays.keep_rows(drawn, 1);
        samples.intervals.keep_rows(drawn, 1);
        samples.spheres.keep_rows(drawn, 1);
    }

    fn composite(
        &self,
        tile: &mut Tile<'_, CpuBackend>,
        radiance: &Buffer<Radiance>,
        cones: &mut Buffer<Pixel>,
        pixels: &mut Buffer<Pixel>,
    ) {
        let (rays, samples) = (tile.rays, tile.samples);
        cones.resize(rays.rays.len());
        pixels.resize(rays.groups.len());
        let (segments, rays_of, targets): (&[Segment], &[Ray], &[Target]) =
            (&samples.segments, &rays.rays, &rays.targets);
        let (intervals, radiance): (&[Interval], &[Radiance]) = (&samples.intervals, radiance);
        let cones: &mut [Pixel] = cones;
        for (i, (pixel, group)) in pixels.iter_mut().zip(rays.groups.iter()).enumerate() {
            let background = targets.get(i).map_or(self.policy.background, |target| target.background);
            let group = group.range();
            let parts = segments[group.clone()].iter().zip(&rays_of[group.clone()]);
            for (cone, (segment, ray)) in cones[group.clone()].iter_mut().zip(parts) {
                let own = intervals[segment.range()].iter().zip(&radiance[segment.range()]);
                let result = composite(
                    own.map(|(interval, own)| (own.density * interval.length, own.rgb, interval.t)),
                    background,
                );
                let depth = result.distance * ray.cosine;
                *cone = Pixel { rgb: result.rgb, opacity: result.opacity, depth };
            }
            *pixel = Pixel::mean(&cones[group]);
        }
    }

    fn backward(
        &self,
        tile: &mut Tile<'_, CpuBackend>,
        radiance: &Buffer<Radiance>,
        cones: &Buffer<Pixel>,
        pixel_gradients: &Buffer<[f32; 4]>,
        radiance_gradients: &mut Buffer<Radiance>,
    ) {
        let (rays, samples) = (tile.rays, tile.samples);
        radiance_gradients.resize(radiance.len());
        for (group, &gradient) in rays.groups.iter().zip(pixel_gradients.iter()) {
            let fraction = (group.count as f32).recip();
            let gradient = gradient.map(|g| g * fraction);
            for (cone, segment) in cones[group.range()].iter().zip(&samples.segments[group.range()]) {
                let first = segment.start as usize;
                composite_gradient(
                    segment.count as usize,
                    |i| {
                        let i = first + i;
                        (radiance[i].density * samples.intervals[i].length, radiance[i].rgb)
                    },
                    cone.channels(),
                    gradient,
                    |i, by_depth, rgb| {
                        let i = first + i;
                        radiance_gradients[i] =
                            Radiance { rgb, density: by_depth * samples.intervals[i].length };
                    },
                );
            }
        }
    }
}
