//! Activations of the network outputs: density = exp(logit − 1), colour = sigmoid(logit), and their derivatives.

use crate::scalar::Real;

/// Density per world unit from its logit.
#[inline]
pub fn density<R: Real>(logit: R) -> R {
    (logit - R::one()).exp()
}

/// Derivative of the density used in training: exp(clamp(logit − 1, −15, 15)) (code). The clamp keeps the
/// gradient of very opaque and very empty samples finite and above zero.
#[inline]
pub fn density_derivative<R: Real>(logit: R) -> R {
    let limit = R::from_f64(15.0);
    (logit - R::one()).max(-limit).min(limit).exp()
}

/// Logistic function without overflow.
#[inline]
pub fn sigmoid<R: Real>(logit: R) -> R {
    let e = (-logit.abs()).exp();
    let positive = (R::one() + e).recip();
    if logit >= R::zero() { positive } else { e * positive }
}

/// Derivative of the logistic function, from its value.
#[inline]
pub fn sigmoid_derivative<R: Real>(value: R) -> R {
    value * (R::one() - value)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn derivatives_are_finite_differences() {
        let h = 1e-6;
        for logit in [-13.5, -3.0, -0.1, 0.0, 1.0, 7.0, 15.5] {
            let numeric = (density(logit + h) - density(logit - h)) / (2.0 * h);
            assert!((density_derivative(logit) / numeric - 1.0_f64).abs() < 1e-7);
            let numeric = (sigmoid(logit + h) - sigmoid(logit - h)) / (2.0 * h);
            assert!((sigmoid_derivative(sigmoid(logit)) - numeric).abs() < 1e-9);
        }
    }

    #[test]
    fn extremes_stay_in_range() {
        for logit in [-1e4_f32, -200.0, 200.0, 1e4] {
            assert!((0.0..=1.0).contains(&sigmoid(logit)));
            assert!(density_derivative(logit) > 0.0 && density_derivative(logit) < 3.3e6);
        }
        assert!(
            (sigmoid(-80.0_f32) / (-80.0_f32).exp() - 1.0).abs() < 1e-6,
            "accurate relative, not absolute"
        );
    }
}
