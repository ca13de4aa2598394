//! Local origin of the program's coordinates. Poses in map or earth-centred coordinates lie up to 6e6 units from zero, where f32 has
//! steps of half a unit. Such scenes have a [`LocalOrigin`]: it is subtracted in f64 from all coordinates in the data and the
//! settings before they become f32, and added again to everything that is written in the coordinates of the data.

use super::strays::without_strays;
use crate::config::{Crop, PhotographsConfig};
use crate::{Aabb, Camera};
use glam::DVec3;

/// A scene is far from zero if its distance from zero exceeds this many times the extent of its cameras. At that distance,
/// f32 rounds by up to 3e-5 of the extent: about a thirtieth of a pixel, if 1,000 pixels show the extent.
const FAR: f64 = 1e3;

/// Origin of the program's coordinates, in the coordinates of the data: `local = stated - origin`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LocalOrigin(DVec3);

/// An object that has a place in the world.
pub trait Placed {
    /// Returns the object moved by a vector.
    #[must_use]
    fn moved(self, by: DVec3) -> Self;
}

impl LocalOrigin {
    /// Returns the origin of a configuration (`data.origin`); an empty list is zero.
    pub fn of(data: &PhotographsConfig) -> Self {
        Self::at(&data.origin)
    }

    /// Returns the origin at `numbers`, x, y and z in world units of the data; zero unless there are three.
    pub fn at(numbers: &[f64]) -> Self {
        <[f64; 3]>::try_from(numbers).map_or_else(|_| Self::default(), |numbers| Self(numbers.into()))
    }

    /// Chooses the origin for these cameras. Let `extent` be the diagonal of the box around all cameras except
    /// [strays](without_strays), and `distance` the distance of the box's middle from zero. If `distance > 1000 · extent`, the origin
    /// is this middle, rounded to whole units, or to the power of ten below the extent if the extent is below one unit, so that its
    /// decimal digits are exact. Otherwise the origin is zero.
    pub fn chosen(cameras: &[Camera]) -> Self {
        let near = without_strays(cameras);
        let places = near.iter().map(|camera| camera.origin);
        let Some((low, high)) = places
            .map(|place| (place, place))
            .reduce(|(low, high), (place, _)| (low.min(place), high.max(place)))
        else {
            return Self::default();
        };
        let (middle, extent) = (0.5 * (low + high), (high - low).length());
        if !(extent > 0.0 && middle.is_finite() && middle.length() > FAR * extent) {
            return Self::default();
        }
        let steps = 10_f64.powi((-extent.log10().floor()).clamp(0.0, 300.0) as i32);
        let rounded = (middle * steps).round() / steps;
        // Adding zero turns -0 into 0.
        if rounded.is_finite() { Self(rounded + DVec3::ZERO) } else { Self::default() }
    }

    /// Returns true if the program's coordinates are those of the data.
    pub fn is_zero(self) -> bool {
        self.0 == DVec3::ZERO
    }

    /// Returns the vector that moves local coordinates to those of the data.
    pub fn numbers(self) -> [f64; 3] {
        self.0.to_array()
    }

    /// Converts a place in the coordinates of the data to local coordinates.
    pub fn local<T: Placed>(self, stated: T) -> T {
        if self.is_zero() { stated } else { stated.moved(-self.0) }
    }

    /// Converts a local place to the coordinates of the data.
    pub fn stated<T: Placed>(self, local: T) -> T {
        if self.is_zero() { local } else { local.moved(self.0) }
    }
}

impl std::fmt::Display for LocalOrigin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let [x, y, z] = self.numbers();
        write!(f, "[{x}, {y}, {z}]")
    }
}

impl Placed for DVec3 {
    fn moved(self, by: DVec3) -> Self {
        self + by
    }
}

impl Placed for [f64; 3] {
    fn moved(self, by: DVec3) -> Self {
        (DVec3::from(self) + by).to_array()
    }
}

impl Placed for Camera {
    fn moved(self, by: DVec3) -> Self {
        Self { origin: self.origin + by, ..self }
    }
}

