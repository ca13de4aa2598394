//! The settings of the loss and of all its terms.

use super::{
    choices::{Exposure, LossRays},
    schedule::Schedule,
    section,
};
use serde::{Deserialize, Serialize};

section!(
    /// The loss.
    LossConfig, "loss" {
        photometric: Photometric, beta: f32, padding: f32, opacity: f32, distortion: f32, depth: Schedule,
        depth_outliers: f32, exposure: Exposure, rays: LossRays,
    }
);

/// Names of the photometric terms.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Photometric {
    /// Smooth-L1: quadratic up to `beta`, linear beyond.
    SmoothL1,
    /// Charbonnier: √(d² + `padding`²).
    Charbonnier,
}
