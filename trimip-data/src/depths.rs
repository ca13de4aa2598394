//! Known depths of the training views: each point that several photographs saw gives the distance at which the rays of
//! some pixels end. Depth images give more known depths ([`depth_images`](crate::depth_images)).

use crate::points::{Observation, Point};
use glam::DVec3;
use trimip_core::{Scale, View, ViewSet, scene::depths::KnownDepth};

/// Least error of a point's place in a photograph, pixels: no feature is found more precisely.
const LEAST_ERROR: f64 = 0.5;

/// Least sine of the angle between the rays that triangulate a point.
const LEAST_SINE: f64 = 1e-3;

/// A view agrees with a point if its reprojection error is at most the larger of two limits: `MOST_PIXELS` pixels of
/// the finest scale, and `MOST_TIMES` times the view's median error, since a wrong pose moves all points of a view.
const MOST_PIXELS: f64 = 4.0;
const MOST_TIMES: f64 = 3.0;

/// Returns the known depths of all pixels, at all scales, in which a reliable point was seen, sorted by pixel. If a
/// pixel has several points, the nearest one counts, because it hides the others. A point is reliable if at least half
/// of the training views that saw it, and at least two, agree with it.
pub(crate) fn of_points(points: &[Point], train: &ViewSet) -> Vec<KnownDepth> {
    let Some(finest) = train.scales.first() else { return Vec::new() };
    let views = &train.views[finest.views.clone()];
    let scales: Vec<&Scale> =
        train.scales.iter().filter(|scale| scale.views.len() == finest.views.len()).collect();
    let errors = errors(points, views);
    let limits = limits(points, &errors, views.len());
    let mut depths = Vec::new();
    for (point, errors) in points.iter().zip(&errors).filter(|(point, _)| point.is_sure()) {
        let position = DVec3::from(point.position);
        let agrees = |(seen, error): &(&Observation, &f64)| {
            limits.get(seen.view as usize).is_some_and(|limit| *error <= limit)
        };
        let track: Vec<Observation> =
            point.track.iter().zip(errors).filter(agrees).map(|(seen, _)| *seen).collect();
        if track.len() < 2.max(point.track.len().div_ceil(2)) {
            continue;
        }
        let sine = widest_sine(position, &track, views);
        for seen in &track {
            let Some(view) = views.get(seen.view as usize) else { continue };
            let distance = (position - view.camera.origin).length();
            let k = &view.camera.intrinsics;
            let error = point.error.unwrap_or(0.0).max(LEAST_ERROR) / (k.fx * k.fy).sqrt();
            let deviation = error * distance / sine.max(LEAST_SINE);
            let known = |pixel| KnownDepth { pixel, distance: distance as f32, deviation: deviation as f32 };
            depths.extend(scales.iter().filter_map(|scale| pixel(train, scale, seen)).map(known));
        }
    }
    nearest(depths)
}

/// Drops known depths that are not finite, keeps only the nearest of each pixel, and sorts by pixel.
pub(crate) fn nearest(mut depths: Vec<KnownDepth>) -> Vec<KnownDepth> {
    depths.retain(|known| known.distance.is_finite() && known.deviation > 0.0 && known.deviation.is_finite());
    depths.sort_unstable_by(|a, b| {
        (a.pixel, a.distance).partial_cmp(&(b.pixel, b.distance)).unwrap_or(a.pixel.cmp(&b.pixel))
    });
    depths.dedup_by_key(|known| known.pixel);
    depths
}

/// Returns the reprojection errors of each point in pixels of the finest scale, in the order of its track. An error is
/// infinite if the view has no image of the point or is not among `views`.
fn errors(points: &[Point], views: &[View]) -> Vec<Vec<f64>> {
    let of_point = |point: &Point| {
        let of =
            |seen: &Observation| seen.error(point.position.into(), &views.get(seen.view as usize)?.camera);
        point.track.iter().map(|seen| of(seen).unwrap_or(f64::INFINITY)).collect()
    };
    points.iter().map(of_point).collect()
}

