//! AdamW for one parameter (Loshchilov and Hutter 2019), and the learning-rate schedule.

use crate::{
    Config,
    config::{OptimizerConfig, RateSchedule},
    field::{encoders, params::Slot},
    math::scalar::Real,
};

/// Constants of one step, the same for all parameters of a group.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule<R> {
    /// β1, decay of the first moment.
    pub beta1: R,
    /// β2, decay of the second moment.
    pub beta2: R,
    /// 1 − β1, rounded once.
    pub share1: R,
    /// 1 − β2, rounded once: computed from β2 in f32 it would have an error of 1.3e-5.
    pub share2: R,
    /// Number that is added to the root of the second moment.
    pub epsilon: R,
    /// Learning rate / (1 − β1^t).
    pub rate: R,
    /// 1/sqrt(1 − β2^t).
    pub root_correction: R,
    /// 1 − learning rate · weight decay.
    pub shrink: R,
    /// Number that is added to the gradient with the sign of the parameter: the derivative of Σ sparsity·|parameter|.
    pub sparsity: R,
}

impl<R: Real> Rule<R> {
    /// Creates the rule of step `step` (counted from 1) at `learning_rate`.
    pub fn new(config: &OptimizerConfig, learning_rate: f64, step: u64) -> Self {
        let power = |beta: f64| 1.0 - beta.powf(step as f64);
        Self {
            beta1: R::from_f64(config.beta1),
            beta2: R::from_f64(config.beta2),
            share1: R::from_f64(1.0 - config.beta1),
            share2: R::from_f64(1.0 - config.beta2),
            epsilon: R::from_f64(config.epsilon),
            rate: R::from_f64(learning_rate / power(config.beta1)),
            root_correction: R::from_f64(power(config.beta2).sqrt().recip()),
            shrink: R::from_f64(1.0 - learning_rate * config.weight_decay),
            sparsity: R::zero(),
        }
    }

    /// Creates the rule of a slot at step `step`; `learning_rate` is the learning rate of the networks.
    pub fn of(config: &OptimizerConfig, slot: &Slot, learning_rate: f64, step: u64) -> Self {
        let rate = learning_rate * slot.rate;
        let shrink = R::from_f64(1.0 - rate * slot.decay * config.weight_decay);
        Self { shrink, ..Self::new(config, rate, step) }
    }

    /// Updates a parameter and its moments with `gradient`.
    #[inline(always)]
    pub fn apply(&self, parameter: &mut R, m: &mut R, v: &mut R, gradient: R) {
        let gradient = gradient + self.sparsity.copysign(*parameter);
        *m = self.beta1 * *m + self.share1 * gradient;
        *v = self.beta2 * *v + self.share2 * gradient * gradient;
        *parameter =
            *parameter * self.shrink - self.rate * *m / (v.sqrt() * self.root_correction + self.epsilon);
    }
}

/// Returns the learning rate of the networks at `progress` in [0, 1].
pub fn learning_rate(config: &Config, progress: f64) -> f64 {
    let since = encoders::of(config).restarted(config, progress).unwrap_or(0.0);
    rate_since(&config.optimizer, progress, since)
}

/// Returns the same as [`learning_rate`], for an exponential schedule that restarted at `since`.
fn rate_since(config: &OptimizerConfig, progress: f64, since: f64) -> f64 {
    config.learning_rate
        * match config.schedule {
            RateSchedule::Milestones => {
                let passed = config.milestones.iter().filter(|&&milestone| progress >= milestone).count();
                config.decay_factor.powi(passed as i32)
            }
            RateSchedule::Exponential => config.final_factor.powf(progress - since),
            RateSchedule::Cosine => {
                let half_wave = 0.5 + 0.5 * (std::f64::consts::PI * progress.clamp(0.0, 1.0)).cos();
                config.final_factor + (1.0 - config.final_factor) * half_wave
            }
        }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Computes Algorithm 2 of the paper as written, with m̂ and v̂.
    fn written(theta: f64, gradients: &[f64], c: &OptimizerConfig, rate: f64) -> f64 {
        let (mut theta, mut m, mut v) = (theta, 0.0, 0.0);
        for (i, g) in gradients.iter().enumerate() {
            m = c.beta1 * m + (1.0 - c.beta1) * g;
            v = c.beta2 * v + (1.0 - c.beta2) * g * g;
            let m_hat = m / (1.0 - c.beta1.powi(i as i32 + 1));
            let v_hat = v / (1.0 - c.beta2.powi(i as i32 + 1));
            theta = theta - rate * m_hat / (v_hat.sqrt() + c.epsilon) - rate * c.weight_decay * theta;
        }
        theta
    }

    #[test]
    fn the_rule_is_the_written_one() {
        let mut config = Config::default().optimizer;
        config.weight_decay = 0.1;
        let gradients = [0.3, -1.0, 1e-30, 0.0, 2e3, -0.5];
        let (mut theta, mut m, mut v) = (0.7, 0.0, 0.0);
        for (i, &g) in gradients.iter().enumerate() {
            Rule::new(&config, 0.02, i as u64 + 1).apply(&mut theta, &mut m, &mut v, g);
        }
        assert!((theta - written(0.7, &gradients, &config, 0.02)).abs() < 1e-12);
    }

    #[test]
    fn a_parameter_that_never_had_a_gradient_only_shrinks() {
        let config = Config::default().optimizer;
        let (mut theta, mut m, mut v) = (0.01_f32, 0.0, 0.0);
        for step in 1..=100 {
            Rule::new(&config, 0.02, step).apply(&mut theta, &mut m, &mut v, 0.0);
        }
        // Each step has a rounding error of at most half an ulp of 0.01 in f32, 4.7e-10; the decay over all steps is
        // 2e-7.
        assert!((f64::from(theta) - 0.01 * (1.0 - 0.02 * 1e-5_f64).powi(100)).abs() < 100.0 * 4.7e-10);
    }

    #[test]
    fn the_schedule_falls_at_its_milestones() {
        let config = Config::default().optimizer;
        assert_eq!(rate_since(&config, 0.49, 0.0), 2e-3);
        assert_eq!(rate_since(&config, 0.5, 0.0), 2e-3 * 0.6);
        assert!((rate_since(&config, 1.0, 0.0) - 2e-3 * 0.6_f64.powi(4)).abs() < 1e-15);
        let cosine = OptimizerConfig { schedule: RateSchedule::Cosine, final_factor: 0.02, ..config };
        let exponential =
            OptimizerConfig { schedule: RateSchedule::Exponential, final_factor: 0.1, ..cosine.clone() };
        for (progress, since, factor) in
            [(0.0, 0.0, 1.0), (0.5, 0.0, 0.1_f64.sqrt()), (0.7, 0.2, 0.1_f64.sqrt())]
        {
            assert!((rate_since(&exponential, progress, since) - 2e-3 * factor).abs() < 1e-15, "{progress}");
        }
        for (progress, factor) in [(0.0, 1.0), (0.5, 0.51), (1.0, 0.02), (1.1, 0.02)] {
            assert!((rate_since(&cosine, progress, 0.0) - 2e-3 * factor).abs() < 1e-15, "{progress}");
        }
    }
}
