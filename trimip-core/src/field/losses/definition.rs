//! The interface of a term of the loss, independent of any backend: its declaration, its value and derivatives, and its equation in f64.

use crate::config::LossConfig;
use crate::geometry::elements::Target;
use crate::{Config, Pixel};

/// The declaration of a term, whatever its kind.
pub trait Definition: Send + Sync {
    /// Returns the name of the term and of its WGSL function, such as "smooth_l1".
    fn name(&self) -> &'static str;

    /// Returns the weight of the term relative to that of colour at the start of a run; 0 if the term is disabled.
    fn weight(&self, config: &LossConfig) -> f32;

    /// Returns the weight at `progress` in [0, 1] of a run.
    fn weight_at(&self, config: &LossConfig, _progress: f64) -> f32 {
        self.weight(config)
    }

    /// Returns the numbers that the term's formula takes from the settings, as a device receives them.
    fn numbers(&self, _config: &LossConfig) -> [f32; 3] {
        [0.0; 3]
    }

    /// Enables the term in a small configuration. The suites of every backend run over the examples of the terms in core's
    /// lists; a term of another crate needs none.
    fn example(&self, _config: &mut Config) {}
}

/// A photometric term: a penalty of the difference between a channel of a pixel and of its photograph. A loss has one.
pub trait PhotometricTerm: Definition {
    /// Returns value and derivative at `difference`.
    fn evaluate(&self, config: &LossConfig, difference: f32) -> (f32, f32);

    /// Returns the value according to the term's equation as written.
    fn reference(&self, config: &LossConfig, difference: f64) -> f64;
}

/// A term of a pixel.
pub trait PixelTerm: Definition {
    /// Returns the value. Adds `factor` times the derivatives with respect to the pixel's [r, g, b, opacity] to
    /// `gradient`.
    fn evaluate(
        &self,
        config: &LossConfig,
        pixel: &Pixel,
        target: &Target,
        factor: f32,
        gradient: &mut [f32; 4],
    ) -> f32;

    /// Returns the value of a pixel's [r, g, b, opacity] according to the term's equation as written.
    fn reference(&self, config: &LossConfig, pixel: [f64; 4], target: &Target) -> f64;
}

/// A term of the samples of a ray. A pixel's term is the mean over its cones; a cone without samples adds 0.
pub trait RayTerm: Definition {
    /// Returns the value. `by_depth` receives the derivative with respect to the optical depth of each sample.
    fn evaluate(&self, config: &LossConfig, cone: &ConeSamples<'_, f32>, by_depth: &mut [f32]) -> f32;

    /// Returns the value according to the term's equation as written.
    fn reference(&self, config: &LossConfig, cone: &ConeSamples<'_, f64>) -> f64;
}

/// An adjustment of the compared colour by gains of the photograph, which are trained alongside the parameters.
pub trait Adjustment: Definition {
    /// Returns the compared colour for the rendered colour `shown`; `behind` is the part of `shown` that comes from the
    /// background behind the photograph.
    fn reference(&self, shown: [f64; 3], behind: [f64; 3], gains: [f64; 3]) -> [f64; 3];
}

/// The kept samples of a cone, front to back, and the target of its pixel.
#[derive(Clone, Copy, Debug)]
pub struct ConeSamples<'a, R> {
    /// The target of the pixel.
    pub target: &'a Target,
    /// The samples.
    pub samples: &'a [RaySample<R>],
}

/// A sample of a ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RaySample<R> {
    /// Optical depth x = σ·δ.
    pub depth: R,
    /// Distance of the sample's midpoint, in world units.
    pub t: R,
    /// Length δ of the sample, in world units.
    pub length: R,
    /// Ray parameter of the sample's midpoint ([`along`](crate::Space::along)), in units of the box's longest side; at
    /// least the parameter of the sample in front.
    pub place: R,
    /// Increase of the ray parameter over the sample.
    pub width: R,
}

/// A computation with the photometric term of a configuration. It is compiled once for each term.
pub trait PhotometricVisitor {
    /// Result of the computation.
    type Output;

    /// Computes with `term`.
    fn visit<T: PhotometricTerm>(self, term: &T) -> Self::Output;
}