/// Returns for each view the largest reprojection error at which the view agrees with a point. `errors` holds the
/// errors of each point, in the order of its track.
fn limits(points: &[Point], errors: &[Vec<f64>], views: usize) -> Vec<f64> {
    let mut of_view = vec![Vec::new(); views];
    for (seen, &error) in points.iter().zip(errors).flat_map(|(point, errors)| point.track.iter().zip(errors))
    {
        if let Some(of_view) = of_view.get_mut(seen.view as usize) {
            of_view.push(error);
        }
    }
    let limit = |mut errors: Vec<f64>| {
        let middle = errors.len() / 2;
        let median = match errors.is_empty() {
            true => 0.0,
            false => *errors.select_nth_unstable_by(middle, f64::total_cmp).1,
        };
        // An infinite median means that the view has a wrong pose, so it agrees with no point.
        if median.is_finite() { MOST_PIXELS.max(MOST_TIMES * median) } else { 0.0 }
    };
    of_view.into_iter().map(limit).collect()
}

/// Returns the sine of the widest angle between two rays to a point, or 1 if this angle is obtuse.
fn widest_sine(position: DVec3, track: &[Observation], views: &[View]) -> f64 {
    let directions: Vec<DVec3> = track
        .iter()
        .filter_map(|seen| views.get(seen.view as usize))
        .map(|view| (position - view.camera.origin).normalize_or_zero())
        .collect();
    let pairs =
        directions.iter().enumerate().flat_map(|(i, a)| directions[..i].iter().map(move |b| (*a, *b)));
    let sine = |(a, b): (DVec3, DVec3)| if a.dot(b) <= 0.0 { 1.0 } else { a.cross(b).length() };
    pairs.map(sine).fold(0.0, f64::max)
}

