//! A film along the training cameras: a smooth path near all of them, so that the film shows only parts that photographs show. World units.

use super::cameras::Named;
use glam::{DMat3, DVec3};
use trimip_core::{Advice, Camera, Error, Intrinsics, Place, Result};

/// Standard deviation of the smoothing, in units of the mean distance between neighbouring cameras.
const SMOOTH: f64 = 1.0;

/// Ratio of two path lengths: in the order of the photographs, and from each camera to the nearest one left. If it is greater than this,
/// the photographs were not taken one after the other.
const DETOUR: f64 = 1.5;

/// Mean viewing directions shorter than this count as 0: cameras that look in opposite directions have no mean.
const NO_LOOK: f64 = 1e-6;

/// Returns `count` cameras along `photographed`, evenly spaced from the first to the last, without the distortion of the lens. If the
/// photographs are out of order, the path goes from each camera to the nearest one left. A camera's turn adds its arc at `radius`, the
/// distance of the subject, to the length of the path.
///
/// # Errors
/// When all cameras are at one position and look in one direction.
pub fn cameras(photographed: &[Camera], count: u32, radius: f64) -> Result<Vec<Named>> {
    let refuse = || {
        let what = format!("the training split has {} different cameras", photographed.len().min(1));
        let advice = Advice::Argument("use {turntable} or {path}".into());
        Error::input(Place::option("flythrough"), what, advice)
    };
    let along = ordered(photographed, radius);
    let (Some(first), Some(last)) = (along.first(), places(&along, radius).pop()) else {
        return Err(refuse());
    };
    // The negated comparison also refuses NaN.
    if !(last > 0.0) {
        return Err(refuse());
    }
    let intrinsics = Intrinsics { lens: first.intrinsics.lens.without_distortion(), ..first.intrinsics };
    let places = places(&along, radius);
    let spread = SMOOTH * last / (along.len() - 1) as f64;
    let at = |i: u32| last * f64::from(i) / f64::from(count.max(2) - 1);
    let camera = |i: u32| Camera { intrinsics, ..smoothed(&along, &places, at(i), spread) };
    Ok((0..count).map(|i| (format!("{i:04}"), camera(i))).collect())
}

/// Returns the distance between two cameras: that of their positions, plus the arc between their viewing directions at `radius`.
fn distance(a: &Camera, b: &Camera, radius: f64) -> f64 {
    let turn = a.rotation.z_axis.angle_between(b.rotation.z_axis);
    (a.origin - b.origin).length() + radius * turn
}

/// Returns the distance of each camera from the first, along the path.
fn places(along: &[Camera], radius: f64) -> Vec<f64> {
    let mut sum = 0.0;
    let steps = along.windows(2).map(|pair| distance(&pair[0], &pair[1], radius));
    std::iter::once(0.0)
        .chain(steps)
        .map(|step| {
            sum += step;
            sum
        })
        .take(along.len())
        .collect()
}

/// Returns the cameras in the order given or, if that path is much longer, from each camera to the nearest one left.
fn ordered(photographed: &[Camera], radius: f64) -> Vec<Camera> {
    let length = |along: &[Camera]| places(along, radius).pop().unwrap_or(0.0);
    let mut left = photographed.to_vec();
    let mut nearest: Vec<Camera> = left.drain(..left.len().min(1)).collect();
    while let Some(from) = nearest.last().filter(|_| !left.is_empty()) {
        let distance = |camera: &Camera| distance(from, camera, radius);
        let next = (0..left.len()).min_by(|&a, &b| distance(&left[a]).total_cmp(&distance(&left[b])));
        nearest.push(left.remove(next.unwrap_or(0)));
    }
    if length(photographed) > DETOUR * length(&nearest) { nearest } else { photographed.to_vec() }
}

