//! Fisheye images: rays meet at one point. The distance of a ray's image from the principal point, in focal lengths, is the
//! ray's angle to the optical axis, changed by the distortion of the lens.

use super::perspective::{lens_ball, undistorted};
use super::{BallImage, Colmap, Definition, LocalRay, Model, Projection, plain};
use crate::Intrinsics;
use crate::geometry::camera::LocalCone;
use crate::geometry::lens::Unbent;
use crate::math::scalar::Real;
use glam::DVec3;

/// OpenCV's fisheye, and COLMAP's with a thin prism.
pub struct Fisheye;

/// Angle to the axis, radians, below which sin(angle)/angle is taken as 1.
const NARROW: f64 = 1e-3;

impl Projection for Fisheye {
    const DEFINITION: Definition = Definition {
        name: "fisheye",
        file_names: &[
            "OPENCV_FISHEYE",
            "THIN_PRISM_FISHEYE",
            "SIMPLE_RADIAL_FISHEYE",
            "RADIAL_FISHEYE",
            "FISHEYE",
            "SIMPLE_FISHEYE",
        ],
        flags: &["is_fisheye"],
        colmap: &[
            Colmap {
                number: 5,
                name: "OPENCV_FISHEYE",
                parameters: &["fx", "fy", "cx", "cy", "k1", "k2", "k3", "k4"],
            },
            Colmap { number: 8, name: "SIMPLE_RADIAL_FISHEYE", parameters: &["f", "cx", "cy", "k1"] },
            Colmap { number: 9, name: "RADIAL_FISHEYE", parameters: &["f", "cx", "cy", "k1", "k2"] },
            Colmap {
                number: 10,
                name: "THIN_PRISM_FISHEYE",
                parameters: &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "sx1", "sy1"],
            },
            Colmap { number: 14, name: "SIMPLE_FISHEYE", parameters: &["f", "cx", "cy"] },
            Colmap { number: 15, name: "FISHEYE", parameters: &["fx", "fy", "cx", "cy"] },
        ],
        distorted: true,
        angles: true,
        extent_key: None,
        focal: None,
        directed: true,
    };

    fn example(width: u32, height: u32) -> Intrinsics {
        plain(Model::Fisheye, [width, height], [0.8 * f64::from(width.min(height)); 2])
    }

    fn ray<R: Real>(k: &Intrinsics, at: [R; 2]) -> Option<LocalRay<R>> {
        let ([x, y], by) = undistorted(k, at)?;
        let (zero, angle) = (R::zero(), x.hypot(y));
        let (sine, cosine) = angle.sin_cos();
        let wide = angle > R::from_f64(NARROW);
        let narrower = if wide { sine / angle } else { R::one() };
        // The derivative of sin(angle)/angle with respect to the angle, divided by the angle; −1/3 on the axis.
        let bend = if wide { (cosine - narrower) / (angle * angle) } else { R::from_f64(-1.0 / 3.0) };
        let change = |[by_x, by_y]: [R; 2]| {
            let turned = (x * by_x + y * by_y) * bend;
            [narrower * by_x + x * turned, -(narrower * by_y + y * turned), narrower * (x * by_x + y * by_y)]
        };
        Some(LocalRay {
            origin: [zero; 3],
            direction: [x * narrower, -y * narrower, -cosine],
            origin_by: [[zero; 3]; 2],
            direction_by: by.map(change),
            cosine,
        })
    }

    /// Returns the cone that has the solid angle of this part of the image.
    #[inline]
    fn cone<R: Real>(k: &Intrinsics, at: [R; 2], side: R) -> LocalCone<R> {
        let disc = k.disc(side);
        let Some(Unbent { at: [x, y], area }) = k.lens.unbend(k.normalised(at)) else {
            return LocalCone::none();
        };
        let disc = disc / area.sqrt();
        let angle = x.hypot(y);
        let (sine, cosine) = angle.sin_cos();
        // Circles around the axis are shorter on the sphere of directions than on the plane of angles.
        let narrower = if angle > R::from_f64(NARROW) { sine / angle } else { R::one() };
        LocalCone {
            origin: [R::zero(); 3],
            axis: [x * narrower, -y * narrower, -cosine],
            inverse_length: R::one(),
            radius: R::zero(),
            slope: disc * narrower.sqrt(),
            cosine,
        }
    }

    fn image_of(k: &Intrinsics, point: DVec3) -> Option<[f64; 2]> {
        let (x, y, ahead) = (point.x, -point.y, -point.z);
        let across = x.hypot(y);
        let angle = across.atan2(ahead);
        if !(angle < k.lens.domain()) {
            return None;
        }
        let fraction = if across > 0.0 { angle / across } else { 0.0 };
        let [u, v] = k.lens.bend([x * fraction, y * fraction]).0;
        Some([k.cx + k.fx * u, k.cy + k.fy * v])
    }

    fn ball(k: &Intrinsics, centre: DVec3, radius: f64) -> BallImage {
        lens_ball(k, centre, radius)
    }
}