/// Returns the index, among all pixels of the set, of the pixel of a scale that contains a feature.
pub(crate) fn pixel(train: &ViewSet, scale: &Scale, seen: &Observation) -> Option<u32> {
    let view = train.views[scale.views.clone()].get(seen.view as usize)?;
    let k = &view.camera.intrinsics;
    let [x, y] = seen.at.map(|place| (place / f64::from(scale.factor)).floor());
    let inside = x >= 0.0 && y >= 0.0 && x < f64::from(k.width) && y < f64::from(k.height);
    inside.then(|| view.offset + y as usize * k.width as usize + x as usize)?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::{Alpha, Camera, Intrinsics};

    /// Returns two scales of three views of 8×4 pixels, whose cameras look along −z from x = 0, 1 and 2.
    fn views() -> ViewSet {
        let camera = |x: f64, level: u32| Camera {
            intrinsics: Intrinsics { cx: 4.0, cy: 2.0, ..Intrinsics::from_angle(8, 4, 0.7) }.reduced(level),
            rotation: glam::DMat3::IDENTITY,
            origin: DVec3::new(x, 0.0, 0.0),
        };
        let view = |i: usize, level: u32| View {
            name: format!("{i}"),
            camera: camera(i as f64, level),
            offset: if level == 0 { 32 * i } else { 96 + 8 * i },
        };
        let scale = |level: u32, views, pixels| Scale { factor: 1 << level, weight: 4.0, views, pixels };
        ViewSet {
            views: (0..6).map(|i| view(i % 3, i as u32 / 3)).collect(),
            pixels: vec![[0; 4]; 120].into(),
            alpha: Alpha::Straight,
            scales: vec![scale(0, 0..3, 0..96), scale(1, 3..6, 96..120)],
            depths: Vec::new(),
        }
    }

    fn point(z: f64, track: &[(u32, [f64; 2])]) -> Point {
        let track = track.iter().map(|&(view, at)| Observation { view, at }).collect();
        Point { position: [0.0, 0.0, z], color: [0; 3], error: Some(1.0), seen: Some(3), track }
    }

    #[test]
    fn points_are_known_in_their_pixels_at_every_scale() {
        let own = point(-3.0, &[(0, [4.9, 2.0]), (2, [0.0, 3.5]), (1, [8.0, 0.5])]);
        let found = of_points(&[own], &views());
        // Row 2, column 4 of view 0; row 3, column 0 of view 2; the feature of view 1 lies outside of its picture.
        let pixels: Vec<u32> = found.iter().map(|known| known.pixel).collect();
        assert_eq!(pixels, [2 * 8 + 4, 64 + 3 * 8, 96 + 4 + 2, 96 + 16 + 4]);
        let far = 13.0_f64.sqrt();
        for (known, distance) in found.iter().zip([3.0, far, 3.0, far]) {
            assert!((f64::from(known.distance) - distance).abs() < 1e-6, "{known:?}");
            // One pixel of the finest scale, divided by the sine of the angle between the views 0 and 2.
            let deviation = distance / views().views[0].camera.intrinsics.fx / (2.0 / far);
            assert!((f64::from(known.deviation) - deviation).abs() < 1e-5 * deviation, "{known:?}");
        }
    }

    #[test]
    fn the_nearest_point_of_a_pixel_counts() {
        let track = [(0, [3.5, 1.5]), (1, [1.5, 1.5])];
        for points in [[-5.0, -4.0], [-4.0, -5.0]] {
            let found = of_points(&points.map(|z| point(z, &track)), &views());
            assert_eq!(found.len(), 4);
            assert_eq!((found[0].pixel, found[0].distance), (8 + 3, 4.0));
        }
    }

    #[test]
    fn unsure_points_and_those_of_one_view_tell_nothing() {
        let track = [(0, [3.5, 1.5]), (1, [1.5, 1.5])];
        let sure = point(-4.0, &track);
        assert_eq!(of_points(std::slice::from_ref(&sure), &views()).len(), 4);
        let unsure = [
            Point { seen: Some(2), ..sure.clone() },
            Point { error: Some(2.5), ..sure.clone() },
            point(-4.0, &track[..1]),
            Point { track: vec![], ..sure },
        ];
        assert_eq!(of_points(&unsure, &views()), []);
    }

    #[test]
    fn points_that_are_not_where_the_views_saw_them_tell_nothing() {
        let k = views().views[0].camera.intrinsics;
        // The positions at which the three views see a place.
        let seen = |[x, y, z]: [f64; 3]| {
            [0.0, 1.0, 2.0].map(|origin| [k.cx + k.fx * (x - origin) / -z, k.cy - k.fy * y / -z])
        };
        let track = |place| {
            let seen = seen(place);
            [0, 1, 2].map(|view| (view as u32, seen[view]))
        };
        let at = |position, track: &[(u32, [f64; 2])]| Point { position, ..point(0.0, track) };
        let right: Vec<Point> = (0..9)
            .map(|i| [0.1 * f64::from(i), 0.05 * f64::from(i), -6.0])
            .map(|place| at(place, &track(place)))
            .collect();
        let known = of_points(&right, &views());
        assert!(!known.is_empty());
        let wrong = [[0.5, 0.2, 6.0], [6.0, 0.0, -6.0], [0.0, -3.0, -2.0]];
        let wrong = wrong.map(|position| at(position, &track([0.5, 0.2, -6.0])));
        assert_eq!(of_points(&[right.clone(), wrong.to_vec()].concat(), &views()), known);
        // A point that one view found in a wrong place still counts in the other views.
        let place = [0.5, -0.6, -6.0];
        let mut once = track(place);
        once[1].1 = [7.5, 0.5];
        let views_of = |points: &[Point]| {
            let finest = of_points(points, &views()).into_iter().filter(|known| known.pixel < 96);
            finest.filter(|own| !known.contains(own)).map(|own| own.pixel / 32).collect::<Vec<_>>()
        };
        assert_eq!(views_of(&[right.clone(), vec![at(place, &once)]].concat()), [0, 2]);
        // All features of view 0 are shifted, as by a wrong pose: the view still agrees with them.
        let turned = right.iter().cloned().map(|mut point| {
            point.track[0].at[0] -= 4.5;
            point
        });
        assert!(views_of(&turned.collect::<Vec<_>>()).contains(&0));
    }
}
