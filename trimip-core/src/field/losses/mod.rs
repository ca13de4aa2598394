//! The terms of the loss by name. A term consists of a file here (its declaration, its formula, its equation in f64),
//! WGSL in a GPU backend, a line in the list of its kind, and its settings in [`LossConfig`]. Another crate adds a term, which
//! the CPU computes, with a [`LossSection`].
//!
//! The loss of a pixel is the mean over its channels of the photometric term, plus weight · value of every other enabled
//! term. The loss of a step is the mean over its pixels, weighted by their areas.

pub mod charbonnier;
mod definition;
pub mod depth;
pub mod distortion;
pub mod exposure;
pub mod opacity;
mod others;
pub mod smooth_l1;
pub mod verify;

pub use crate::geometry::elements::Target;
pub use definition::{
    Adjustment, ConeSamples, Definition, PhotometricTerm, PhotometricVisitor, PixelTerm, RaySample, RayTerm,
};
pub use others::{Held, LossSection, Term, Terms, addition, others};

use crate::config::{LossConfig, Photometric};

/// Names the term of each photometric choice.
macro_rules! photometric {
    ($($kind:ident => $term:expr),* $(,)?) => {
        impl Photometric {
            /// All photometric terms.
            pub const ALL: &[Self] = &[$(Self::$kind),*];

            /// Returns the term's declaration.
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
pub const RAY_TERMS: &[&dyn RayTerm] = &[&distortion::Distortion, &depth::Depth];

/// The adjustments of the colour that is compared.
pub const ADJUSTMENTS: &[&dyn Adjustment] = &[&exposure::Gains];

/// Returns the terms that are enabled at `progress` in [0, 1] of a run, with their weights.
pub fn at_work<T: Definition + ?Sized>(
    terms: &[Held<T>],
    config: &LossConfig,
    progress: f64,
) -> Vec<(Held<T>, f32)> {
    let weighted = terms.iter().map(|term| (term.clone(), term.weight_at(config, progress)));
    weighted.filter(|(_, weight)| *weight > 0.0).collect()
}

/// Returns all terms, of every kind.
pub fn all() -> Vec<&'static dyn Definition> {
    let mut all: Vec<&'static dyn Definition> = Vec::new();
    all.extend(Photometric::ALL.iter().map(|kind| kind.term() as &dyn Definition));
    all.extend(PIXEL_TERMS.iter().map(|&term| term as &dyn Definition));
    all.extend(RAY_TERMS.iter().map(|&term| term as &dyn Definition));
    all.extend(ADJUSTMENTS.iter().map(|&term| term as &dyn Definition));
    all
}

#[cfg(test)]
mod tests;
