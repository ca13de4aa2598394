//! Checks of a scene before training: figures that reveal wrong poses, axes, exposures and boxes, and duplicates. Every
//! check is a function of typed data, with its limits as constants; none decodes a photograph.

mod brightness;
mod check;
mod coverage;
mod doubles;
mod focus;
mod points;
mod rig;
mod silhouettes;
mod sizes;
mod views;

pub use brightness::{brightness, stops};
pub use check::{Check, Suspect, Values, Verdict};
pub use coverage::coverage;
pub use doubles::{photographs, poses};
pub use focus::focus;
pub use points::{ahead, reprojection};
pub use rig::{number, optics, stray};
pub use silhouettes::silhouettes;
pub use sizes::sizes;
pub use views::{coarsest, name};

use crate::Point;
use trimip_core::{Aabb, Camera, ViewSet};

/// Data of the scene to check.
#[derive(Clone, Copy, Debug)]
pub struct Subject<'a> {
    /// The training views.
    pub train: &'a ViewSet,
    /// Name and camera of each test frame.
    pub test: &'a [(String, Camera)],
    /// Points of structure from motion, with the training views that saw them.
    pub points: &'a [Point],
    /// The planned box, world units; `None` for unbounded space.
    pub aabb: Option<&'a Aabb<f64>>,
}

/// Runs all checks and returns their results.
pub fn all(subject: &Subject<'_>) -> Vec<Check> {
    let Subject { train, test, points, aabb } = *subject;
    vec![
        number(train),
        stray(train),
        optics(train),
        silhouettes(train),
        reprojection(train, points),
        ahead(train, points),
        focus(train, points),
        brightness(train),
        poses(train, test),
        photographs(train),
        coverage(train, aabb),
        sizes(train),
    ]
}
