//! Inputs of the scene plan.

use crate::{Aabb, Camera, ViewSet, scene::origin::LocalOrigin};

/// Inputs of the plan.
#[derive(Clone, Copy, Debug)]
pub struct Facts<'a> {
    /// The training views.
    pub train: &'a ViewSet,
    /// Cameras that will be rendered, at every scale.
    pub test: &'a [Camera],
    /// The bounding box that the data state.
    pub stated: Option<&'a StatedBox>,
    /// Origin of the coordinates of all these inputs, in the coordinates of the photographs.
    pub origin: LocalOrigin,
    /// The device.
    pub compute: &'a Compute,
}

/// A bounding box stated by the data.
#[derive(Clone, Debug, PartialEq)]
pub struct StatedBox {
    /// The box, world units.
    pub aabb: Aabb<f64>,
    /// Description of its source.
    pub source: String,
    /// True if it lies around points of the scene; false for Instant-NGP's cube.
    pub around_points: bool,
}

/// The device of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Compute {
    /// Description.
    pub name: String,
    /// Expected kept samples per second for networks of 64 units.
    pub samples_per_second: f64,
    /// Least width of hidden layers whose products are faster in bf16 than in f32; `None` if they never are.
    pub bf16_from: Option<u32>,
    /// True for a device that needs about 100,000 samples per step to be busy.
    pub wide: bool,
}

impl Compute {
    /// Returns one CPU thread with wide vectors, for tests and documentation.
    pub fn one_thread() -> Self {
        Self { name: "one thread".into(), samples_per_second: 3e5, bf16_from: None, wide: false }
    }
}
