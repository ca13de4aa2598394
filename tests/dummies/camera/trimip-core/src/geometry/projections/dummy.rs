//! Cylindrical panoramas: columns are angles around the camera's y axis, rows are heights on the cylinder of radius 1 around that axis.
//! Focal lengths are pixels per radian and per unit of height. The principal point looks along −z.

use super::{BallImage, Definition, LocalRay, Model, Projection, plain};
use crate::Intrinsics;
use crate::math::scalar::Real;
use glam::DVec3;
use std::f64::consts::PI;

/// The camera model of cylindrical panoramas.
pub struct Dummy;

impl Projection for Dummy {
    const DEFINITION: Definition = Definition {
        name: "dummy",
        file_names: &["DUMMY"],
        flags: &[],
        colmap: &[],
        distorted: false,
        angles: false,
        extent_key: None,
        focal: Some(|width, _| [0.5 * width / PI; 2]),
        directed: false,
    };

    fn example(width: u32, height: u32) -> Intrinsics {
        plain(Model::Dummy, [width, height], [0.8 * f64::from(width.min(height)); 2])
    }

    /// The cosine is 1, so depth is distance along the ray: half of a panorama lies behind the plane of the camera.
    fn ray<R: Real>(k: &Intrinsics, at: [R; 2]) -> Option<LocalRay<R>> {
        let (zero, one) = (R::zero(), R::one());
        let [angle, y] = k.normalised(at);
        if !(angle.abs() <= R::from_f64(PI)) {
            return None;
        }
        let (height, (sine, cosine)) = (-y, angle.sin_cos());
        let across = (one + height * height).sqrt().recip();
        let [by_x, by_y] = [k.fx, k.fy].map(|focal| R::from_f64(focal).recip());
        let (by_angle, by_height) = (by_x * across, -by_y * across * across * across);
        Some(LocalRay {
            origin: [zero; 3],
            direction: [sine * across, height * across, -(cosine * across)],
            origin_by: [[zero; 3]; 2],
            direction_by: [
                [by_angle * cosine, zero, by_angle * sine],
                [-(by_height * height * sine), by_height, by_height * height * cosine],
            ],
            cosine: one,
        })
    }

    fn image_of(k: &Intrinsics, point: DVec3) -> Option<[f64; 2]> {
        let across = point.x.hypot(point.z);
        let place = [k.cx + k.fx * point.x.atan2(-point.z), k.cy - k.fy * point.y / across];
        (across > 0.0).then_some(place)
    }

    fn ball(k: &Intrinsics, centre: DVec3, radius: f64) -> BallImage {
        let across = centre.x.hypot(centre.z);
        let wide = (radius / across).asin();
        let seam = centre.x.atan2(-centre.z).abs() + wide > PI;
        match Self::image_of(k, centre).filter(|_| across > 2.0 * radius && !seam) {
            Some(at) => {
                let (angle, high) = (centre.y.atan2(across), (radius / centre.length()).asin());
                let reach = [-high, high].map(|by| k.fy * ((angle + by).tan() - angle.tan()).abs());
                BallImage::Within { at, reach: (k.fx * wide).max(reach[0]).max(reach[1]) + 1.0 }
            }
            None => BallImage::Anywhere,
        }
    }

    fn half_angle(_: &Intrinsics) -> f64 {
        PI
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_of_a_whole_turn_fill_a_belt_of_the_sphere() {
        let focal = Dummy::DEFINITION.focal.map(|focal| focal(400.0, 100.0)).unwrap();
        let k = plain(Model::Dummy, [400, 100], focal);
        let solid = |i: u32| {
            let cone = k.cone([f64::from(i % 400) + 0.5, f64::from(i / 400) + 0.5], 1.0);
            PI * cone.slope * cone.slope
        };
        let total: f64 = (0..40_000).map(solid).sum();
        let most = 50.0 / k.fy;
        let belt = 4.0 * PI * most / (1.0 + most * most).sqrt();
        assert!((total / belt - 1.0).abs() < 1e-4, "{total}, not {belt}");
    }
}
