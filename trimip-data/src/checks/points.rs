//! Checks poses against points of structure from motion: the reprojection errors of the points that a camera saw, and
//! whether these points are in front of the camera. Errors are in pixels of the finest scale.

use super::{
    check::{Check, Suspect, Values, Verdict},
    views::{cameras, median, of_views},
};
use crate::{Point, points::Observation};
use glam::DVec3;
use trimip_core::{Camera, ViewSet};

/// Median reprojection error above which a view is doubted, pixels: bundle adjustment leaves about one pixel.
const MOST_PIXELS: f64 = 3.0;

/// Multiple of the median of all views above which the median error of a view is doubted.
const MOST_TIMES: f64 = 4.0;

/// A view whose median error is below this many pixels is never doubted by [`MOST_TIMES`]: such an error blurs nothing.
const NEGLIGIBLE: f64 = 1.0;

/// Least number of points with which the median of a view is meaningful.
const LEAST_POINTS: usize = 8;

/// Axes are doubted if fewer than this share of the points are in front of the cameras that saw them: with correct poses all are.
const LEAST_AHEAD: f64 = 0.95;

/// Returns all observations: the position of the point, the observation, and the camera of its view.
fn observed<'a>(
    cameras: &'a [Camera],
    points: &'a [Point],
) -> impl Iterator<Item = (DVec3, &'a Observation, &'a Camera)> {
    points.iter().flat_map(move |point| {
        let seen = point.track.iter();
        seen.filter_map(move |seen| Some((point.position.into(), seen, cameras.get(seen.view as usize)?)))
    })
}

/// Checks that points project to where the views saw them. The verdict is unknown without `points` that list the views
/// that saw them.
pub fn reprojection(train: &ViewSet, points: &[Point]) -> Check {
    const NAME: &str = "reprojection of points";
    let limit = format!(
        "a view whose median error is above {MOST_PIXELS} pixels, or above both {MOST_TIMES} times the median of all views and \
         {NEGLIGIBLE} pixel: bundle adjustment leaves about one pixel"
    );
    let cameras = cameras(train);
    let mut errors: Vec<Vec<f64>> = vec![Vec::new(); cameras.len()];
    for (position, seen, camera) in observed(&cameras, points) {
        // A point without an image in the camera gets the largest error.
        errors[seen.view as usize].push(seen.error(position, camera).unwrap_or(f64::MAX));
    }
    let enough = |errors: Vec<f64>| if errors.len() < LEAST_POINTS { None } else { median(errors) };
    let medians: Vec<Option<f64>> = errors.into_iter().map(enough).collect();
    let Some(middle) = median(medians.iter().copied().flatten()) else {
        return Check::unknown(NAME, limit, "no points that list the views that saw them");
    };
    let most = MOST_PIXELS.min((MOST_TIMES * middle).max(NEGLIGIBLE));
    let mut doubted: Vec<(usize, f64)> = medians
        .iter()
        .enumerate()
        .filter_map(|(view, error)| Some((view, (*error)?)))
        .filter(|(_, error)| *error > most)
        .collect();
    doubted.sort_by(|a, b| b.1.total_cmp(&a.1));
    let told = |error: f64| {
        if error < 1e4 { format!("{error:.2} pixels") } else { "nowhere near".to_string() }
    };
    let of_all = match told(middle) {
        far if middle >= 1e4 => format!("points lie {far} where the views saw them"),
        pixels => format!("points lie {pixels} from where the views saw them (median of the views)"),
    };
    let (figure, verdict) = match doubted.len() {
        0 => (of_all, Verdict::Fine),
        some => (
            format!("{of_all}; more than {most:.1} pixels in {}", of_views(some, cameras.len())),
            Verdict::Suspicious(
                "these poses or focal lengths do not match the photographs: calibrate again, or leave the views out",
            ),
        ),
    };
    let suspects = doubted.into_iter().map(|(view, error)| Suspect { view, figure: told(error) }).collect();
    // A view whose median error is 10,000 pixels or more has no value.
    let of = medians.into_iter().map(|error| error.filter(|error| *error < 1e4)).collect();
    let values = vec![Values { name: "reprojection error / pixels", of }];
    Check { name: NAME, figure, limit, verdict, suspects, values }
}

/// Checks that points are in front of the cameras that saw them. The verdict is unknown without `points` that list the
/// views that saw them.
pub fn ahead(train: &ViewSet, points: &[Point]) -> Check {
    const NAME: &str = "points in front of cameras";
    let limit = format!(
        "less than {:.0} % of the points in front of the cameras that saw them: with right poses all are",
        100.0 * LEAST_AHEAD
    );
    let cameras = cameras(train);
    let mut counts = vec![[0_u32; 2]; cameras.len()];
    for (position, seen, camera) in observed(&cameras, points) {
        let at = camera.rotation.transpose() * (position - camera.origin);
        let [front, all] = &mut counts[seen.view as usize];
        // A fisheye also sees to the side and behind itself.
        *front += u32::from(at.z < 0.0 || camera.intrinsics.image_of(at).is_some());
        *all += 1;
    }
    let [front, all] =
        counts.iter().fold([0_u64; 2], |sum, count| [0, 1].map(|i| sum[i] + u64::from(count[i])));
    if all == 0 {
        return Check::unknown(NAME, limit, "no points that list the views that saw them");
    }
    let fractions: Vec<Option<f64>> =
        counts.iter().map(|&[front, all]| (all > 0).then(|| f64::from(front) / f64::from(all))).collect();
    let fraction = front as f64 / all as f64;
    let mut doubted: Vec<(usize, f64)> = fractions
        .iter()
        .enumerate()
        .filter_map(|(view, fraction)| Some((view, (*fraction)?)))
        .filter(|(view, fraction)| *fraction < LEAST_AHEAD && counts[*view][1] as usize >= LEAST_POINTS)
        .collect();
    doubted.sort_by(|a, b| a.1.total_cmp(&b.1));
    let verdict = match fraction < LEAST_AHEAD || !doubted.is_empty() {
        true => Verdict::Suspicious(
            "cameras look the wrong way: poses are camera-to-world with OpenGL axes (x right, y up, looking along -z); \
             for OpenCV's axes, change the signs of the second and third column",
        ),
        false => Verdict::Fine,
    };
    Check {
        name: NAME,
        figure: format!(
            "{:.1} % of {all} observations have their point in front of the camera",
            100.0 * fraction
        ),
        limit,
        verdict,
        suspects: doubted
            .into_iter()
            .map(|(view, fraction)| Suspect { view, figure: format!("{:.0} %", 100.0 * fraction) })
            .collect(),
        values: Vec::new(),
    }
}