/// Returns the mean of the cameras around `at`, with Gaussian weights: of their positions, viewing directions and up directions.
fn smoothed(along: &[Camera], places: &[f64], at: f64, spread: f64) -> Camera {
    let away = |i: usize| ((places[i] - at) / spread).powi(2);
    let nearest = (0..along.len()).min_by(|&a, &b| away(a).total_cmp(&away(b))).unwrap_or(0);
    let (mut origin, mut back, mut up, mut sum) = (DVec3::ZERO, DVec3::ZERO, DVec3::ZERO, 0.0);
    for (i, camera) in along.iter().enumerate() {
        // Relative to the nearest camera, so that at least one weight is not 0 at a position far from all cameras.
        let weight = (0.5 * (away(nearest) - away(i))).exp();
        origin += weight * camera.origin;
        back += weight * camera.rotation.z_axis;
        up += weight * camera.rotation.y_axis;
        sum += weight;
    }
    let right = up.cross(back) / (sum * sum);
    if right.length() < NO_LOOK {
        return Camera { origin: origin / sum, ..along[nearest] };
    }
    let (right, back) = (right.normalize(), back.normalize());
    Camera {
        origin: origin / sum,
        rotation: DMat3::from_cols(right, back.cross(right), back),
        ..along[nearest]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use trimip_core::geometry::lens::Lens;

    fn intrinsics() -> Intrinsics {
        let lens = Lens::perspective([0.1, 0.0, 0.0, 0.0], [0.0; 2], [0.0; 3]);
        Intrinsics { lens, ..Intrinsics::from_angle(40, 30, 0.7) }
    }

    /// Returns a camera on a circle of radius 4 that looks at its centre.
    fn on_circle(angle: f64) -> Camera {
        let eye = 4.0 * DVec3::new(angle.cos(), angle.sin(), 0.25);
        Camera::look_at(intrinsics(), eye, DVec3::ZERO, DVec3::Z)
    }

    fn is_rigid(camera: &Camera) -> bool {
        let r = camera.rotation;
        (r.transpose() * r - DMat3::IDENTITY).to_cols_array().iter().all(|e| e.abs() < 1e-12)
            && (r.determinant() - 1.0).abs() < 1e-12
    }

    #[test]
    fn a_film_of_an_arc_goes_along_it_and_looks_at_its_centre() {
        let photographed: Vec<Camera> = (0..24).map(|i| on_circle(0.05 * f64::from(i))).collect();
        let film = cameras(&photographed, 100, 4.0).unwrap();
        assert_eq!((film.len(), film[0].0.as_str(), film[99].0.as_str()), (100, "0000", "0099"));
        for (_, camera) in &film {
            let towards = -camera.rotation.z_axis.dot(camera.origin.normalize());
            assert!(is_rigid(camera) && towards < -0.9999, "{camera:?}");
            assert!((camera.origin.length() / on_circle(0.0).origin.length() - 1.0).abs() < 0.01);
            assert_eq!(camera.intrinsics.lens, Default::default());
        }
        // The steps are even, except at the ends, where the mean is one-sided.
        let steps: Vec<f64> = film.windows(2).map(|w| (w[1].1.origin - w[0].1.origin).length()).collect();
        let inner = &steps[12..87];
        let (least, most) = inner.iter().fold((f64::MAX, 0.0_f64), |(a, b), &s| (a.min(s), b.max(s)));
        assert!(most < 1.02 * least, "steps of {least} to {most}");
    }

    #[test]
    fn a_film_stays_where_photographs_were() {
        // Two arcs of cameras with a gap between them, in one sequence: the film is within their hull, and always near one of them.
        let angles = (0..12).chain(30..42).map(|i| 0.05 * f64::from(i));
        let photographed: Vec<Camera> = angles.map(on_circle).collect();
        let gap = (photographed[12].origin - photographed[11].origin).length();
        for (_, camera) in cameras(&photographed, 60, 4.0).unwrap() {
            let away =
                photographed.iter().map(|c| (c.origin - camera.origin).length()).fold(f64::MAX, f64::min);
            assert!(away <= 0.5 * gap, "{away} from the nearest photograph, gap {gap}");
            for i in 0..64 {
                let side = DVec3::new(f64::from(i).cos(), f64::from(i).sin(), 0.1 * f64::from(i % 7));
                let reach = |c: &Camera| c.origin.dot(side);
                let most = photographed.iter().map(reach).fold(f64::MIN, f64::max);
                assert!(reach(&camera) <= most + 1e-9, "outside of the hull of the cameras");
            }
        }
    }

    #[test]
    fn photographs_in_no_order_are_followed_by_their_nearest() {
        let shuffled: Vec<Camera> = (0..24).map(|i| on_circle(0.05 * f64::from(i * 7 % 24))).collect();
        let along = ordered(&shuffled, 4.0);
        let angles: Vec<f64> = along.iter().map(|c| c.origin.y.atan2(c.origin.x)).collect();
        assert!(angles.is_sorted(), "{angles:?}");
    }

    #[test]
    fn cameras_at_one_place_make_no_film() {
        let error = cameras(&[on_circle(0.0); 3], 10, 4.0).unwrap_err();
        assert_eq!(error.kind(), trimip_core::ErrorKind::Input);
        assert!(error.message().contains("turntable"), "{error}");
        assert!(cameras(&[], 10, 4.0).is_err());
        // A camera that turns without moving makes a film.
        let turned =
            Camera { rotation: DMat3::from_rotation_z(0.2) * on_circle(0.0).rotation, ..on_circle(0.0) };
        let film = cameras(&[on_circle(0.0), turned], 3, 4.0).unwrap();
        assert!(film[0].1.rotation != film[2].1.rotation && film[0].1.origin == film[2].1.origin);
    }

    proptest! {
        /// For any cameras, including opposite ones, every picture of the film has a rigid pose among the cameras.
        #[test]
        fn every_film_has_rigid_cameras_among_the_photographed(
            placed in prop::collection::vec((prop::array::uniform3(-5.0..5.0), 0.0..6.0, -1.5..1.5), 2..12),
            count in 1..20_u32,
        ) {
            let photographed: Vec<Camera> = placed.iter().map(|&(origin, turn, tilt): &([f64; 3], f64, f64)| {
                let rotation = DMat3::from_rotation_z(turn) * DMat3::from_rotation_x(tilt);
                Camera { intrinsics: intrinsics(), rotation, origin: DVec3::from(origin) }
            }).collect();
            let farthest = photographed.iter().map(|c| c.origin.length()).fold(0.0, f64::max);
            let film = cameras(&photographed, count, 1.0).unwrap();
            prop_assert_eq!(film.len(), count as usize);
            prop_assert!(film.iter().all(|(_, c)| is_rigid(c) && c.origin.length() <= farthest + 1e-9));
        }
    }
}
