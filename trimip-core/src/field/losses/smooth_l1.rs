//! Smooth-L1 of a channel (Girshick 2015; the paper's loss): d²/(2β) for |d| < β, otherwise |d| − β/2. d is the
//! difference of a channel, β (`loss.beta`) the size up to which the loss is quadratic.

use super::definition::{Definition, PhotometricTerm};
use crate::config::{LossConfig, Photometric};
use crate::{Config, math::scalar::Real};

/// Smooth-L1 as the photometric term.
pub struct SmoothL1;

/// Returns value and derivative at `difference`.
#[inline]
pub fn smooth_l1<R: Real>(difference: R, beta: R) -> (R, R) {
    let half = R::from_f64(0.5);
    let size = difference.abs();
    if size < beta {
        (half * difference * difference / beta, difference / beta)
    } else {
        (size - half * beta, difference.signum())
    }
}

/// Returns the value according to the equation as written.
pub fn reference(difference: f64, beta: f64) -> f64 {
    let size = difference.abs();
    if size < beta { size * size / (2.0 * beta) } else { size - beta / 2.0 }
}

impl Definition for SmoothL1 {
    fn name(&self) -> &'static str {
        "smooth_l1"
    }

    fn weight(&self, config: &LossConfig) -> f32 {
        f32::from(config.photometric == Photometric::SmoothL1)
    }

    fn numbers(&self, config: &LossConfig) -> [f32; 3] {
        [config.beta, 0.0, 0.0]
    }

    fn example(&self, config: &mut Config) {
        (config.loss.photometric, config.loss.beta) = (Photometric::SmoothL1, 0.1);
    }
}

impl PhotometricTerm for SmoothL1 {
    #[inline]
    fn evaluate(&self, config: &LossConfig, difference: f32) -> (f32, f32) {
        smooth_l1(difference, config.beta)
    }

    fn reference(&self, config: &LossConfig, difference: f64) -> f64 {
        reference(difference, config.beta.into())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn value_and_slope_are_continuous_and_consistent() {
        for beta in [0.05_f64, 1.0] {
            for d in [-2.0, -0.3, -0.01, 0.02, 0.7, 1.5] {
                let h = 1e-7;
                let numeric = (smooth_l1(d + h, beta).0 - smooth_l1(d - h, beta).0) / (2.0 * h);
                assert!((smooth_l1(d, beta).1 - numeric).abs() < 1e-6);
                assert!((smooth_l1(d, beta).0 - reference(d, beta)).abs() < 1e-15);
            }
            let (inside, outside) = (smooth_l1(beta * (1.0 - 1e-12), beta), smooth_l1(beta, beta));
            assert!((inside.0 - outside.0).abs() < 1e-11 && (inside.1 - outside.1).abs() < 1e-11);
        }
    }
}
