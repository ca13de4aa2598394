//! Points of a scene from structure from motion: their positions, reliability and tracks, and the box around them.
//! Positions are in world units of the poses, places in photographs in pixels.

use glam::DVec3;
use trimip_core::{Aabb, Camera, plural::count, scene_plan::StatedBox};

/// Share of the points dropped as outliers at each end of an axis.
const OUTLIERS: f64 = 0.02;
/// Margin at each end, as a share of the points' extent.
const MARGIN: f64 = 0.05;
/// Fewest points from which a box is made.
const LEAST_POINTS: usize = 100;
/// Least number of images that saw a point that bounds the scene: the two rays of a wrong match may also meet.
const LEAST_SEEN: usize = 3;
/// Largest reprojection error of a point that bounds the scene, pixels.
const LARGEST_ERROR: f64 = 2.0;

/// A point of the scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Point {
    /// Position in world units.
    pub position: [f64; 3],
    /// Colour: red, green, blue; black if the file states none.
    pub color: [u8; 3],
    /// Mean reprojection error in pixels of the original photographs, if it is known.
    pub error: Option<f64>,
    /// Number of photographs in which the point was found, if it is known.
    pub seen: Option<usize>,
    /// Training views that saw it.
    pub track: Vec<Observation>,
}

/// An observation of a point in a view.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Observation {
    /// Index among the views of the finest scale.
    pub view: u32,
    /// Position in that view, pixels.
    pub at: [f64; 2],
}

impl Observation {
    /// Returns the reprojection error in pixels: the distance between the place at which the view saw the point and the
    /// projection of `position` by `camera`, the camera of the view. `None` if the camera has no image of `position`.
    pub fn error(&self, position: DVec3, camera: &Camera) -> Option<f64> {
        let at = camera.rotation.transpose() * (position - camera.origin);
        let [x, y] = camera.intrinsics.image_of(at)?;
        let error = (x - self.at[0]).hypot(y - self.at[1]);
        error.is_finite().then_some(error)
    }
}

impl Point {
    /// Returns true unless too few images saw the point or its reprojection error is too large.
    pub fn is_sure(&self) -> bool {
        self.seen.is_none_or(|seen| seen >= LEAST_SEEN)
            && self.error.is_none_or(|error| error <= LARGEST_ERROR)
    }
}

/// Points whose tracks refer to the frames of a file.
#[derive(Debug, Default)]
pub(crate) struct Cloud {
    pub(crate) points: Vec<Point>,
    /// Names of the frames; tracks hold indices into this list.
    pub(crate) frames: Vec<String>,
}

impl Cloud {
    /// Returns the box around the reliable points; `source` says where they come from.
    pub(crate) fn stated(&self, source: &str) -> Option<StatedBox> {
        let sure: Vec<[f64; 3]> =
            self.points.iter().filter(|point| point.is_sure()).map(|point| point.position).collect();
        if sure.len() < LEAST_POINTS {
            return None;
        }
        let named = if sure.len() == self.points.len() {
            count(sure.len(), "point")
        } else {
            format!("{} reliable ones of {}", sure.len(), count(self.points.len(), "point"))
        };
        Some(StatedBox {
            aabb: around(&sure),
            source: format!("around {named} {source}"),
            around_points: true,
        })
    }

    /// Returns the points, with tracks of training views instead of frames. `views` are the names of the views at the
    /// finest scale, whose photographs were halved `halvings` times.
    pub(crate) fn seen_by<'a>(self, views: impl Iterator<Item = &'a str>, halvings: u32) -> Vec<Point> {
        let mut points = self.points;
        if points.iter().all(|point| point.track.is_empty()) {
            return points;
        }
        let known: std::collections::HashMap<&str, u32> = views.zip(0..).collect();
        let views: Vec<Option<u32>> =
            self.frames.iter().map(|name| known.get(name.as_str()).copied()).collect();
        let scale = f64::from(1_u32 << halvings).recip();
        for point in &mut points {
            point.track.retain_mut(|seen| match views.get(seen.view as usize).copied().flatten() {
                Some(view) => {
                    *seen = Observation { view, at: seen.at.map(|place| place * scale) };
                    true
                }
                None => false,
            });
        }
        points
    }
}

/// Returns the box around all points except outliers, with a margin.
fn around(points: &[[f64; 3]]) -> Aabb<f64> {
    let range = |axis: usize| {
        let mut values: Vec<f64> = points.iter().map(|point| point[axis]).collect();
        values.sort_by(f64::total_cmp);
        let cut = (OUTLIERS * values.len() as f64) as usize;
        let (low, high) = (values[cut], values[values.len() - 1 - cut]);
        let margin = MARGIN * (high - low).max(f64::MIN_POSITIVE);
        [low - margin, high + margin]
    };
    let ranges = [range(0), range(1), range(2)];
    Aabb { min: ranges.map(|[low, _]| low), max: ranges.map(|[_, high]| high) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(x: f64, seen: Option<usize>, error: Option<f64>) -> Point {
        Point { position: [x, 2.0 * x, -x], color: [0; 3], error, seen, track: Vec::new() }
    }

    #[test]
    fn points_that_few_images_saw_or_that_miss_their_places_bound_nothing() {
        let mut points: Vec<Point> =
            (0..200).map(|i| point(f64::from(i) / 199.0, Some(3), Some(2.0))).collect();
        let sure = Cloud { points: points.clone(), frames: Vec::new() }.stated("here").unwrap();
        points.extend((0..100).map(|i| point(50.0 + f64::from(i), Some(2), Some(0.1))));
        points.extend((0..100).map(|i| point(-50.0 - f64::from(i), Some(9), Some(2.1))));
        let found = Cloud { points: points.clone(), frames: Vec::new() }.stated("here").unwrap();
        assert_eq!(found.aabb, sure.aabb);
        assert_eq!(found.source, "around 200 reliable ones of 400 points here");
        // If errors and numbers of photographs are unknown, every point counts.
        let plain = points.iter().map(|p| Point { error: None, seen: None, ..p.clone() }).collect();
        assert!(Cloud { points: plain, frames: Vec::new() }.stated("here").unwrap().aabb.max[0] > 100.0);
        points.truncate(99);
        assert_eq!(Cloud { points, frames: Vec::new() }.stated("here"), None);
    }

    #[test]
    fn tracks_count_the_training_views_in_their_pixels() {
        let seen = |view, x| Observation { view, at: [x, 2.0] };
        let own = Point { track: vec![seen(0, 4.0), seen(2, 8.0), seen(1, 6.0)], ..point(0.0, None, None) };
        let frames = ["a", "b", "c"].map(String::from).to_vec();
        let cloud = Cloud { points: vec![own], frames };
        let points = cloud.seen_by(["c", "a"].into_iter(), 1);
        let half = |view, x| Observation { view, at: [x, 1.0] };
        assert_eq!(points[0].track, [half(1, 2.0), half(0, 4.0)]);
    }
}
