//! Activations of the network outputs: density = exp(logit − 1) or another function of the logit, colour = sigmoid(logit) or,
//! without networks, max(0, logit + ½), and their derivatives.

use crate::{
    Config,
    config::{DensityFunction, FieldConfig},
    field::encoders,
    math::scalar::Real,
};

/// Largest argument of the exponential. With this bound the density stays finite, and a sample of this density is
/// opaque at any length.
pub const LARGEST_ARGUMENT: f64 = 60.0;

/// Map from a density logit to a density per world unit (`field.density`).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Density {
    /// The function.
    pub kind: DensityFunction,
    /// Number that is subtracted from the logit.
    pub shift: f64,
    /// Factor by which the density is multiplied.
    pub scale: f64,
}

impl Density {
    /// Creates the map of a configuration.
    pub fn new(config: &FieldConfig) -> Self {
        let [shift, scale] = [config.density_shift, config.density_scale].map(f64::from);
        Self { kind: config.density, shift, scale }
    }

    /// Returns the density per world unit given its logit.
    #[inline(always)]
    pub fn value<R: Real>(&self, logit: R) -> R {
        let x = logit - R::from_f64(self.shift);
        let density = match self.kind {
            DensityFunction::Exp => x.min(R::from_f64(LARGEST_ARGUMENT)).exp(),
            DensityFunction::Softplus => softplus(x),
            DensityFunction::Relu => x.max(R::zero()),
        };
        R::from_f64(self.scale) * density
    }

    /// Returns the derivative of the density that training uses. For the exponential it is exp(clamp(x, −15, 15))
    /// (authors' code): the clamp keeps the gradient of very opaque and very empty samples finite and above zero.
    #[inline(always)]
    pub fn derivative<R: Real>(&self, logit: R) -> R {
        let (x, limit) = (logit - R::from_f64(self.shift), R::from_f64(15.0));
        let slope = match self.kind {
            DensityFunction::Exp => x.max(-limit).min(limit).exp(),
            DensityFunction::Softplus => sigmoid(x),
            DensityFunction::Relu if x > R::zero() => R::one(),
            DensityFunction::Relu => R::zero(),
        };
        R::from_f64(self.scale) * slope
    }
}

/// Map from the logit of a colour channel to its value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Color {
    /// The logistic function, for the colour network's outputs.
    Sigmoid,
    /// max(0, logit + ½), for a field without networks (Plenoxels).
    Clamped,
}

impl Color {
    /// Creates the map of a configuration.
    pub fn new(config: &Config) -> Self {
        if encoders::of(config).direct() { Self::Clamped } else { Self::Sigmoid }
    }

    /// Returns the value of a channel, given its logit.
    #[inline(always)]
    pub fn value<R: Real>(self, logit: R) -> R {
        match self {
            Self::Sigmoid => sigmoid(logit),
            Self::Clamped => (logit + R::from_f64(0.5)).max(R::zero()),
        }
    }

    /// Returns the derivative with respect to the logit, given the value.
    #[inline(always)]
    pub fn derivative<R: Real>(self, value: R) -> R {
        match self {
            Self::Sigmoid => sigmoid_derivative(value),
            Self::Clamped if value > R::zero() => R::one(),
            Self::Clamped => R::zero(),
        }
    }
}

/// Computes ln(1 + exp(x)) without overflow.
#[inline]
pub fn softplus<R: Real>(x: R) -> R {
    x.max(R::zero()) + (-x.abs()).exp().ln_1p()
}

/// Computes the logistic function without overflow.
#[inline]
pub fn sigmoid<R: Real>(logit: R) -> R {
    let e = (-logit.abs()).exp();
    let positive = (R::one() + e).recip();
    if logit >= R::zero() { positive } else { e * positive }
}

/// Returns the derivative of the logistic function, given its value.
#[inline]
pub fn sigmoid_derivative<R: Real>(value: R) -> R {
    value * (R::one() - value)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns every function, with a shift and a scale.
    fn all() -> [Density; 3] {
        let of = |kind, shift, scale| Density { kind, shift, scale };
        [
            of(DensityFunction::Exp, 1.0, 1.0),
            of(DensityFunction::Softplus, 10.0, 25.0),
            of(DensityFunction::Relu, 0.5, 2.0),
        ]
    }

    #[test]
    fn densities_are_those_of_the_papers() {
        let [exp, softplus, relu] = all();
        for logit in [-3.0, -0.1, 0.0, 0.6, 7.0, 15.5_f64] {
            assert!((exp.value(logit) / (logit - 1.0).exp() - 1.0).abs() < 1e-15);
            let expected = 25.0 * (1.0 + (logit - 10.0).exp()).ln();
            assert!((softplus.value(logit) - expected).abs() < 1e-13, "{logit}");
            assert_eq!(relu.value(logit), if logit > 0.5 { 2.0 * (logit - 0.5) } else { 0.0 });
        }
    }

    #[test]
    fn derivatives_are_finite_differences() {
        let h = 1e-6;
        for logit in [-13.5, -3.0, -0.1, 0.0, 1.0, 7.0, 15.5] {
            for density in all() {
                let numeric = (density.value(logit + h) - density.value(logit - h)) / (2.0 * h);
                let found: f64 = density.derivative(logit);
                assert!((found - numeric).abs() <= 1e-7 * numeric.abs() + 1e-9, "{density:?} {logit}");
            }
            let numeric = (sigmoid(logit + h) - sigmoid(logit - h)) / (2.0 * h);
            assert!((sigmoid_derivative(sigmoid(logit)) - numeric).abs() < 1e-9);
            let clamped = |logit: f64| Color::Clamped.value(logit);
            let numeric = (clamped(logit + h) - clamped(logit - h)) / (2.0 * h);
            assert!((Color::Clamped.derivative(clamped(logit)) - numeric).abs() < 1e-8);
        }
    }

    #[test]
    fn extremes_stay_in_range() {
        let [exp, softplus, _] = all();
        for logit in [-1e4_f32, -200.0, 200.0, 1e4] {
            assert!((0.0..=1.0).contains(&sigmoid(logit)));
            assert!(exp.derivative(logit) > 0.0 && exp.derivative(logit) < 3.3e6);
            assert!(exp.value(logit).is_finite());
            assert!(softplus.value(logit).is_finite() && softplus.value(logit) >= 0.0);
        }
        assert!(
            (sigmoid(-80.0_f32) / (-80.0_f32).exp() - 1.0).abs() < 1e-6,
            "accurate relative, not absolute"
        );
    }
}
