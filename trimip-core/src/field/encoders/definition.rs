//! The device-independent part of an encoder: its declaration, and its features in f64.

use crate::{
    Config, Slot,
    geometry::elements::{Interval, Ray, Sphere},
};

/// The declaration of an encoder, independent of any device.
pub trait Definition: Sync {
    /// Description for the user: "3 planes of 512×512×16 with 8 mip levels".
    fn describe(&self, config: &Config) -> String;

    /// Number of features of a sample.
    fn width(&self, config: &Config) -> usize;

    /// Number of leading features whose sum is the density logit; 0 if the density network computes the logit. The network
    /// is then a linear map of the other features.
    fn summed(&self, _config: &Config) -> usize {
        0
    }

    /// True if the features are the density logit and the logits of red, green and blue. The field has no networks then.
    fn direct(&self) -> bool {
        false
    }

    /// Floats kept per sample from forward to backward; 0 if features are linear in the parameters.
    fn context(&self, _config: &Config) -> usize {
        0
    }

    /// The encoder's slots, in order. Their ranges are set by the [`Layout`](crate::field::params::Layout).
    fn slots(&self, config: &Config) -> Vec<Slot>;

    /// Bytes that a backend derives from the parameters and keeps in addition to them, including their gradients.
    fn derived_bytes(&self, _config: &Config) -> u64 {
        0
    }

    /// Advice for a run that is predicted to need too much memory: "lower voxels.sides".
    fn lowered_by(&self) -> &'static str {
        "lower field.hidden"
    }

    /// Stage of growth at `progress` in [0, 1]. Stage 0 is full size; the stage decreases as training proceeds.
    fn stage(&self, _config: &Config, _progress: f64) -> u32 {
        0
    }

    /// Number of floats at the front of a growing slot that are in use at `stage`.
    fn length(&self, _config: &Config, slot: &Slot, _stage: u32) -> usize {
        slot.range.len()
    }

    /// Grows the values of a slot in place, from stage `from` to the lower stage `to`. Optimiser moments grow in the
    /// same way, unless they restart.
    fn grow(&self, _config: &Config, _slot: &Slot, _values: &mut [f32], _from: u32, _to: u32) {}

    /// The progress at which the optimiser's moments, of all slots, and its learning rate last restarted, for an encoder
    /// that restarts them whenever it grows; otherwise `None`.
    fn restarted(&self, _config: &Config, _progress: f64) -> Option<f64> {
        None
    }

    /// Weight of the absolute value of each parameter of a slot in the loss, at `stage` (L1).
    fn sparsity(&self, _config: &Config, _slot: &Slot, _stage: u32) -> f64 {
        0.0
    }

    /// The encoder in f64; `values` are its slots' values, in order.
    fn reference(&self, config: &Config, values: Vec<Vec<f64>>) -> Box<dyn Reference>;
}

/// An encoder in f64, one sample at a time: the reference that the backends approximate.
pub trait Reference: Send + Sync {
    /// The features of a sample.
    fn features(&self, at: &SamplePosition) -> Vec<f64>;
}

/// The position of a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SamplePosition<R = f64> {
    /// Centre of its sphere, in coordinates of the unit cube.
    pub position: [R; 3],
    /// Radius of its sphere, in the units of [`Space::aabb`](crate::Space::aabb).
    pub radius: R,
    /// Unit direction of its ray.
    pub direction: [R; 3],
    /// Distance from the apex of the ray's cone, world units.
    pub t: R,
    /// Length of its interval, world units.
    pub length: R,
}

impl SamplePosition {
    /// Converts a sample from the backends' representation.
    pub fn new(ray: &Ray, interval: &Interval, sphere: &Sphere) -> Self {
        Self {
            position: sphere.position.map(f64::from),
            radius: sphere.radius.into(),
            direction: ray.direction.map(f64::from),
            t: ray.apex_distance(interval.t).into(),
            length: interval.length.into(),
        }
    }
}
