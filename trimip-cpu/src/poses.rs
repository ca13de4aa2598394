//! Gradients with respect to camera poses on the CPU: the features on rays that are displaced to both sides, times the
//! gradients with respect to the features.

use crate::CpuBackend;
use crate::buffer::Buffer;
use trimip_core::engine::backend::PoseGradients;
use trimip_core::engine::batch::{CameraSums, Displaced, Ray, Rays, StepResult, Tile};
use trimip_core::engine::policy::{PosePolicy, direction, moved};
use trimip_core::field::encoders;
use trimip_core::math::rng::Draws;
use trimip_core::{Config, ViewSet};

/// The stage that computes pose gradients.
pub struct CpuPoses {
    policy: PosePolicy,
    /// Number of floats in a row of features.
    stride: usize,
}

impl CpuPoses {
    /// Creates the stage for the training views. Returns `None` unless the configuration refines poses.
    pub fn new(config: &Config, views: Option<&ViewSet>) -> Option<Self> {
        let policy = PosePolicy::new(config, views)?;
        Some(Self { policy, stride: encoders::stride(config) })
    }
}

/// Returns the random direction perpendicular to ray `i` of a tile.
fn across(draws: &Draws, rays: &Rays<CpuBackend>, i: usize) -> [f32; 3] {
    direction(draws, rays.first + i as u32, &rays.rays[i])
}

impl PoseGradients<CpuBackend> for CpuPoses {
    fn displace(
        &self,
        tile: &mut Tile<'_, CpuBackend>,
        step: u64,
        side: f32,
        displaced: &mut Displaced<CpuBackend>,
    ) {
        let Tile { rays, samples, .. } = tile;
        let draws = self.policy.draws(step);
        displaced.rays.clear();
        for (i, ray) in rays.rays.iter().enumerate() {
            displaced.rays.push(moved(ray, across(&draws, rays, i).map(|part| side * part)));
        }
        displaced.spheres.clear();
        let intervals = samples.rays.iter().zip(samples.intervals.iter());
        for ((owner, interval), sphere) in intervals.zip(samples.spheres.iter()) {
            let ray = &displaced.rays[*owner as usize];
            displaced.spheres.push(self.policy.sphere(ray, interval.t, sphere.radius));
        }
    }

    fn compare(
        &self,
        tile: &mut Tile<'_, CpuBackend>,
        side: f32,
        feature_gradients: &Buffer<f32>,
        displaced: &mut Displaced<CpuBackend>,
    ) {
        let Displaced { features, slopes, .. } = displaced;
        slopes.resize(tile.samples.spheres.len());
        let gradients = feature_gradients.chunks_exact(self.stride);
        for ((slope, features), by) in
            slopes.iter_mut().zip(features.chunks_exact(self.stride)).zip(gradients)
        {
            let width = self.policy.width;
            let product: f32 = features[..width].iter().zip(&by[..width]).map(|(f, by)| f * by).sum();
            *slope = if side > 0.0 { product } else { *slope - product };
        }
    }

    fn add(&self, tile: &mut Tile<'_, CpuBackend>, step: u64, slopes: &Buffer<f32>, sums: &mut StepResult) {
        let Tile { rays, samples, .. } = tile;
        let draws = self.policy.draws(step);
        sums.cameras.resize(self.policy.photographs, CameraSums::default());
        for (group, photograph) in rays.groups.iter().zip(rays.photographs.iter()) {
            for i in group.range().filter(|&i| samples.segments[i].count > 0) {
                let range = samples.segments[i].range();
                let ray = &rays.rays[i];
                let (mut force, mut lever) = (0.0, 0.0);
                for (interval, slope) in samples.intervals[range.clone()].iter().zip(&slopes[range]) {
                    let slope = slope / ray.radius_at(interval.t);
                    force += slope;
                    lever += interval.t * slope;
                }
                add_to(&mut sums.cameras[*photograph as usize], ray, across(&draws, rays, i), force, lever);
            }
        }
    }
}

/// Adds the derivatives of a ray along the direction `by`. `force` is the sum of the samples' derivatives, `lever` the
/// sum of distance times derivative.
fn add_to(sums: &mut CameraSums, ray: &Ray, by: [f32; 3], force: f32, lever: f32) {
    let at: [f32; 3] = std::array::from_fn(|axis| force * ray.origin[axis] + lever * ray.direction[axis]);
    let turned = ray.cosine * lever;
    let tangent_squared = (ray.cosine * ray.cosine).recip() - 1.0;
    for axis in 0..3 {
        let (next, last) = ((axis + 1) % 3, (axis + 2) % 3);
        sums[axis] += f64::from(force * by[axis]);
        sums[3 + axis] += f64::from(at[next] * by[last] - at[last] * by[next]);
        sums[6 + axis] += f64::from(turned * by[axis]);
        sums[9 + axis] += f64::from(tangent_squared * turned * by[axis]);
    }
}
