//! Start and progress of marching along a ray.

use trimip_core::engine::batch::Ray;
use trimip_core::engine::policy::RendererPolicy;
use trimip_core::math::rng::Sequence;

/// The progress of marching along a ray.
#[derive(Clone, Copy, Debug)]
pub struct Cursor {
    /// Ray parameter at the start of the first step. In a bounded space, the parameter is the distance along the ray.
    pub first: f32,
    /// Ray parameter at which the ray leaves the space; −∞ if the ray misses the space.
    pub leave: f32,
    /// Step length, as a difference of ray parameters.
    pub step: f32,
    /// Number of steps done.
    pub index: f32,
}

impl Cursor {
    /// Creates the cursor of a ray at its entry into the box, before its first step. If `jitter` holds a training step,
    /// the first step starts a random fraction of a step later; `index` is the ray's index within the training step.
    pub fn new(policy: &RendererPolicy, ray: &Ray, jitter: Option<u64>, index: u32) -> Self {
        let (enter, leave) = policy.space.parameterisation(ray.origin, ray.direction).range();
        let offset = jitter.map_or(0.0, |step| policy.random.uniform(Sequence::Jitter, step, index)[0]);
        let radius = ray.radius * policy.step_per_radius;
        let by_radius = radius + policy.step_per_radius * ray.slope * 0.5 * (enter + leave);
        // A comparison with NaN is false and selects the uniform step.
        let step = if by_radius > policy.step_length() { by_radius } else { policy.step_length() };
        let first = enter + offset * step;
        let hits = leave > first && leave.is_finite();
        Self { first, leave: if hits { leave } else { f32::NEG_INFINITY }, step, index: 0.0 }
    }

    /// Returns this cursor with another step length.
    pub fn with_step(self, step: f32) -> Self {
        Self { step, ..self }
    }
}
