//! Cameras and the cones of their pixels. OpenGL axes: x right, y up, the camera looks along −z. Pixel (0, 0) is the
//! upper left one; its centre lies at (0.5, 0.5). A camera model is a [`Projection`], in f32 and f64, with a twin in
//! WGSL; the present one is the pinhole.

use crate::scalar::Real;
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// Image size and pinhole projection, in pixels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Intrinsics {
    /// Width of the image.
    pub width: u32,
    /// Height of the image.
    pub height: u32,
    /// Focal length along x.
    pub fx: f64,
    /// Focal length along y.
    pub fy: f64,
    /// Principal point, x.
    pub cx: f64,
    /// Principal point, y.
    pub cy: f64,
}

impl Intrinsics {
    /// Square pixels and a centred principal point; `angle_x` is the horizontal field of view in radians.
    pub fn from_angle(width: u32, height: u32, angle_x: f64) -> Self {
        let focal = 0.5 * f64::from(width) / (0.5 * angle_x).tan();
        Self { width, height, fx: focal, fy: focal, cx: 0.5 * f64::from(width), cy: 0.5 * f64::from(height) }
    }

    /// The same view with pixels `2^level` times larger. Rows and columns that do not fill a 2×2 block are cropped,
    /// which leaves the geometry of the other pixels exact.
    pub fn reduced(&self, level: u32) -> Self {
        let scale = f64::from(1_u32 << level);
        Self {
            width: self.width >> level,
            height: self.height >> level,
            fx: self.fx / scale,
            fy: self.fy / scale,
            cx: self.cx / scale,
            cy: self.cy / scale,
        }
    }
}

/// Intrinsics and pose.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Image size and projection.
    pub intrinsics: Intrinsics,
    /// Camera-to-world rotation; its columns are the camera's axes in the world.
    pub rotation: DMat3,
    /// Centre of projection in the world.
    pub origin: DVec3,
}

/// The cone of one pixel: apex, unit axis, and the terms of Eq. 3.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone<R> {
    /// Apex: the centre of projection, world units.
    pub origin: [R; 3],
    /// Unit direction of the axis, through the pixel's centre.
    pub direction: [R; 3],
    /// Radius of the inscribed sphere per unit of distance along the axis (Eq. 3).
    pub slope: R,
    /// Cosine of the angle between axis and optical axis; depth = distance · cosine.
    pub cosine: R,
}

/// A camera model: maps a position in the image to a cone in the camera's axes.
pub trait Projection {
    /// The cone of a square part of a pixel, given its centre `at` and its `side`, both in pixels.
    fn cone<R: Real>(&self, at: [R; 2], side: R) -> LocalCone<R>;
}

/// A cone in its camera's axes, with its apex at the origin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalCone<R> {
    /// Direction of the axis, of any length.
    pub axis: [R; 3],
    /// One over the length of `axis`.
    pub inverse_length: R,
    /// Radius of the inscribed sphere per unit of distance along the axis (Eq. 3).
    pub slope: R,
    /// Cosine of the angle between axis and optical axis.
    pub cosine: R,
}

impl Projection for Intrinsics {
    /// The disc of the part, on the plane at distance 1, has radius side · sqrt(Δx·Δy/π) with Δx = 1/fx, Δy = 1/fy.
    /// The tangent of the angle to the optical axis is computed from the pixel's position: derived from the cosine in
    /// f32, it would lose 8.5 % of its value near the centre of an 800-pixel image.
    #[inline]
    fn cone<R: Real>(&self, at: [R; 2], side: R) -> LocalCone<R> {
        let real = |value: f64| R::from_f64(value);
        let u = (at[0] - real(self.cx)) / real(self.fx);
        let v = -(at[1] - real(self.cy)) / real(self.fy);
        let tangent = (u * u + v * v).sqrt();
        let cosine = (R::one() + tangent * tangent).sqrt().recip();
        let disc = side * real((std::f64::consts::PI * self.fx * self.fy).sqrt().recip());
        LocalCone {
            axis: [u, v, -R::one()],
            inverse_length: cosine,
            slope: sphere_slope(disc, tangent, cosine),
            cosine,
        }
    }
}

