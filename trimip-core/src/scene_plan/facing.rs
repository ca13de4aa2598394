//! Cameras that look along one direction and at no common place, such as those of a drone that looks straight down or of a walk
//! along a wall: their positions, and the distance to what they see.

use super::common_view::{cameras, focus};
use super::sweep;
use crate::math::symmetric::eigen;
use crate::{Camera, ViewSet};
use glam::DVec3;

/// Cameras look along one direction if the mean of their unit viewing directions is longer than this, as for directions 20
/// degrees from the mean.
const ALONG: f64 = 0.94;

/// Cameras look at no common place if the point nearest to their axes lies farther from the axes than this share of the cameras'
/// spread across the direction. Distance and spread are root mean squares.
const APART: f64 = 0.5;

/// Fewest cameras for this decision.
const FEWEST: usize = 3;

/// Cameras that look along one direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Facing {
    /// Mean of the cameras' positions, world units.
    pub(super) midst: DVec3,
    /// The common viewing direction, a unit vector.
    pub(super) direction: DVec3,
    /// Sides of the region that the cameras occupy perpendicular to the direction, world units, the longer one first.
    pub(super) sides: [f64; 2],
    /// Distance from the midst to what the cameras see, along the direction; `None` if it is not known.
    pub(super) distance: Option<f64>,
    /// Width and height of the area that a picture shows at a distance of one.
    pub(super) picture: [f64; 2],
}

impl Facing {
    /// Describes the cameras of these views; returns `None` if they look in several directions or at a common place.
    pub(super) fn of(views: &ViewSet) -> Option<Self> {
        let directed = |camera: &Camera| camera.intrinsics.lens.model.definition().directed;
        let cameras: Vec<Camera> = cameras(views).into_iter().filter(directed).collect();
        if cameras.len() < FEWEST {
            return None;
        }
        let mean =
            |of: &dyn Fn(&Camera) -> DVec3| cameras.iter().map(of).sum::<DVec3>() / cameras.len() as f64;
        let (midst, looks) = (mean(&|camera| camera.origin), mean(&|camera| -camera.rotation.z_axis));
        if !(looks.length() > ALONG && midst.is_finite()) {
            return None;
        }
        let direction = looks.normalize();
        let across = |camera: &Camera| (camera.origin - midst).reject_from_normalized(direction);
        let spread = mean(&|camera| DVec3::splat(across(camera).length_squared())).x.sqrt();
        let to_axis =
            |camera: &Camera, at: DVec3| (at - camera.origin).reject_from_normalized(camera.rotation.z_axis);
        let meets = focus(&cameras)
            .map(|at| mean(&|camera| DVec3::splat(to_axis(camera, at).length_squared())).x.sqrt());
        if spread == 0.0 || meets.is_some_and(|residual| residual < APART * spread) {
            return None;
        }
        let places: Vec<DVec3> = cameras.iter().map(across).collect();
        let k = cameras[0].intrinsics;
        Some(Self {
            midst,
            direction,
            sides: sides(&places),
            distance: known(views).or_else(|| sweep::distance(views, midst, direction)),
            picture: [f64::from(k.width) / k.fx, f64::from(k.height) / k.fy],
        })
    }

    /// Returns the middle of what the cameras see, and the radius of a ball around it that holds everything they see at that
    /// distance and reaches the cameras; `None` if the distance is not known.
    pub(super) fn ball(&self) -> Option<(DVec3, f64)> {
        let distance = self.distance?;
        let half = |[a, b]: [f64; 2]| 0.5 * a.hypot(b);
        let seen = half(self.sides) + half(self.picture.map(|side| side * distance));
        Some((self.midst + distance * self.direction, seen.max(distance)))
    }

    /// Returns the sides of the region of the cameras, as multiples of the shorter side of the area that a picture shows;
    /// `None` if the distance is not known.
    pub(super) fn pictures(&self) -> Option<[f64; 2]> {
        let picture = self.distance? * self.picture[0].min(self.picture[1]);
        Some(self.sides.map(|side| side / picture))
    }
}

/// Returns the sides of the box around places, along the two axes in which they spread most.
fn sides(places: &[DVec3]) -> [f64; 2] {
    let axes = axes(places);
    let side = |axis: DVec3| {
        let along = || places.iter().map(|place| place.dot(axis));
        along().fold(f64::NEG_INFINITY, f64::max) - along().fold(f64::INFINITY, f64::min)
    };
    [side(axes[0].1), side(axes[1].1)]
}

/// Returns the principal axes of places around their mean, with the standard deviation along each, the largest first.
pub(super) fn axes(places: &[DVec3]) -> [(f64, DVec3); 3] {
    let count = places.len().max(1) as f64;
    let mean = places.iter().sum::<DVec3>() / count;
    let mut covariance = [[0.0; 3]; 3];
    for place in places {
        let from_mean = (*place - mean).to_array();
        for (i, row) in covariance.iter_mut().enumerate() {
            for (j, sum) in row.iter_mut().enumerate() {
                *sum += from_mean[i] * from_mean[j] / count;
            }
        }
    }
    let (values, vectors) = eigen(covariance);
    let column = |k: usize| DVec3::from_array([0, 1, 2].map(|row| vectors[row][k]));
    let mut axes = [0, 1, 2].map(|k| (values[k].max(0.0).sqrt(), column(k)));
    axes.sort_by(|a, b| b.0.total_cmp(&a.0));
    axes
}

/// Returns the median of all known distances.
fn known(views: &ViewSet) -> Option<f64> {
    let mut distances: Vec<f32> = views.depths.iter().map(|known| known.distance).collect();
    distances.sort_by(f32::total_cmp);
    distances.get(distances.len() / 2).map(|&distance| distance.into())
}
