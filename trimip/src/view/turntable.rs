//! A circle of cameras around the scene's box, at the distance from which each camera sees the whole box. World units.
//! The names x, y, z are a corner of the box in a camera's axes, relative to the box's centre.

use super::cameras::{Named, aimed};
use glam::{DMat3, DVec3};
use trimip_core::{
    Advice, Error, Intrinsics, Place, Result,
    config::{Contraction, SceneConfig},
};

/// Fraction of the picture, from its centre to a border, that the box may fill.
const FILL: f64 = 0.95;
/// Minimum distance of a fitted camera from the centre, relative to the depth of the corner nearest to the camera.
const CLEARANCE: f64 = 1.05;
/// Maximum distance, in half diagonals of the box. At a greater distance the box is smaller than a pixel of any picture.
const FARTHEST: f64 = 1e9;

/// Camera positions of a turntable. The default is one camera, level with the box's centre, z up.
#[derive(Clone, Copy, Debug)]
pub struct Turntable {
    /// Number of cameras.
    pub count: u32,
    /// Elevation in degrees above the plane through the box's centre.
    pub elevation: f64,
    /// Distance from the box's centre in world units; fitted if `None`.
    pub distance: Option<f64>,
    /// Axis of the circle; also the up direction of the pictures.
    pub up: DVec3,
}

impl Default for Turntable {
    fn default() -> Self {
        Self { count: 1, elevation: 0.0, distance: None, up: DVec3::Z }
    }
}

/// Returns the cameras of a turntable, evenly spaced on a circle. Each looks at the centre of the scene's box.
///
/// # Errors
/// When the elevation, the distance or the axis allows no upright view.
pub fn cameras(scene: &SceneConfig, table: &Turntable, intrinsics: Intrinsics) -> Result<Vec<Named>> {
    let (centre, half) = middle(scene);
    let axis = table.up.normalize_or_zero();
    if axis == DVec3::ZERO {
        return Err(Error::input(
            Place::argument("up", table.up),
            "has no direction",
            "expected x,y,z that are not all 0, such as 0,0,1",
        ));
    }
    // The negated comparison also refuses NaN.
    if !(table.elevation.abs() <= 89.999) {
        return Err(Error::input(
            Place::argument("elevation", table.elevation),
            "has no upright view",
            "expected degrees from -89.999 to 89.999",
        ));
    }
    let first = axis.any_orthonormal_vector();
    let second = axis.cross(first);
    let (sine, cosine) = table.elevation.to_radians().sin_cos();
    let outwards: Vec<DVec3> = (0..table.count)
        .map(|i| {
            let angle = std::f64::consts::TAU * f64::from(i) / f64::from(table.count);
            cosine * (first * angle.cos() + second * angle.sin()) + sine * axis
        })
        .collect();
    let distance = match table.distance {
        Some(given) => within(given, half, Place::argument("distance", given))?,
        // Contracted space is a ball, and the cameras are on a circle of about its radius.
        None if scene.contraction == Contraction::Ball => half.x,
        None => {
            let fitted =
                outwards.iter().map(|&back| fitted(half, back, axis, &intrinsics)).fold(0.0, f64::max);
            within(fitted, half, Place::argument("turntable", format!("at distance {fitted}")))?
        }
    };
    let camera =
        |back: &DVec3| aimed(Place::option("turntable"), centre + distance * *back, centre, axis, intrinsics);
    outwards.iter().enumerate().map(|(i, back)| Ok((format!("{i:04}"), camera(back)?))).collect()
}

/// Returns the centre and half extents of the box around the subject.
pub fn middle(scene: &SceneConfig) -> (DVec3, DVec3) {
    let subject = scene.subject();
    (subject.centre().into(), subject.half().into())
}

fn within(distance: f64, half: DVec3, place: Place) -> Result<f64> {
    if distance > 0.0 && distance <= FARTHEST * half.length() {
        return Ok(distance);
    }
    let expected = format!(
        "expected above 0 and at most {:e}; change {{distance}} or {{fov}}",
        FARTHEST * half.length()
    );
    Err(Error::input(place, "is out of range", Advice::Argument(expected)))
}

/// Returns the minimum distance d along `back` from which all corners of a box with these half extents lie within the
/// picture. A corner at depth d − z projects to x/(d − z)·f from the picture's centre; the same holds for y.
fn fitted(half: DVec3, back: DVec3, up: DVec3, k: &Intrinsics) -> f64 {
    let right = up.cross(back).normalize();
    let to_camera = DMat3::from_cols(right, back.cross(right), back).transpose();
    let reach = |focal: f64, side: u32| 2.0 * focal / (f64::from(side) * FILL);
    let (reach_x, reach_y) = (reach(k.fx, k.width), reach(k.fy, k.height));
    corners(half)
        .map(|corner| {
            let [x, y, z] = (to_camera * corner).to_array();
            (z + (x.abs() * reach_x).max(y.abs() * reach_y)).max(CLEARANCE * z)
        })
        .fold(0.0, f64::max)
}

