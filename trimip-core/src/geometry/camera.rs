//! Cameras and the cones of their pixels. OpenGL axes: x right, y up, the camera looks along −z. Pixel (0, 0) is the
//! upper left one; its centre lies at (0.5, 0.5). The camera model of a [`Lens`] maps pixels to rays, see
//! [`projections`](crate::geometry::projections).

use crate::geometry::cone_pattern::PixelPattern;
use crate::geometry::lens::Lens;
use crate::math::scalar::Real;
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// Image size, focal lengths and principal point (all in pixels), and the lens. The camera model of the lens defines the
/// meaning of the focal lengths.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
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
    /// The lens; the default is a pinhole.
    #[serde(default, skip_serializing_if = "Lens::is_straight")]
    pub lens: Lens,
}

impl Intrinsics {
    /// Returns intrinsics with square pixels and a centred principal point. `angle_x` is the horizontal field of view in
    /// radians.
    pub fn from_angle(width: u32, height: u32, angle_x: f64) -> Self {
        let focal = 0.5 * f64::from(width) / (0.5 * angle_x).tan();
        let (cx, cy) = (0.5 * f64::from(width), 0.5 * f64::from(height));
        Self { width, height, fx: focal, fy: focal, cx, cy, ..Self::default() }
    }

    /// Returns the intrinsics of the same view with pixels `2^level` times as wide and high. Rows and columns that do not
    /// fill one of these pixels are cropped, so the geometry of the other pixels stays exact.
    pub fn reduced(&self, level: u32) -> Self {
        let scale = f64::from(1_u32 << level);
        Self {
            width: self.width >> level,
            height: self.height >> level,
            fx: self.fx / scale,
            fy: self.fy / scale,
            cx: self.cx / scale,
            cy: self.cy / scale,
            lens: self.lens,
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

impl Camera {
    /// Returns all numbers of the camera: width, height, fx, fy, cx, cy, the camera model, the coefficients of the lens,
    /// the rotation column by column, and the origin. Two cameras are equal if and only if these numbers are equal.
    pub fn numbers(&self) -> Vec<f64> {
        let Intrinsics { width, height, fx, fy, cx, cy, lens } = self.intrinsics;
        let plain = [width.into(), height.into(), fx, fy, cx, cy, f64::from(lens.model as u8)];
        let lens = [&lens.radial[..], &lens.denominator, &lens.tangential, &lens.prism].concat();
        let pose = self.rotation.to_cols_array().into_iter().chain(self.origin.to_array());
        plain.into_iter().chain(lens).chain(pose).collect()
    }
}

/// The cone of one pixel: apex, unit axis, and the terms of Eq. 3. If rays are parallel, the cone is a cylinder.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone<R> {
    /// Apex, world units: the centre of projection or, if rays are parallel, the point where the pixel's ray begins.
    pub origin: [R; 3],
    /// Radius of the sphere at `origin`, world units; 0 if rays are not parallel.
    pub radius: R,
    /// Unit direction of the axis, through the pixel's centre.
    pub direction: [R; 3],
    /// Growth of the inscribed sphere's radius per unit of distance along the axis (Eq. 3).
    pub slope: R,
    /// Cosine of the angle between axis and optical axis; depth = distance · cosine.
    pub cosine: R,
}

impl<R: Real> Cone<R> {
    /// Returns the radius of the inscribed sphere at distance `t` along the axis.
    #[inline]
    pub fn radius_at(&self, t: R) -> R {
        self.radius + self.slope * t
    }

    /// Returns true if the camera has no ray for the pixel.
    #[inline]
    pub fn is_none(&self) -> bool {
        self.slope == R::zero() && self.radius == R::zero()
    }
}

/// A cone in the axes of its camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalCone<R> {
    /// Point where the ray begins: zero, unless rays are parallel.
    pub origin: [R; 3],
    /// Direction of the axis; its length is arbitrary.
    pub axis: [R; 3],
    /// Reciprocal of the length of `axis`.
    pub inverse_length: R,
    /// Radius of the sphere at `origin`; 0 if rays are not parallel.
    pub radius: R,
    /// Growth of the inscribed sphere's radius per unit of distance along the axis (Eq. 3).
    pub slope: R,
    /// Depth divided by distance, for points on the axis: the cosine of the angle to the optical axis, or 1 if the camera
    /// model defines depth as distance.
    pub cosine: R,
}

impl<R: Real> LocalCone<R> {
    /// Returns the cone through a disc of radius `disc` around (x, y), x right and y down, on the plane at distance 1.
    #[inline]
    pub(crate) fn through([x, y]: [R; 2], disc: R) -> Self {
        let v = -y;
        let tangent = (x * x + v * v).sqrt();
        let cosine = (R::one() + tangent * tangent).sqrt().recip();
        Self {
            origin: [R::zero(); 3],
            axis: [x, v, -R::one()],
            inverse_length: cosine,
            radius: R::zero(),
            slope: sphere_slope(disc, tangent, cosine),
            cosine,
        }
    }

