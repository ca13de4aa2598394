//! The number of rays of the first step, and the largest number of rays of a step.

use crate::{Config, Space, config::schedule::Schedule, engine::batch::MOST_PENDING};

/// Expected number of kept samples per ray, from which the first batch is sized.
pub(super) const FIRST_KEPT_PER_RAY: u32 = 256;

/// If the longest ray has at most this number of steps, [`FIRST_KEPT_PER_RAY`] samples are expected; each further step
/// adds a quarter of a sample.
const LONG_RAY: u32 = 4096;

/// Minimum number of rays of a step.
pub(super) const LEAST_RAYS: u32 = 16;

/// Largest number of rays of a step, as a multiple of its target number of samples.
pub(super) const MOST_RAYS_PER_SAMPLE: u64 = 8;

/// Returns the largest number of steps of a ray at the start of a run.
fn longest_ray(config: &Config) -> usize {
    let step = config.step_length() * config.renderer.step_scale.at(0.0) as f32;
    Space::<f32>::new(&config.scene).most_steps(step)
}

/// Returns the largest number of kept samples of a ray at the start of a run: its number of steps or, if that is
/// smaller, the inverse of the minimum weight, because the weights sum to at most 1.
pub fn most_kept(config: &Config) -> usize {
    let least = config.renderer.min_weight;
    let by_weight = if least > 0.0 { least.recip().ceil() as usize } else { usize::MAX };
    longest_ray(config).min(by_weight)
}

/// Returns the expected number of kept samples per ray in the first step.
pub(super) fn first_kept_per_ray(config: &Config) -> u32 {
    FIRST_KEPT_PER_RAY + (longest_ray(config) as u32).saturating_sub(LONG_RAY) / 4
}

/// Returns the number of rays of the first step.
pub fn first_rays(config: &Config) -> u32 {
    (config.train.samples_per_step / first_kept_per_ray(config)).max(LEAST_RAYS)
}

/// Returns the largest number of pixels of a step, after steps that had `rays` pixels in total.
pub(crate) fn most_rays(config: &Config, rays: u64) -> u64 {
    let tile = |values: &Schedule| {
        let (least, most) = values.values().fold((f64::MAX, 0.0_f64), |(a, b), x| (a.min(x), b.max(x)));
        most / least
    };
    // If marching steps become longer and cones fewer, the number of pixels rises at once, by at most `ratio`.
    // Otherwise a step has at most twice as many pixels as the one before it; the further doublings allow for pending
    // steps.
    let ratio = tile(&config.renderer.step_scale) * tile(&config.train.cones).powi(2);
    let doubled = rays.saturating_mul(1 << (MOST_PENDING + 1)).max(first_rays(config).into());
    let limit = (MOST_RAYS_PER_SAMPLE * u64::from(config.train.samples_per_step)).max(LEAST_RAYS.into());
    (doubled.min(limit) as f64 * ratio) as u64
}
