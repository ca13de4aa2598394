//! The opacity term compares the opacity of a pixel with the alpha of its photograph, by smooth-L1 with the same β as
//! colours. `loss.opacity` is the weight of the term.

use super::definition::{Definition, PixelTerm};
use super::smooth_l1::{self, smooth_l1};
use crate::config::LossConfig;
use crate::geometry::elements::Target;
use crate::{Config, Pixel};

/// Smooth-L1 of the opacity.
pub struct Opacity;

impl Definition for Opacity {
    fn name(&self) -> &'static str {
        "opacity"
    }

    fn weight(&self, config: &LossConfig) -> f32 {
        config.opacity
    }

    fn numbers(&self, config: &LossConfig) -> [f32; 3] {
        [config.beta, 0.0, 0.0]
    }

    fn example(&self, config: &mut Config) {
        config.loss.opacity = 0.7;
    }
}

impl PixelTerm for Opacity {
    #[inline]
    fn evaluate(
        &self,
        config: &LossConfig,
        pixel: &Pixel,
        target: &Target,
        factor: f32,
        gradient: &mut [f32; 4],
    ) -> f32 {
        let (value, slope) = smooth_l1(pixel.opacity - target.opacity, config.beta);
        gradient[3] += factor * slope;
        value
    }

    fn reference(&self, config: &LossConfig, pixel: [f64; 4], target: &Target) -> f64 {
        smooth_l1::reference(pixel[3] - f64::from(target.opacity), config.beta.into())
    }
}