    /// Returns the cone of a pixel for which the camera has no ray. It has no direction and meets nothing.
    pub(crate) fn none() -> Self {
        let zero = R::zero();
        Self {
            origin: [zero; 3],
            axis: [zero; 3],
            inverse_length: R::one(),
            radius: zero,
            slope: zero,
            cosine: zero,
        }
    }

    /// Returns true if the camera has no ray for the pixel.
    pub fn is_none(&self) -> bool {
        self.slope == R::zero() && self.radius == R::zero()
    }
}

impl Intrinsics {
    /// Converts a place in the image to the offset from the principal point, in focal lengths: x right, y down.
    #[inline]
    pub(crate) fn normalised<R: Real>(&self, at: [R; 2]) -> [R; 2] {
        let real = |value: f64| R::from_f64(value);
        [(at[0] - real(self.cx)) / real(self.fx), (at[1] - real(self.cy)) / real(self.fy)]
    }

    /// Returns the radius, in focal lengths, of the disc that has the area of a square of `side` pixels.
    #[inline]
    pub(crate) fn disc<R: Real>(&self, side: R) -> R {
        side * R::from_f64((std::f64::consts::PI * self.fx * self.fy).sqrt().recip())
    }

    /// Returns the number of pixels for which the camera has no ray.
    pub fn blind_pixels(&self) -> u64 {
        if self.lens.is_straight() {
            return 0;
        }
        let blind = |x: u32, y: u32| self.cone([f64::from(x) + 0.5, f64::from(y) + 0.5], 1.0).is_none();
        // The domain has no holes: if every border pixel has a ray, every pixel has one.
        let (right, bottom) = (self.width.saturating_sub(1), self.height.saturating_sub(1));
        let border = (0..self.width).any(|x| blind(x, 0) || blind(x, bottom))
            || (0..self.height).any(|y| blind(0, y) || blind(right, y));
        if !border {
            return 0;
        }
        (0..self.height).map(|y| (0..self.width).filter(|&x| blind(x, y)).count() as u64).sum()
    }
}

impl Camera {
    /// Returns true if the image of a point of the world lies within the picture.
    pub fn sees(&self, point: DVec3) -> bool {
        let k = &self.intrinsics;
        let place = k.image_of(self.rotation.transpose() * (point - self.origin));
        place.is_some_and(|[x, y]| {
            (0.0..f64::from(k.width)).contains(&x) && (0.0..f64::from(k.height)).contains(&y)
        })
    }

    /// Returns a camera at `origin` that looks at `target`; `up` points upwards in the image.
    pub fn look_at(intrinsics: Intrinsics, origin: DVec3, target: DVec3, up: DVec3) -> Self {
        let back = (origin - target).normalize();
        let right = up.cross(back).normalize();
        Self { intrinsics, rotation: DMat3::from_cols(right, back.cross(right), back), origin }
    }