impl Placed for Aabb<f64> {
    fn moved(self, by: DVec3) -> Self {
        Self { min: self.min.moved(by), max: self.max.moved(by) }
    }
}

impl Placed for Crop {
    fn moved(self, by: DVec3) -> Self {
        match self {
            Self::None => Self::None,
            Self::Box { min, max } => Self::Box { min: min.moved(by), max: max.moved(by) },
            Self::Ball { centre, radius } => Self::Ball { centre: centre.moved(by), radius },
            Self::Half { point, normal } => Self::Half { point: point.moved(by), normal },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Intrinsics;

    /// Returns cameras on a circle around `centre`.
    fn ring(centre: DVec3, radius: f64) -> Vec<Camera> {
        let k = Intrinsics::from_angle(64, 64, 0.7);
        let at = |i: u32| {
            let turn = f64::from(i) * 0.4;
            let origin = centre + radius * DVec3::new(turn.cos(), turn.sin(), 0.3);
            Camera::look_at(k, origin, centre, DVec3::Z)
        };
        (0..16).map(at).collect()
    }

    #[test]
    fn only_scenes_that_f32_cannot_hold_have_an_origin_of_their_own() {
        let chosen = |centre: DVec3, radius| LocalOrigin::chosen(&ring(centre, radius)).numbers();
        // The diagonal of the box around the circle is about 2.8 radii.
        let far = DVec3::new(448_260.4, 5_411_932.2, 310.0);
        assert_eq!(chosen(far, 2.8), [448_260.0, 5_411_932.0, 311.0]);
        for near in [DVec3::ZERO, DVec3::new(500.0, -200.0, 70.0), DVec3::new(0.0, 0.0, 2700.0)] {
            assert_eq!(chosen(near, 1.0), [0.0; 3], "{near}");
        }
        assert_eq!(chosen(DVec3::new(0.0, 0.0, 2900.0), 1.0), [0.0, 0.0, 2900.0]);
        // A scene of a few metres whose unit is the kilometre.
        let kilometres = chosen(far / 1000.0, 0.0028);
        assert_eq!(kilometres, [448.260, 5411.932, 0.311]);
        assert_eq!(LocalOrigin::at(&kilometres).to_string(), "[448.26, 5411.932, 0.311]");
    }

    #[test]
    fn a_stray_camera_and_cameras_without_extent_choose_nothing() {
        let far = DVec3::new(4_075_539.5, 931_735.3, 4_801_629.4);
        let mut cameras = ring(far, 2.8);
        let usual = LocalOrigin::chosen(&cameras);
        cameras[5].origin = DVec3::ZERO;
        let with_stray = LocalOrigin::chosen(&cameras);
        let apart = DVec3::from(usual.numbers()) - DVec3::from(with_stray.numbers());
        assert!(!usual.is_zero() && apart.length() < 2.0, "{usual} {with_stray}");
        assert!(LocalOrigin::chosen(&cameras[..1]).is_zero() && LocalOrigin::chosen(&[]).is_zero());
        // A near scene keeps its coordinates, however far away one camera lies.
        let mut near = ring(DVec3::ZERO, 2.8);
        near[5].origin = far;
        assert!(LocalOrigin::chosen(&near).is_zero());
    }

    #[test]
    fn what_is_moved_there_comes_back() {
        let origin = LocalOrigin::at(&[4_075_539.0, 931_735.0, -4_801_629.0]);
        for camera in ring(DVec3::new(0.3, -0.2, 0.1), 2.8) {
            let back = origin.local(origin.stated(camera));
            assert!((back.origin - camera.origin).length() < 2e-9 && back.rotation == camera.rotation);
        }
        let crop: Crop = "ball 4075540,931735.5,-4801629,2".parse().unwrap();
        assert_eq!(origin.local(crop).to_string(), "ball 1,0.5,0,2");
        assert_eq!(origin.stated(origin.local(crop)), crop);
        let minus = [-0.0, 1.0, 2.0];
        assert_eq!(LocalOrigin::default().stated(minus)[0].to_bits(), (-0.0_f64).to_bits());
        assert_eq!(LocalOrigin::at(&[]), LocalOrigin::default());
    }
}
