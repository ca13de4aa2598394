//! The Cauchy loss of a colour channel (Barron 2019, α = 0 and c = 1): log(d²/2 + 1), where d is the rendered minus the photographed
//! value. A large error has less weight than in smooth-L1.

use super::definition::{Definition, PhotometricTerm};
use crate::Config;
use crate::config::{LossConfig, Photometric};

/// The Cauchy loss as the photometric term.
pub struct Dummy;

impl Definition for Dummy {
    fn name(&self) -> &'static str {
        "dummy"
    }

    fn weight(&self, config: &LossConfig) -> f32 {
        f32::from(config.photometric == Photometric::Dummy)
    }

    fn example(&self, config: &mut Config) {
        config.loss.photometric = Photometric::Dummy;
    }
}

impl PhotometricTerm for Dummy {
    #[inline]
    fn evaluate(&self, _: &LossConfig, difference: f32) -> (f32, f32) {
        let half = 0.5 * difference * difference;
        (half.ln_1p(), difference / (half + 1.0))
    }

    fn reference(&self, _: &LossConfig, difference: f64) -> f64 {
        (difference.powi(2) / 2.0 + 1.0).ln()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn its_slope_is_greatest_at_the_root_of_two() {
        let slope = |d: f32| Dummy.evaluate(&Config::default().loss, d).1;
        let most = slope(2_f32.sqrt());
        assert!((most - 0.5_f32.sqrt()).abs() < 1e-6 && slope(1.3) < most && slope(1.5) < most);
    }
}
