//! Orthographic images: all rays are parallel to the optical axis and begin on the plane of the camera. Focal lengths are pixels per
//! world unit, as in nerfstudio's `ORTHOPHOTO`; Blender's `ortho_scale` is the longer side of the image in world units.

use super::{BallImage, Definition, LocalRay, Model, Projection, plain};
use crate::Intrinsics;
use crate::math::scalar::Real;
use glam::DVec3;

/// The orthographic model, with parallel rays.
pub struct Orthographic;

/// Half angle of the view, radians: the rays are parallel, but directions this close to them count as looked at.
const AROUND: f64 = 0.3;

impl Projection for Orthographic {
    const DEFINITION: Definition = Definition {
        name: "orthographic",
        file_names: &["ORTHOPHOTO", "ORTHOGRAPHIC", "ORTHO"],
        flags: &["orthographic"],
        colmap: &[],
        distorted: false,
        angles: false,
        extent_key: Some("ortho_scale"),
        focal: None,
        directed: true,
    };

    /// Returns intrinsics that show 3 units along the shorter side.
    fn example(width: u32, height: u32) -> Intrinsics {
        plain(Model::Orthographic, [width, height], [f64::from(width.min(height)) / 3.0; 2])
    }

    fn ray<R: Real>(k: &Intrinsics, at: [R; 2]) -> Option<LocalRay<R>> {
        let (zero, one) = (R::zero(), R::one());
        let [x, y] = k.normalised(at);
        let [by_x, by_y] = [k.fx, k.fy].map(|focal| R::from_f64(focal).recip());
        Some(LocalRay {
            origin: [x, -y, zero],
            direction: [zero, zero, -one],
            origin_by: [[by_x, zero, zero], [zero, -by_y, zero]],
            direction_by: [[zero; 3]; 2],
            cosine: one,
        })
    }

    fn image_of(k: &Intrinsics, point: DVec3) -> Option<[f64; 2]> {
        (point.z < 0.0).then_some([k.cx + k.fx * point.x, k.cy - k.fy * point.y])
    }

    fn ball(k: &Intrinsics, centre: DVec3, radius: f64) -> BallImage {
        if centre.z > radius {
            return BallImage::None;
        }
        let at = [k.cx + k.fx * centre.x, k.cy - k.fy * centre.y];
        BallImage::Within { at, reach: k.fx.max(k.fy) * radius + 1.0 }
    }

    fn footprint(k: &Intrinsics, _: f64) -> f64 {
        (k.fx * k.fy).sqrt().recip()
    }

    fn scale(k: &Intrinsics, _: f64) -> f64 {
        (f64::from(k.width) / k.fx).max(f64::from(k.height) / k.fy)
    }

    fn half_angle(_: &Intrinsics) -> f64 {
        AROUND
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Aabb, Camera, Cone};

    /// Returns a camera that sees 3 × 3 units around the origin from a distance.
    fn camera(distance: f64) -> Camera {
        let eye = distance * DVec3::new(0.48, -0.64, 0.6);
        Camera::look_at(Orthographic::example(300, 300), eye, DVec3::ZERO, DVec3::Z)
    }

    #[test]
    fn a_ball_has_its_radius_in_the_picture_from_any_distance() {
        const RADIUS: f64 = 0.7;
        for distance in [2.0, 50.0] {
            let camera = camera(distance);
            let hits = |cone: Cone<f64>| {
                let (from, along) = (DVec3::from(cone.origin), DVec3::from(cone.direction));
                (from - along * from.dot(along)).length() < RADIUS
            };
            let count = (0..90_000).filter(|i| hits(camera.cone(i % 300, i / 300))).count();
            // 100 pixels a unit: the disc has π·70² pixels.
            let expected = std::f64::consts::PI * 4900.0;
            assert!((count as f64 / expected - 1.0).abs() < 0.01, "{count}, not {expected}");
        }
    }

    #[test]
    fn cones_are_cylinders_of_the_area_of_a_pixel() {
        let camera = camera(5.0);
        for (x, y) in [(0, 0), (150, 150), (299, 12)] {
            let cone: Cone<f64> = camera.cone(x, y);
            assert_eq!((cone.slope, cone.cosine), (0.0, 1.0));
            for t in [0.0, 1.0, 100.0] {
                let area = std::f64::consts::PI * cone.radius_at(t).powi(2);
                assert!((area * 1e4 - 1.0).abs() < 1e-12, "{area}");
            }
        }
    }

    #[test]
    fn pixels_are_as_wide_at_any_distance() {
        let aabb = Aabb { min: [-1.0; 3], max: [1.0; 3] };
        for distance in [0.5, 5.0, 500.0] {
            let width = crate::scene::cones::footprint(&camera(distance), &aabb);
            assert!((width - 0.01).abs() < 1e-12, "{width}");
            assert!((camera(distance).intrinsics.scale(distance) - 3.0).abs() < 1e-12);
        }
    }
}