    /// Returns the cone through the centre of pixel (`x`, `y`).
    #[inline]
    pub fn cone<R: Real>(&self, x: u32, y: u32) -> Cone<R> {
        self.cone_in(x, y, 0, PixelPattern::WHOLE)
    }

    /// Returns cone number `index` of pixel (`x`, `y`). The cones of a grid are numbered row by row; the quincunx begins
    /// with its centre.
    #[inline]
    pub fn cone_in<R: Real>(&self, x: u32, y: u32, index: u32, pattern: PixelPattern) -> Cone<R> {
        match pattern {
            PixelPattern::Quincunx => {
                // The centre, then the four half-way to the corners.
                let offset = |upper: bool| match (index, upper) {
                    (0, _) => R::from_f64(0.5),
                    (_, false) => R::from_f64(0.25),
                    (_, true) => R::from_f64(0.75),
                };
                let [right, down] = [index == 2 || index == 4, index > 2].map(offset);
                self.cone_at([R::from_u32(x) + right, R::from_u32(y) + down], R::one())
            }
            PixelPattern::Grid(side) => {
                let part = R::from_u32(side).recip();
                let place =
                    |pixel: u32, i: u32| R::from_u32(pixel) + (R::from_u32(i) + R::from_f64(0.5)) * part;
                self.cone_at([place(x, index % side), place(y, index / side)], part)
            }
        }
    }

    /// Returns the cone of a square part of a pixel, given its centre `at` and its `side`, both in pixels.
    #[inline]
    pub fn cone_at<R: Real>(&self, at: [R; 2], side: R) -> Cone<R> {
        let LocalCone { origin: from, axis, inverse_length, radius, slope, cosine } =
            self.intrinsics.cone(at, side);
        let real = |value: f64| R::from_f64(value);
        let axes = self.rotation.to_cols_array_2d();
        let turned = |local: [R; 3]| -> [R; 3] {
            std::array::from_fn(|i| {
                let along = |axis: usize| real(axes[axis][i]);
                along(0) * local[0] + along(1) * local[1] + along(2) * local[2]
            })
        };
        let direction = turned(axis).map(|value| value * inverse_length);
        let mut origin = [real(self.origin.x), real(self.origin.y), real(self.origin.z)];
        if radius > R::zero() {
            let moved = turned(from);
            origin = std::array::from_fn(|i| origin[i] + moved[i]);
        }
        Cone { origin, radius, direction, slope, cosine }
    }
}

/// Upper bound of the distance to the apex divided by the distance to the ray's origin, see [`apex_distance`].
pub const FARTHEST_APEX: f64 = 32.0;

/// Returns the distance from the apex of a cone to the point at distance `t` along its axis; `radius` is the cone's radius at the
/// ray's origin. A cylinder gets an apex far behind its origin: for an interval of length δ around t, the moments of the cone's
/// slice differ from the cylinder's by a fraction of (δ/64t)².
#[inline(always)]
pub fn apex_distance<R: Real>(radius: R, slope: R, t: R) -> R {
    let farthest = R::from_f64(FARTHEST_APEX);
    if radius == R::zero() {
        t
    } else if radius >= (farthest - R::one()) * slope * t {
        farthest * t
    } else {
        t + radius / slope
    }
}

/// Returns the radius of the sphere inscribed in a cone, per unit of distance along the cone's axis (Eq. 3 with f = 1):
/// ṙ·cosθ / sqrt((tanθ − ṙ)² + 1), for disc radius ṙ and angle θ to the optical axis.
pub fn sphere_slope<R: Real>(disc_radius: R, tangent: R, cosine: R) -> R {
    let inner = tangent - disc_radius;
    disc_radius * cosine / (inner * inner + R::one()).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::projections::Model;

    /// Evaluates Eq. 3 as printed: r = ‖x−o‖·f·ṙ / (‖d‖·sqrt((sqrt(‖d‖²−f²) − ṙ)² + f²)), where d is the direction, not
    /// normalised, to the image plane.
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
        // The line from the apex to the point of the disc nearest the optical axis is tangent to the sphere of Eq. 3: the
        // line's distance to the sphere's centre is the radius.
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
        let k = Intrinsics {
            width: 13,
            height: 8,
            fx: 20.0,
            fy: 18.0,
            cx: 6.1,
            cy: 4.2,
            ..Intrinsics::default()
        };
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
        // The 2×2 parts of a pixel are the four pixels of a camera with twice the resolution.
        let fine = Intrinsics {
            width: 26,
            height: 16,
            fx: 40.0,
            fy: 36.0,
            cx: 12.2,
            cy: 8.4,
            ..Intrinsics::default()
        };
        let camera = |intrinsics| Camera { intrinsics, rotation: DMat3::IDENTITY, origin: DVec3::ONE };
        for index in 0..4 {
            let part: Cone<f64> = camera(fine.reduced(1)).cone_in(7, 3, index, PixelPattern::Grid(2));
            let whole: Cone<f64> = camera(fine).cone(14 + index % 2, 6 + index / 2);
            let apart = (DVec3::from(part.direction) - DVec3::from(whole.direction)).length();
            assert!(apart < 1e-15 && (part.slope / whole.slope - 1.0).abs() < 1e-12, "{index}: {apart}");
        }
    }

