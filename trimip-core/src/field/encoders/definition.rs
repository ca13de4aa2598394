//! The device-independent part of an encoder: its declaration, and its features in f64.

use crate::{
    Config, Slot,
    geometry::elements::{Interval, Ray, Sphere},
};

/// The declaration of an encoder, independent of any device.
pub trait Definition: Sync {
    /// Returns a description for the user, such as "3 planes of 512×512×16 with 8 mip levels".
    fn describe(&self, config: &Config) -> String;

    /// Returns the number of features of a sample.
    fn width(&self, config: &Config) -> usize;

    /// Returns the number of leading features whose sum is the density logit; the density network is then a linear map
    /// of the other features. Returns 0 if the density network computes the logit.
    fn summed(&self, _config: &Config) -> usize {
        0
    }

    /// Returns true if the features are the density logit and the logits of red, green and blue. The field then has no
    /// networks.
    fn direct(&self) -> bool {
        false
    }

    /// Returns the number of floats per sample that the forward pass keeps for the backward pass; 0 if features are
    /// linear in the parameters.
    fn context(&self, _config: &Config) -> usize {
        0
    }

    /// Returns the encoder's slots, in order. The [`Layout`](crate::field::params::Layout) sets their ranges.
    fn slots(&self, config: &Config) -> Vec<Slot>;

    /// Returns the number of bytes that a backend derives from the parameters and keeps in addition to them, including
    /// the gradients of the derived data.
    fn derived_bytes(&self, _config: &Config) -> u64 {
        0
    }

    /// Returns advice for a run that is predicted to need too much memory, such as "lower voxels.sides".
    fn lowered_by(&self) -> &'static str {
        "lower field.hidden"
    }

    /// Returns the stage of growth at `progress` in [0, 1]. Stage 0 is full size; the stage decreases as training
    /// proceeds.
    fn stage(&self, _config: &Config, _progress: f64) -> u32 {
        0
    }

    /// Returns the number of floats at the front of a growing slot that are in use at `stage`.
    fn length(&self, _config: &Config, slot: &Slot, _stage: u32) -> usize {
        slot.range.len()
    }

    /// Grows the values of a slot in place, from stage `from` to the lower stage `to`. Optimiser moments grow in the
    /// same way, unless they restart.
    fn grow(&self, _config: &Config, _slot: &Slot, _values: &mut [f32], _from: u32, _to: u32) {}

    /// Returns the progress at which the optimiser's learning rate and all of its moments last restarted. Returns
    /// `None` for an encoder that does not restart them when it grows.
    fn restarted(&self, _config: &Config, _progress: f64) -> Option<f64> {
        None
    }

    /// Returns the weight of the L1 term of a slot in the loss, at `stage`: the factor of the absolute value of each
    /// parameter.
    fn sparsity(&self, _config: &Config, _slot: &Slot, _stage: u32) -> f64 {
        0.0
    }

    /// Creates the encoder in f64; `values` are the values of its slots, in order.
    fn reference(&self, config: &Config, values: Vec<Vec<f64>>) -> Box<dyn Reference>;
}

/// An encoder in f64, one sample at a time: the reference that the backends approximate.
pub trait Reference: Send + Sync {
    /// Returns the features of a sample, [`width`](Definition::width) numbers.
    fn features(&self, at: &SamplePosition) -> Vec<f64>;
}

/// The position of a sample.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SamplePosition<R = f64> {
    /// Centre of the sample's sphere, in coordinates of the unit cube.
    pub position: [R; 3],
    /// Radius of the sample's sphere, in the units of [`Space::aabb`](crate::Space::aabb).
    pub radius: R,
    /// Unit direction of the sample's ray.
    pub direction: [R; 3],
    /// Distance from the apex of the ray's cone, in world units.
    pub t: R,
    /// Length of the sample's interval, in world units.
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
