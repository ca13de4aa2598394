//! The Charbonnier loss of a channel (Charbonnier et al. 1994; MERF, Reiser et al. 2023; Zip-NeRF, Barron et al. 2023):
//! √(d² + ε²). d is the difference of a channel, ε (`loss.padding`) the size below which the loss is nearly quadratic.

use super::definition::{Definition, PhotometricTerm};
use crate::Config;
use crate::config::{LossConfig, Photometric};

/// The Charbonnier loss as the photometric term.
pub struct Charbonnier;

impl Definition for Charbonnier {
    fn name(&self) -> &'static str {
        "charbonnier"
    }

    fn weight(&self, config: &LossConfig) -> f32 {
        f32::from(config.photometric == Photometric::Charbonnier)
    }

    fn numbers(&self, config: &LossConfig) -> [f32; 3] {
        [config.padding, 0.0, 0.0]
    }

    fn example(&self, config: &mut Config) {
        (config.loss.photometric, config.loss.padding) = (Photometric::Charbonnier, 0.1);
    }
}

impl PhotometricTerm for Charbonnier {
    #[inline]
    fn evaluate(&self, config: &LossConfig, difference: f32) -> (f32, f32) {
        let value = (difference * difference + config.padding * config.padding).sqrt();
        (value, difference / value)
    }

    fn reference(&self, config: &LossConfig, difference: f64) -> f64 {
        (difference.powi(2) + f64::from(config.padding).powi(2)).sqrt()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_a_parabola_near_zero_and_the_size_far_away() {
        let config = LossConfig { padding: 1e-3, ..Config::default().loss };
        let value = |d: f32| Charbonnier.evaluate(&config, d).0;
        assert_eq!(value(0.0), 1e-3);
        // The value is about ε + d²/(2ε) for a small d, and about |d| for a large d.
        assert!((value(1e-4) - (1e-3 + 0.5e-5)).abs() < 2e-8);
        assert!((value(-0.5) - 0.5).abs() < 2e-6);
        assert_eq!(Charbonnier.evaluate(&config, -0.5).1, -Charbonnier.evaluate(&config, 0.5).1);
    }
}