    #[test]
    fn look_at_sees_its_target_in_the_centre() {
        let camera = Camera::look_at(
            Intrinsics { width: 1, height: 1, fx: 1.0, fy: 1.0, cx: 0.5, cy: 0.5, ..Intrinsics::default() },
            DVec3::new(1.0, -4.0, 2.0),
            DVec3::new(0.0, 0.5, 0.0),
            DVec3::Z,
        );
        let cone: Cone<f64> = camera.cone(0, 0);
        let expected = (DVec3::new(0.0, 0.5, 0.0) - camera.origin).normalize();
        assert!((DVec3::from(cone.direction) - expected).length() < 1e-12);
        assert!((camera.rotation.determinant() - 1.0).abs() < 1e-12);
    }

    /// Returns cameras with a phone's lens, a lens with strong barrel distortion, and a fisheye.
    fn lenses() -> Vec<Camera> {
        let lenses = [
            Lens::perspective([0.0578421, -0.0805099, 0.0, 0.0], [-0.000980296, 0.00015575], [0.0; 3]),
            Lens::perspective([-0.28, 0.07, -0.008, 0.0], [0.001, -0.002], [0.0; 3]),
            Lens::fisheye([-0.02, 0.004, -0.002, 0.0003], [0.0; 2], [0.0; 2]),
        ];
        let camera = |lens| {
            let k = Intrinsics { width: 60, height: 40, fx: 41.0, fy: 40.0, cx: 29.0, cy: 21.0, lens };
            Camera::look_at(k, DVec3::new(1.0, -4.0, 2.0), DVec3::ZERO, DVec3::Z)
        };
        lenses.map(camera).to_vec()
    }

    #[test]
    fn points_on_the_axis_of_a_cone_have_their_image_at_its_pixel() {
        for camera in lenses() {
            for (x, y) in [(0, 0), (30, 20), (59, 39), (7, 33), (45, 2)] {
                let cone: Cone<f64> = camera.cone(x, y);
                let point = 3.7 * DVec3::from(cone.direction);
                let [u, v] = camera.intrinsics.image_of(camera.rotation.transpose() * point).expect("seen");
                assert!((u - 0.5 - f64::from(x)).abs() < 1e-9 && (v - 0.5 - f64::from(y)).abs() < 1e-9);
                assert!((DVec3::from(cone.direction).length() - 1.0).abs() < 1e-12);
                assert!(
                    (cone.cosine + camera.rotation.z_axis.dot(DVec3::from(cone.direction))).abs() < 1e-12
                );
            }
        }
    }