impl Camera {
    /// A camera at `origin` that looks at `target`; `up` points upwards in the image.
    pub fn look_at(intrinsics: Intrinsics, origin: DVec3, target: DVec3, up: DVec3) -> Self {
        let back = (origin - target).normalize();
        let right = up.cross(back).normalize();
        Self { intrinsics, rotation: DMat3::from_cols(right, back.cross(right), back), origin }
    }

    /// The cone through the centre of pixel (`x`, `y`).
    #[inline]
    pub fn cone<R: Real>(&self, x: u32, y: u32) -> Cone<R> {
        self.cone_in(x, y, 0, 1)
    }

    /// Cone number `index`, row by row, of the `side` × `side` parts of pixel (`x`, `y`).
    #[inline]
    pub fn cone_in<R: Real>(&self, x: u32, y: u32, index: u32, side: u32) -> Cone<R> {
        let part = R::from_u32(side).recip();
        let place = |pixel: u32, i: u32| R::from_u32(pixel) + (R::from_u32(i) + R::from_f64(0.5)) * part;
        self.cone_at([place(x, index % side), place(y, index / side)], part)
    }

    /// The cone of a square part of a pixel, given its centre `at` and its `side`, both in pixels.
    #[inline]
    pub fn cone_at<R: Real>(&self, at: [R; 2], side: R) -> Cone<R> {
        let LocalCone { axis, inverse_length, slope, cosine } = self.intrinsics.cone(at, side);
        let real = |value: f64| R::from_f64(value);
        let axes = self.rotation.to_cols_array_2d();
        let direction = std::array::from_fn(|i| {
            let along = |axis: usize| real(axes[axis][i]);
            (along(0) * axis[0] + along(1) * axis[1] + along(2) * axis[2]) * inverse_length
        });
        let origin = [real(self.origin.x), real(self.origin.y), real(self.origin.z)];
        Cone { origin, direction, slope, cosine }
    }
}

