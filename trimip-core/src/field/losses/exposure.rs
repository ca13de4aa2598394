//! Exposure of photographs as an adjustment of the compared colour, for `loss.exposure = "gain"`: in each channel, the
//! part of a pixel's colour that is not background is multiplied by the photograph's gain.
//! [`exposure`](crate::engine::exposure) trains the gains.

use super::definition::{Adjustment, Definition};
use crate::config::{Exposure, LossConfig};
use crate::{Config, math::scalar::Real};

/// One gain of each channel of each photograph.
pub struct Gains;

/// Returns the colour that is compared with a photograph: `gain` times the part of `shown` that is not background, plus
/// `behind`. `behind` is the part of `shown` that comes from the background behind a transparent photograph, which no
/// camera exposed.
#[inline]
pub fn exposed<R: Real>(shown: [R; 3], behind: [R; 3], gain: [R; 3]) -> [R; 3] {
    std::array::from_fn(|c| gain[c] * (shown[c] - behind[c]) + behind[c])
}

impl Definition for Gains {
    fn name(&self) -> &'static str {
        "exposure"
    }

    fn weight(&self, config: &LossConfig) -> f32 {
        f32::from(config.exposure == Exposure::Gain)
    }

    fn example(&self, config: &mut Config) {
        (config.loss.exposure, config.optimizer.exposure_rate) = (Exposure::Gain, 1e-2);
    }
}

impl Adjustment for Gains {
    fn reference(&self, shown: [f64; 3], behind: [f64; 3], gains: [f64; 3]) -> [f64; 3] {
        [0, 1, 2].map(|c| (shown[c] - behind[c]) * gains[c] + behind[c])
    }
}