    /// Checks cones against the footprint of their pixels: the solid angle between the axes of a pixel's corners. A
    /// perspective cone's inscribed sphere is smaller than the circle of that solid angle by a factor of √cosθ, because its
    /// disc is seen at a slant.
    #[test]
    fn cones_have_the_size_of_their_pixels() {
        for camera in lenses() {
            for (x, y) in [(0_u32, 0_u32), (30, 20), (59, 39), (7, 33), (45, 2)] {
                let cone: Cone<f64> = camera.cone(x, y);
                let part = 1e-3;
                let corner = |dx: f64, dy: f64| {
                    let at = [f64::from(x) + 0.5 + dx * part, f64::from(y) + 0.5 + dy * part];
                    DVec3::from(camera.cone_at::<f64>(at, part).direction)
                };
                let (a, b) = (corner(0.5, 0.0) - corner(-0.5, 0.0), corner(0.0, 0.5) - corner(0.0, -0.5));
                let solid = a.cross(b).length() / (part * part);
                let slant =
                    if camera.intrinsics.lens.model == Model::Fisheye { 1.0 } else { cone.cosine.sqrt() };
                let expected = (solid / std::f64::consts::PI).sqrt() * slant;
                assert!((cone.slope / expected - 1.0).abs() < 0.03, "{} {expected}", cone.slope);
            }
        }
    }

    #[test]
    fn a_lens_that_bends_nothing_is_a_pinhole_bit_by_bit() {
        let camera = |lens| {
            let k = Intrinsics { width: 60, height: 40, fx: 41.0, fy: 40.0, cx: 29.0, cy: 21.0, lens };
            Camera::look_at(k, DVec3::new(1.0, -4.0, 2.0), DVec3::ZERO, DVec3::Z)
        };
        let straight = camera(Lens::perspective([0.0; 4], [0.0; 2], [0.0; 3]));
        let bent = camera(Lens::perspective([1e-9, 0.0, 0.0, 0.0], [0.0; 2], [0.0; 3]));
        for (x, y) in [(0, 0), (30, 20), (59, 39)] {
            assert_eq!(straight.cone::<f32>(x, y), camera(Lens::default()).cone::<f32>(x, y));
            let (a, b): (Cone<f64>, Cone<f64>) = (straight.cone(x, y), bent.cone(x, y));
            assert!((DVec3::from(a.direction) - DVec3::from(b.direction)).length() < 1e-8);
            assert!((a.slope / b.slope - 1.0).abs() < 1e-8);
        }
    }

    #[test]
    fn pixels_without_a_ray_are_counted_and_have_no_direction() {
        let lens = Lens::perspective([-1.0 / 3.0, 0.0, 0.0, 0.0], [0.0; 2], [0.0; 3]);
        let k = Intrinsics { width: 40, height: 40, fx: 20.0, fy: 20.0, cx: 20.0, cy: 20.0, lens };
        let camera = Camera { intrinsics: k, rotation: DMat3::IDENTITY, origin: DVec3::ZERO };
        let blind = (0..1600).filter(|i| camera.cone::<f32>(i % 40, i / 40).slope == 0.0).count() as u64;
        assert_eq!(blind, k.blind_pixels());
        // The lens has rays up to an image radius of 2/3, which is 13.3 pixels.
        let seen = (1600 - blind) as f64;
        assert!((seen / (std::f64::consts::PI * (20.0_f64 / 1.5).powi(2)) - 1.0).abs() < 0.05, "{seen}");
        assert_eq!(camera.cone::<f32>(0, 0).direction, [0.0; 3]);
        assert_eq!(Intrinsics { lens: Lens::default(), ..k }.blind_pixels(), 0);
    }
}