/// Radius of the sphere inscribed in a cone per unit of distance along its axis (Eq. 3 with f = 1):
/// ṙ·cosθ / sqrt((tanθ − ṙ)² + 1), for disc radius ṙ and angle θ to the optical axis.
pub fn sphere_slope<R: Real>(disc_radius: R, tangent: R, cosine: R) -> R {
    let inner = tangent - disc_radius;
    disc_radius * cosine / (inner * inner + R::one()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Eq. 3 as printed: r = ‖x−o‖·f·ṙ / (‖d‖·sqrt((sqrt(‖d‖²−f²) − ṙ)² + f²)), with d un-normalised to the image
    /// plane.
    fn equation_3(distance: f64, f: f64, disc: f64, d: f64) -> f64 {
        distance * f * disc / (d * (((d * d - f * f).max(0.0).sqrt() - disc).powi(2) + f * f).sqrt())
    }

    #[test]
    fn slope_is_equation_3_all_over_the_image() {
        let camera = Camera {
            intrinsics: Intrinsics::from_angle(800, 800, 0.691_111_2),
            rotation: DMat3::IDENTITY,
            origin: DVec3::ZERO,
        };
        let k = camera.intrinsics;
        let disc = (1.0 / (k.fx * k.fy * std::f64::consts::PI)).sqrt();
        for (x, y) in [(0, 0), (400, 400), (399, 400), (799, 0), (123, 677), (400, 0)] {
            let (u, v) = ((f64::from(x) + 0.5 - k.cx) / k.fx, (f64::from(y) + 0.5 - k.cy) / k.fy);
            let expected = equation_3(4.0, 1.0, disc, (u * u + v * v + 1.0).sqrt());
            let wide: Cone<f64> = camera.cone(x, y);
            let narrow: Cone<f32> = camera.cone(x, y);
            assert!((4.0 * wide.slope / expected - 1.0).abs() < 1e-9, "{x} {y}");
            assert!((4.0 * f64::from(narrow.slope) / expected - 1.0).abs() < 1e-6, "{x} {y}");
        }
    }

    #[test]
    fn spheres_are_tangent_to_the_inner_edge_of_the_disc() {
        // The line from the apex to the point of the disc nearest the optical axis is tangent to the sphere of Eq. 3:
        // its distance to the sphere's centre is the radius.
        for tangent in [0.0_f64, 0.01, 0.3, 2.0] {
            let disc = 4e-3;
            let cosine = (1.0 + tangent * tangent).sqrt().recip();
            let centre = [tangent * cosine * 5.0, cosine * 5.0];
            let edge = [tangent - disc, 1.0];
            let length = (edge[0] * edge[0] + edge[1] * edge[1]).sqrt();
            let distance = (centre[0] * edge[1] - centre[1] * edge[0]).abs() / length;
            let radius = 5.0 * sphere_slope(disc, tangent, cosine);
            assert!((distance / radius - 1.0).abs() < 1e-9, "{tangent}: {distance} {radius}");
        }
    }

    #[test]
    fn reduced_pixels_cover_their_block() {
        let k = Intrinsics { width: 13, height: 8, fx: 20.0, fy: 18.0, cx: 6.1, cy: 4.2 };
        let camera = |intrinsics| Camera { intrinsics, rotation: DMat3::IDENTITY, origin: DVec3::ZERO };
        let plane = |camera: Camera, x, y| {
            let cone: Cone<f64> = camera.cone(x, y);
            [cone.direction[0] / -cone.direction[2], cone.direction[1] / -cone.direction[2]]
        };
        let coarse = plane(camera(k.reduced(1)), 2, 1);
        let fine = [(4, 2), (5, 2), (4, 3), (5, 3)].map(|(x, y)| plane(camera(k), x, y));
        for axis in 0..2 {
            let mean = fine.iter().map(|p| p[axis]).sum::<f64>() / 4.0;
            assert!((mean - coarse[axis]).abs() < 1e-12);
        }
        assert_eq!((k.reduced(1).width, k.reduced(1).height), (6, 4));
    }

    #[test]
    fn parts_of_a_pixel_are_the_pixels_of_a_finer_camera() {
        // The 2×2 parts of a pixel are four pixels of a camera of twice the resolution.
        let fine = Intrinsics { width: 26, height: 16, fx: 40.0, fy: 36.0, cx: 12.2, cy: 8.4 };
        let camera = |intrinsics| Camera { intrinsics, rotation: DMat3::IDENTITY, origin: DVec3::ONE };
        for index in 0..4 {
            let part: Cone<f64> = camera(fine.reduced(1)).cone_in(7, 3, index, 2);
            let whole: Cone<f64> = camera(fine).cone(14 + index % 2, 6 + index / 2);
            let apart = (DVec3::from(part.direction) - DVec3::from(whole.direction)).length();
            assert!(apart < 1e-15 && (part.slope / whole.slope - 1.0).abs() < 1e-12, "{index}: {apart}");
        }
    }

    #[test]
    fn look_at_sees_its_target_in_the_centre() {
        let camera = Camera::look_at(
            Intrinsics { width: 1, height: 1, fx: 1.0, fy: 1.0, cx: 0.5, cy: 0.5 },
            DVec3::new(1.0, -4.0, 2.0),
            DVec3::new(0.0, 0.5, 0.0),
            DVec3::Z,
        );
        let cone: Cone<f64> = camera.cone(0, 0);
        let expected = (DVec3::new(0.0, 0.5, 0.0) - camera.origin).normalize();
        assert!((DVec3::from(cone.direction) - expected).length() < 1e-12);
        assert!((camera.rotation.determinant() - 1.0).abs() < 1e-12);
    }
}
