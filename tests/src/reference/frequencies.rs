//! Positional encodings from their equations: NeRF Eq. 4 without the factor π; mip-NeRF Eq. 7, 8, 13 and 14 with a full
//! covariance.

use super::sample::{Literal, Sample};
use glam::{DMat3, DVec3};
use trimip_core::Config;

/// The positional encoding.
pub struct Frequencies(Config);

impl Frequencies {
    /// Creates the encoding of a configuration.
    pub fn new(config: &Config) -> Self {
        Self(config.clone())
    }
}

impl Literal for Frequencies {
    fn features(&self, sample: &Sample) -> Vec<f64> {
        let (settings, scene) = (&self.0.frequencies, &self.0.scene);
        let [min, max] = [scene.aabb_min, scene.aabb_max].map(|p| DVec3::from(p.map(f64::from)));
        let middle = (DVec3::from(sample.position) - 0.5) * (max - min);
        let (mut mean, mut covariance) = (middle, DMat3::ZERO);
        if settings.integrated {
            // s is the middle of the interval, h half of its length, and r the radius at distance 1.
            let (s, h) = (sample.apex, (0.5 * sample.length).min(sample.apex));
            let disc = 1.0 / std::f64::consts::PI.sqrt();
            let r = sample.radius / s * (2.0 / 12_f64.sqrt()) / disc;
            let below = 3.0 * s.powi(2) + h.powi(2);
            let along =
                h.powi(2) / 3.0 - 4.0 * h.powi(4) * (12.0 * s.powi(2) - h.powi(2)) / (15.0 * below.powi(2));
            let across =
                r.powi(2) * (s.powi(2) / 4.0 + 5.0 * h.powi(2) / 12.0 - 4.0 * h.powi(4) / (15.0 * below));
            let d = DVec3::from(sample.direction);
            let square = DMat3::from_cols(d * d.x, d * d.y, d * d.z);
            mean = middle + d * (2.0 * s * h.powi(2) / below);
            covariance = square * along + (DMat3::IDENTITY - square * (1.0 / d.length_squared())) * across;
        }
        let mut features = if settings.identity { mean.to_array().to_vec() } else { Vec::new() };
        for k in 0..settings.count {
            let scale = 2_f64.powi(k as i32);
            let damping = [0, 1, 2].map(|i| (-0.5 * scale.powi(2) * covariance.col(i)[i]).exp());
            features.extend((0..3).map(|i| damping[i] * (scale * mean[i]).sin()));
            features.extend((0..3).map(|i| damping[i] * (scale * mean[i]).cos()));
        }
        features
    }
}
