//! One step of AdamW as published (Loshchilov and Hutter 2019, Algorithm 2).

use trimip_core::config::OptimizerConfig;

/// Returns both moments after a gradient (lines 6 and 7).
pub fn moments(config: &OptimizerConfig, [m, v]: [f64; 2], gradient: f64) -> [f64; 2] {
    let OptimizerConfig { beta1, beta2, .. } = *config;
    [beta1 * m + (1.0 - beta1) * gradient, beta2 * v + (1.0 - beta2) * gradient * gradient]
}

/// Returns the change of a parameter due to the moments of step `step` (from 1), and that due to weight decay (lines 8
/// to 12).
pub fn changes(
    config: &OptimizerConfig,
    [rate, decay]: [f64; 2],
    step: u64,
    theta: f64,
    [m, v]: [f64; 2],
) -> [f64; 2] {
    let corrected = |moment: f64, beta: f64| moment / (1.0 - beta.powf(step as f64));
    let (m, v) = (corrected(m, config.beta1), corrected(v, config.beta2));
    [-rate * m / (v.sqrt() + config.epsilon), -rate * decay * theta]
}
