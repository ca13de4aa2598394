//! The encoders by name: what core knows of each before a backend computes it. An encoder is a folder or file here (what it
//! declares, its mathematics, its twin in f64), a file on each backend, and a line in [`of`].

pub mod hash_grid;
pub mod tri_mip;

use crate::{
    Config, Slot,
    batch::{Interval, Ray, Sphere},
    config::EncoderKind,
    params::ALIGNMENT,
};

/// What an encoder declares, without any device.
pub trait Definition: Sync {
    /// What it is, for people: "3 planes of 512×512×16 with 8 mip levels".
    fn describe(&self, config: &Config) -> String;

    /// Features of a sample.
    fn width(&self, config: &Config) -> usize;

    /// Floats that it keeps of a sample between forward and backward: none where features are linear in the parameters.
    fn tape(&self, _config: &Config) -> usize {
        0
    }

    /// Its parameters, in order; their ranges are set by whoever lays them out.
    fn slots(&self, config: &Config) -> Vec<Slot>;

    /// Bytes that a backend derives from the parameters and keeps beside them, gradients of them included.
    fn derived_bytes(&self, _config: &Config) -> u64 {
        0
    }

    /// Stage of growth at `progress` in [0, 1]: 0 is full size; stages fall as a training proceeds.
    fn stage(&self, _config: &Config, _progress: f64) -> u32 {
        0
    }

    /// Floats at the front of a slot that grows which are in use at `stage`.
    fn length(&self, slot: &Slot, _stage: u32) -> usize {
        slot.range.len()
    }

    /// Grows the values of a slot in place, from stage `from` to the earlier stage `to`; optimiser moments alike.
    fn grow(&self, _config: &Config, _values: &mut [f32], _from: u32, _to: u32) {}

    /// The encoder in f64; `values` are its slots' values, in order.
    fn twin(&self, config: &Config, values: Vec<Vec<f64>>) -> Box<dyn Twin>;
}

/// An encoder in f64, one sample at a time: what the backends approximate.
pub trait Twin: Send + Sync {
    /// Features of a sample.
    fn features(&self, at: &Place) -> Vec<f64>;
}

/// Where a sample is, in f64.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Place {
    /// Centre of its sphere, in coordinates of the unit cube.
    pub position: [f64; 3],
    /// Radius of its sphere, in the units of [`Space::aabb`](crate::Space::aabb).
    pub radius: f64,
    /// Unit direction of its ray.
    pub direction: [f64; 3],
    /// Distance along the ray, world units.
    pub t: f64,
    /// Length of its interval, world units.
    pub length: f64,
}

impl Place {
    /// A sample of a ray as the backends have it.
    pub fn new(ray: &Ray, interval: &Interval, sphere: &Sphere) -> Self {
        Self {
            position: sphere.position.map(f64::from),
            radius: sphere.radius.into(),
            direction: ray.direction.map(f64::from),
            t: interval.t.into(),
            length: interval.length.into(),
        }
    }
}

/// All encoders.
const ALL: &[(EncoderKind, &dyn Definition)] =
    &[(EncoderKind::TriMip, &tri_mip::Planes), (EncoderKind::HashGrid, &hash_grid::HashGrid)];

/// The configured encoder.
pub fn of(config: &Config) -> &'static dyn Definition {
    let own = ALL.iter().find(|(kind, _)| *kind == config.encoder.kind);
    own.map_or(ALL[0].1, |(_, definition)| *definition)
}

/// Floats of a row of features: the encoder's width padded to whole registers and tiles.
pub fn stride(config: &Config) -> usize {
    of(config).width(config).next_multiple_of(ALIGNMENT)
}
