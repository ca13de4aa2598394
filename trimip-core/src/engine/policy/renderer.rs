//! The policy of rendering: the schedules of the marching step's length and of the minimum weight at which a sample has
//! a colour, the pruning rule, the background, and the proxy of hybrid rendering.

use crate::{
    Config, Result, Space,
    config::{HybridConfig, RendererKind, schedule::Schedule},
    engine::proxy::Guide,
    field::model::Assets,
    math::{compositing::Pruning, rng::Random},
};

/// Space, steps, thresholds and background of a renderer.
#[derive(Clone, Debug)]
pub struct RendererPolicy {
    /// The space that rays march through.
    pub space: Space<f32>,
    /// Minimum length of a step, as a multiple of the radius of the ray's sphere in the middle of the box.
    pub step_per_radius: f32,
    /// The rule by which samples are dropped.
    pub pruning: Pruning<f32>,
    /// Background of pixels that have no target, RGB.
    pub background: [f32; 3],
    /// Generator of the random offset of each ray's first step.
    pub random: Random,
    /// Length of a step at a `step_scale` of 1.
    uniform_step: f32,
    step_scale: Schedule,
    step_length: f32,
    color_weights: Schedule,
    color_weight: f32,
    kind: RendererKind,
    hybrid: HybridConfig,
}

impl RendererPolicy {
    /// Creates the policy of a configuration at the start of a run.
    pub fn new(config: &Config) -> Self {
        let renderer = &config.renderer;
        let mut policy = Self {
            space: Space::new(&config.scene),
            step_per_radius: renderer.step_per_radius,
            pruning: Pruning::new(renderer.min_transmittance, renderer.min_weight),
            background: config.data.background,
            random: Random::new(config.seed),
            uniform_step: config.step_length(),
            step_scale: renderer.step_scale.clone(),
            step_length: 0.0,
            color_weights: renderer.color_weight.clone(),
            color_weight: 0.0,
            kind: renderer.kind,
            hybrid: config.hybrid.clone(),
        };
        policy.set_progress(0.0);
        policy
    }

    /// Applies the schedules at `progress` in [0, 1].
    pub fn set_progress(&mut self, progress: f64) {
        self.step_length = self.uniform_step * self.step_scale.at(progress) as f32;
        self.color_weight = self.color_weights.at(progress) as f32;
    }

    /// Returns the length of a marching step, in world units in a bounded space and otherwise in units of the ray's
    /// parameter.
    #[inline]
    pub fn step_length(&self) -> f32 {
        self.step_length
    }

    /// Returns the compositing weight below which a sample has no colour (`renderer.color_weight`).
    pub fn color_weight(&self) -> f32 {
        self.color_weight
    }

    /// Returns an upper bound on the number of samples of a ray.
    pub fn most_samples(&self) -> usize {
        self.space.most_steps(self.step_length)
    }

    /// Builds the guide that chooses the samples of pictures, from the assets of a model. Returns `None` for volume
    /// rendering, or if the assets have no proxy or an empty one.
    ///
    /// # Errors
    /// When the proxy is broken.
    pub fn guide(&self, assets: &Assets) -> Result<Option<Guide>> {
        Guide::of(self.kind, &self.hybrid, assets)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn step_and_colour_weight_are_those_of_the_schedules() {
        let mut config = Config::default();
        config.renderer.step_scale = Schedule::new(vec![[0.0, 4.0], [0.5, 1.0]]);
        config.renderer.color_weight = Schedule::new(vec![[0.0, 0.0], [0.25, 0.125]]);
        let mut policy = RendererPolicy::new(&config);
        let uniform = config.step_length();
        for (progress, scale, weight) in
            [(0.0, 4.0, 0.0), (0.3, 4.0, 0.125), (0.5, 1.0, 0.125), (1.0, 1.0, 0.125)]
        {
            policy.set_progress(progress);
            assert_eq!(
                (policy.step_length(), policy.color_weight()),
                (scale * uniform, weight),
                "{progress}"
            );
            assert_eq!(policy.most_samples(), policy.space.most_steps(scale * uniform));
        }
    }
}
