//! The terms of the loss by name, and what core knows of each without a backend. A term is a file here (its declaration,
//! its formula, its equation in f64), WGSL in a GPU backend, a line in the list of its kind, and its settings in
//! [`LossConfig`].
//!
//! The loss of a pixel is the mean over its channels of the photometric term, plus weight · value of every other term
//! that is at work; the loss of a step is the mean over its pixels, weighted by their areas.

pub mod charbonnier;
pub mod distortion;
pub mod exposure;
pub mod opacity;
pub mod smooth_l1;

use crate::config::{LossConfig, Photometric};
use crate::geometry::elements::Target;
use crate::{Config, Pixel};

/// Names the term of each photometric choice.
macro_rules! photometric {
    ($($kind:ident => $term:expr),* $(,)?) => {
        impl Photometric {
            /// All of them.
            pub const ALL: &[Self] = &[$(Self::$kind),*];

            /// The term's declaration.
            pub fn term(self) -> &'static dyn PhotometricTerm {
                match self { $(Self::$kind => &$term),* }
            }

            /// Computes with the term.
            #[inline]
            pub fn visit<V: PhotometricVisitor>(self, visitor: V) -> V::Output {
                match self { $(Self::$kind => visitor.visit(&$term)),* }
            }
        }
    };
}

photometric! {
    SmoothL1 => smooth_l1::SmoothL1,
    Charbonnier => charbonnier::Charbonnier,
}

/// The terms of single pixels.
pub const PIXEL_TERMS: &[&dyn PixelTerm] = &[&opacity::Opacity];

/// The terms of a ray's samples.
pub const RAY_TERMS: &[&dyn RayTerm] = &[&distortion::Distortion];

/// The adjustments of the colour that is compared.
pub const ADJUSTMENTS: &[&dyn Adjustment] = &[&exposure::Gains];

/// The declaration of a term, whatever its kind.
pub trait Definition: Sync {
    /// Name of the term and of its WGSL function: "smooth_l1".
    fn name(&self) -> &'static str;

    /// Weight relative to the colour; 0 if the term is not at work.
    fn weight(&self, config: &LossConfig) -> f32;

    /// The numbers that the term's formula takes from the settings, as a device receives them.
    fn numbers(&self, _config: &LossConfig) -> [f32; 3] {
        [0.0; 3]
    }

    /// Puts the term to work in a small configuration. The suites of every backend run over these examples.
    fn example(&self, config: &mut Config);
}

/// A photometric term: a penalty of the difference between a channel of a pixel and of its photograph. A loss has one.
pub trait PhotometricTerm: Definition {
    /// Value and derivative at `difference`.
    fn evaluate(&self, config: &LossConfig, difference: f32) -> (f32, f32);

    /// The value by the term's equation as written.
    fn reference(&self, config: &LossConfig, difference: f64) -> f64;
}

/// A term of a pixel.
pub trait PixelTerm: Definition {
    /// The value. Adds `factor` times the derivatives by the pixel's [r, g, b, opacity] to `gradient`.
    fn evaluate(
        &self,
        config: &LossConfig,
        pixel: &Pixel,
        target: &Target,
        factor: f32,
        gradient: &mut [f32; 4],
    ) -> f32;

    /// The value of a pixel's [r, g, b, opacity] by the term's equation as written.
    fn reference(&self, config: &LossConfig, pixel: [f64; 4], target: &Target) -> f64;
}

/// A term of the samples of a ray. That of a pixel is the mean over its cones.
pub trait RayTerm: Definition {
    /// The value. `by_depth` receives the derivative by the optical depth of each sample.
    fn evaluate(&self, config: &LossConfig, cone: &ConeSamples<'_, f32>, by_depth: &mut [f32]) -> f32;

    /// The value by the term's equation as written.
    fn reference(&self, config: &LossConfig, cone: &ConeSamples<'_, f64>) -> f64;
}

/// An adjustment of the colour that is compared, by gains of the photograph that are trained beside the parameters.
pub trait Adjustment: Definition {
    /// The colour that is compared, for the colour `shown`, of which `behind` is the photograph's own background.
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
    /// Distance of its midpoint, world units.
    pub t: R,
    /// Parameter of its midpoint along the ray, in units of the box's longest side ([`along`](crate::Space::along)); not below
    /// that of the sample in front of it.
    pub place: R,
    /// Growth of the parameter over the sample.
    pub width: R,
}

/// The terms that are at work, with their weights.
pub fn at_work<T: Definition + ?Sized>(terms: &[&'static T], config: &LossConfig) -> Vec<(&'static T, f32)> {
    let weighted = terms.iter().map(|&term| (term, term.weight(config)));
    weighted.filter(|(_, weight)| *weight > 0.0).collect()
}

/// All terms, of every kind.
pub fn all() -> Vec<&'static dyn Definition> {
    let mut all: Vec<&'static dyn Definition> = Vec::new();
    all.extend(Photometric::ALL.iter().map(|kind| kind.term() as &dyn Definition));
    all.extend(PIXEL_TERMS.iter().map(|&term| term as &dyn Definition));
    all.extend(RAY_TERMS.iter().map(|&term| term as &dyn Definition));
    all.extend(ADJUSTMENTS.iter().map(|&term| term as &dyn Definition));
    all
}

/// What is computed with the photometric term of a configuration. It is compiled once for each term.
pub trait PhotometricVisitor {
    /// What it results in.
    type Output;

    /// Computes with `term`.
    fn visit<T: PhotometricTerm>(self, term: &T) -> Self::Output;
}

#[cfg(test)]
mod tests;