/// Returns the corners of a box around the origin.
fn corners(half: DVec3) -> impl Iterator<Item = DVec3> {
    (0..8).map(move |i| {
        let sign = |bit: u32| if i >> bit & 1 == 1 { 1.0 } else { -1.0 };
        half * DVec3::new(sign(0), sign(1), sign(2))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn scene(centre: [f32; 3], half: [f32; 3]) -> SceneConfig {
        let side = |sign: f32| std::array::from_fn(|axis| centre[axis] + sign * half[axis]);
        SceneConfig { aabb_min: side(-1.0), aabb_max: side(1.0), ..trimip_core::Config::default().scene }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(1000))]

        #[test]
        fn every_camera_sees_the_whole_box_and_one_sees_little_beside_it(
            centre in prop::array::uniform3(-5.0_f32..5.0),
            half in prop::array::uniform3(0.02_f32..4.0),
            count in 1_u32..12,
            elevation in -89.9..89.9,
            up in prop::array::uniform3(-1.0..1.0),
            (width, height) in (1_u32..2000, 1_u32..2000),
            fov in 1.0_f64..150.0,
        ) {
            let up = DVec3::from(up);
            prop_assume!(up.length() > 0.01);
            let scene = scene(centre, half);
            let (centre, half) = middle(&scene);
            let table = Turntable { count, elevation, distance: None, up };
            let k = Intrinsics::from_angle(width, height, fov.to_radians());
            let (mut fullest, mut kept_away) = (0.0_f64, false);
            for (_, camera) in cameras(&scene, &table, k).unwrap() {
                let distance = camera.origin.distance(centre);
                for corner in corners(half) {
                    let [x, y, z] = (camera.rotation.transpose() * (centre + corner - camera.origin)).to_array();
                    prop_assert!(z < 0.0, "a corner behind the camera");
                    let (x, y) = (k.cx - k.fx * x / z, k.cy + k.fy * y / z);
                    let fractions = [x / f64::from(width), y / f64::from(height)].map(|s| (2.0 * s - 1.0).abs());
                    fullest = fullest.max(fractions[0]).max(fractions[1]);
                    kept_away |= distance <= CLEARANCE * (distance + z) * (1.0 + 1e-9);
                }
            }
            prop_assert!(fullest <= FILL + 1e-6, "{fullest}");
            // The clearance determines the distance only if a corner of the box points at the camera.
            prop_assert!(fullest >= FILL - 1e-6 || kept_away, "{fullest}");
        }
    }

    #[test]
    fn a_cube_seen_along_an_axis_is_fitted_by_its_front() {
        // The half side is 1, so the front face lies 1 in front of the centre. From a distance of 1/FILL to the face,
        // it fills the fraction FILL of a picture of 90 degrees.
        let k = Intrinsics::from_angle(100, 100, std::f64::consts::FRAC_PI_2);
        let table = Turntable { count: 1, elevation: 0.0, distance: None, up: DVec3::Z };
        let found = cameras(&scene([0.0; 3], [1.0; 3]), &table, k).unwrap();
        assert!((found[0].1.origin.length() - (1.0 + 1.0 / FILL)).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn all_look_at_the_centre_from_the_distance_given() {
        let scene = scene([0.0, 0.5, 1.0], [1.0, 1.0, 1.0]);
        let table = |elevation, distance, up| Turntable { count: 5, elevation, distance, up };
        let k = Intrinsics::from_angle(80, 60, 0.7);
        for (_, camera) in cameras(&scene, &table(20.0, Some(1.25), DVec3::Z), k).unwrap() {
            let to_centre = DVec3::new(0.0, 0.5, 1.0) - camera.origin;
            assert!((to_centre.length() - 1.25).abs() < 1e-9);
            assert!((to_centre.normalize() + camera.rotation.z_axis).length() < 1e-9);
        }
        for (table, word) in [
            (table(90.0, None, DVec3::Z), "elevation 90"),
            (table(f64::NAN, None, DVec3::Z), "elevation NaN"),
            (table(0.0, None, DVec3::ZERO), "up "),
            (table(0.0, Some(0.0), DVec3::Z), "distance 0"),
            (table(0.0, Some(f64::NAN), DVec3::Z), "distance NaN"),
            (table(0.0, Some(1e300), DVec3::Z), "distance 1"),
        ] {
            let error = cameras(&scene, &table, k).unwrap_err();
            assert!(
                error.kind() == trimip_core::ErrorKind::Input && error.message().contains(word),
                "{}",
                error.message()
            );
        }
    }
}
