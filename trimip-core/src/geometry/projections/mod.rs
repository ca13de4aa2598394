//! Camera models by name. A model maps places in the image to rays, generic over f32 and f64, and points in space to places in
//! the image. Each model is a file in this folder, a WGSL file of the same name in `trimip-wgpu/src/shaders/projections`, and
//! a line in the registry of each crate. Axes are those of the camera: x right, y up, −z ahead. Lengths in the image are
//! pixels.

mod equirectangular;
mod fisheye;
mod orthographic;
mod perspective;

use crate::geometry::camera::LocalCone;
use crate::math::scalar::Real;
use crate::{Intrinsics, Lens};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Names of a camera model in files and messages, and how files state its focal lengths.
#[derive(Debug)]
pub struct Definition {
    /// Name in messages; the WGSL function of the model is `cone_NAME`.
    pub name: &'static str,
    /// Values of `camera_model` in transforms files. The first is written for a model that takes no coefficients.
    pub file_names: &'static [&'static str],
    /// Keys of instant-ngp's transforms files that choose the model, unless their value is false.
    pub flags: &'static [&'static str],
    /// The models of COLMAP that this model covers.
    pub colmap: &'static [Colmap],
    /// True if the model takes the coefficients of [`Lens`].
    pub distorted: bool,
    /// True if `camera_angle_x` and `camera_angle_y` state the focal lengths.
    pub angles: bool,
    /// Key of the longer side of the image in world units, which also determines the focal lengths.
    pub extent_key: Option<&'static str>,
    /// Focal lengths of an image of this width and height, if the file states none.
    pub focal: Option<fn(f64, f64) -> [f64; 2]>,
    /// True if the camera looks along its optical axis; false for panoramas.
    pub directed: bool,
}

/// A camera model of COLMAP.
#[derive(Debug, PartialEq)]
pub struct Colmap {
    /// Its number in binary files.
    pub number: i32,
    /// Its name in text files.
    pub name: &'static str,
    /// Names of the parameters in the order of the files: f stands for both focal lengths, d1 to d3 for OpenCV's k4 to k6,
    /// and w and h for the size of the image.
    pub parameters: &'static [&'static str],
}

/// The ray of a place in the image, with the ray's derivatives with respect to the place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LocalRay<R> {
    /// Point where the ray begins, world units.
    pub origin: [R; 3],
    /// Unit direction.
    pub direction: [R; 3],
    /// Derivatives of `origin` with respect to the two coordinates of the place, world units per pixel.
    pub origin_by: [[R; 3]; 2],
    /// Derivatives of `direction` with respect to these coordinates, per pixel.
    pub direction_by: [[R; 3]; 2],
    /// Depth of a point on the ray divided by the point's distance along the ray.
    pub cosine: R,
}

impl<R: Real> LocalRay<R> {
    /// Returns the area of a pixel perpendicular to the ray, at the ray's origin, and the solid angle of a pixel.
    #[inline]
    pub fn areas(&self) -> [R; 2] {
        [self.origin_by, self.direction_by].map(|[x, y]| dot(cross(x, y), self.direction).abs())
    }

    /// Returns the cone of a square part of a pixel; `side` is the side of the part in pixels. The discs of the cone have the
    /// area of the part: at distance t, the parallelogram of ∂(o + t·d)/∂x and ∂(o + t·d)/∂y has the area A + B·t + C·t². A disc
    /// of radius √(A/π) + √(C/π)·t has that area if all rays are parallel (B = C = 0) or meet at one point (A = B = 0).
    #[inline]
    pub fn cone(&self, side: R) -> LocalCone<R> {
        let over_pi = R::from_f64(std::f64::consts::FRAC_1_PI);
        let [radius, slope] = self.areas().map(|area| side * (area * over_pi).sqrt());
        LocalCone {
            origin: self.origin,
            axis: self.direction,
            inverse_length: R::one(),
            radius,
            slope,
            cosine: self.cosine,
        }
    }
}

#[inline]
fn cross<R: Real>(a: [R; 3], b: [R; 3]) -> [R; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[inline]
fn dot<R: Real>(a: [R; 3], b: [R; 3]) -> R {
    a[0] * b[0] + a[1] * b[1] + a[2] * b[2]
}

/// Bounds of the image of a ball.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum BallImage {
    /// No ray meets the ball.
    None,
    /// No bound is known.
    Anywhere,
    /// Within a square.
    Within {
        /// Its centre.
        at: [f64; 2],
        /// Half of its side, including a margin of one pixel, because an edge may lie between the centres of two pixels.
        reach: f64,
    },
}

/// A camera model. Its functions take the intrinsics, whose `lens` states the model.
pub trait Projection {
    /// Names of the model, and its form in files.
    const DEFINITION: Definition;

    /// Returns intrinsics for examples and tests, with which a ball of radius 1 at distance 4 ahead lies within the image.
    fn example(width: u32, height: u32) -> Intrinsics;

    /// Returns the ray of a place in the image; `None` if the model has no ray there.
    fn ray<R: Real>(k: &Intrinsics, at: [R; 2]) -> Option<LocalRay<R>>;

    /// Returns the cone of a square part of a pixel, given its centre `at` and its `side`.
    #[inline]
    fn cone<R: Real>(k: &Intrinsics, at: [R; 2], side: R) -> LocalCone<R> {
        Self::ray(k, at).map_or_else(LocalCone::none, |ray| ray.cone(side))
    }

    /// Returns the place of a point in the image; `None` if no ray meets the point.
    fn image_of(k: &Intrinsics, point: DVec3) -> Option<[f64; 2]>;

    /// Returns the bounds of the image of a ball.
    fn ball(k: &Intrinsics, centre: DVec3, radius: f64) -> BallImage;

    /// Returns the world width of a pixel at a distance.
    fn footprint(k: &Intrinsics, distance: f64) -> f64 {
        distance / (k.fx * k.fy).sqrt()
    }

    /// Returns the length that sets the scale of a scene, for a camera at this distance from the subject: the distance itself, unless
    /// rays are parallel.
    fn scale(_: &Intrinsics, distance: f64) -> f64 {
        distance
    }

    /// Returns the approximate largest angle between a ray and the optical axis.
    fn half_angle(k: &Intrinsics) -> f64 {
        let [x, y] = [f64::from(k.width) / k.fx, f64::from(k.height) / k.fy].map(|extent| 0.5 * extent);
        x.hypot(y).atan()
    }
}

/// The registry of camera models: generates the type [`Model`] and its functions from one line per model. Other devices number
/// the models in the same order.
macro_rules! models {
    ($($file:ident::$model:ident),+ $(,)?) => {
        /// A camera model.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
        #[serde(rename_all = "lowercase")]
        pub enum Model {
            $(#[doc = concat!("See `projections/", stringify!($file), ".rs`.")] $model),+
        }

        impl Model {
            /// All models.
            pub const ALL: &[Self] = &[$(Self::$model),+];

            /// Returns the names of the model, and its form in files.
            pub fn definition(self) -> &'static Definition {
                match self { $(Self::$model => const { &<$file::$model as Projection>::DEFINITION }),+ }
            }

            /// Calls [`Projection::example`].
            pub fn example(self, width: u32, height: u32) -> Intrinsics {
                match self { $(Self::$model => $file::$model::example(width, height)),+ }
            }
        }

        impl Intrinsics {
            /// Returns the ray of a place in the image, in the camera's axes, with its derivatives; `None` if there is no
            /// ray.
            pub fn ray<R: Real>(&self, at: [R; 2]) -> Option<LocalRay<R>> {
                match self.lens.model { $(Model::$model => $file::$model::ray(self, at)),+ }
            }

            /// Returns the cone of a square part of a pixel, given its centre `at` and its `side`, both in pixels.
            #[inline]
            pub fn cone<R: Real>(&self, at: [R; 2], side: R) -> LocalCone<R> {
                match self.lens.model { $(Model::$model => $file::$model::cone(self, at, side)),+ }
            }

            /// Returns the place in the image of a point, which is in the camera's axes; `None` if no ray of the camera
            /// meets the point.
            pub fn image_of(&self, point: DVec3) -> Option<[f64; 2]> {
                match self.lens.model { $(Model::$model => $file::$model::image_of(self, point)),+ }
            }

            /// Returns the bounds of the image of a ball, whose centre is in the camera's axes.
            pub fn ball(&self, centre: DVec3, radius: f64) -> BallImage {
                match self.lens.model { $(Model::$model => $file::$model::ball(self, centre, radius)),+ }
            }

            /// Returns the world width of a pixel at a distance; the width of the widest pixel if pixels differ.
            pub fn footprint(&self, distance: f64) -> f64 {
                match self.lens.model { $(Model::$model => $file::$model::footprint(self, distance)),+ }
            }

            /// Calls [`Projection::scale`].
            pub fn scale(&self, distance: f64) -> f64 {
                match self.lens.model { $(Model::$model => $file::$model::scale(self, distance)),+ }
            }

            /// Returns the approximate largest angle between a ray and the optical axis.
            pub fn half_angle(&self) -> f64 {
                match self.lens.model { $(Model::$model => $file::$model::half_angle(self)),+ }
            }
        }
    };
}

models! {
    perspective::Perspective,
    fisheye::Fisheye,
    orthographic::Orthographic,
    equirectangular::Equirectangular,
}

impl Default for Model {
    fn default() -> Self {
        Self::ALL[0]
    }
}

impl Model {
    /// Returns the model with this name in transforms files, ignoring case.
    pub fn named(name: &str) -> Option<Self> {
        let called =
            |model: &Self| model.definition().file_names.iter().any(|own| own.eq_ignore_ascii_case(name));
        Self::ALL.iter().copied().find(called)
    }

    /// Returns the model's name in messages.
    pub fn name(self) -> &'static str {
        self.definition().name
    }
}

/// Returns intrinsics of a lens without distortion, with a centred principal point.
fn plain(model: Model, size: [u32; 2], [fx, fy]: [f64; 2]) -> Intrinsics {
    let [width, height] = size;
    let (cx, cy) = (0.5 * f64::from(width), 0.5 * f64::from(height));
    Intrinsics { width, height, fx, fy, cx, cy, lens: Lens::of(model) }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns intrinsics of every model, with oblong pixels and a principal point off the centre, and places in the image.
    fn examples() -> Vec<(Intrinsics, [f64; 2])> {
        let of = |model: &Model| {
            let example = model.example(64, 48);
            let k = Intrinsics { fx: 1.1 * example.fx, cx: 30.3, cy: 25.1, ..example };
            [[32.0, 24.0], [30.3, 25.1], [7.2, 40.9], [60.0, 5.5], [33.3, 20.0]].map(|at| (k, at))
        };
        Model::ALL.iter().flat_map(of).collect()
    }

    fn apart(a: [f64; 3], b: [f64; 3]) -> f64 {
        (DVec3::from(a) - DVec3::from(b)).length()
    }

    #[test]
    fn derivatives_of_rays_are_their_finite_differences() {
        const H: f64 = 1e-5;
        for (k, at) in examples() {
            let own = k.ray(at).expect("a ray");
            for axis in 0..2 {
                let moved = |by: f64| {
                    let mut at = at;
                    at[axis] += by;
                    k.ray(at).expect("a ray")
                };
                let (ahead, back) = (moved(H), moved(-H));
                let difference =
                    |a: [f64; 3], b: [f64; 3]| std::array::from_fn(|i| (a[i] - b[i]) / (2.0 * H));
                let name = k.lens.model.name();
                let direction = difference(ahead.direction, back.direction);
                assert!(apart(direction, own.direction_by[axis]) < 1e-9, "{name} {at:?}: {direction:?}");
                let origin = difference(ahead.origin, back.origin);
                assert!(apart(origin, own.origin_by[axis]) < 1e-9, "{name} {at:?}: {origin:?}");
            }
        }
    }

    #[test]
    fn points_of_a_ray_have_their_image_at_its_place() {
        for (k, at) in examples() {
            let ray = k.ray(at).expect("a ray");
            assert!((DVec3::from(ray.direction).length() - 1.0).abs() < 1e-12);
            for t in [0.1, 1.0, 30.0] {
                let point = DVec3::from(ray.origin) + t * DVec3::from(ray.direction);
                let found = k.image_of(point).expect("seen");
                let error = (found[0] - at[0]).hypot(found[1] - at[1]);
                assert!(error < 1e-9, "{}: {found:?}, not {at:?}", k.lens.model.name());
            }
        }
    }

    /// Checks that the disc of a cone has the area between the rays of the part's corners, at any distance. A perspective
    /// cone holds the sphere of Eq. 3, which is smaller by a factor of √cosθ, because the disc is seen at a slant.
    #[test]
    fn cones_have_the_footprint_of_their_pixels() {
        const SIDE: f64 = 1e-3;
        for (k, at) in examples() {
            let (cone, ray) = (k.cone(at, SIDE), k.ray(at).expect("a ray"));
            let direction = DVec3::from(ray.direction);
            for t in [0.5, 4.0, 60.0] {
                let corner = |x: f64, y: f64| {
                    let ray = k.ray([at[0] + x * SIDE, at[1] + y * SIDE]).expect("a ray");
                    DVec3::from(ray.origin) + t * DVec3::from(ray.direction)
                };
                let (a, b) = (corner(0.5, 0.0) - corner(-0.5, 0.0), corner(0.0, 0.5) - corner(0.0, -0.5));
                let disc = (a.cross(b).dot(direction).abs() / std::f64::consts::PI).sqrt();
                let slant = if k.lens.model == Model::Perspective { cone.cosine.sqrt() } else { 1.0 };
                let found = cone.radius + cone.slope * t;
                assert!(
                    (found / (disc * slant) - 1.0).abs() < 1e-3,
                    "{}: {found} {disc}",
                    k.lens.model.name()
                );
            }
        }
    }

    #[test]
    fn single_precision_is_double_precision_but_for_rounding() {
        for (k, at) in examples() {
            let (wide, narrow) = (k.cone(at, 1.0), k.cone(at.map(|x| x as f32), 1.0_f32));
            let unit = |axis: [f64; 3]| DVec3::from(axis).normalize();
            let name = k.lens.model.name();
            assert!((unit(wide.axis) - unit(narrow.axis.map(f64::from))).length() < 1e-6, "{name}");
            assert!(apart(wide.origin, narrow.origin.map(f64::from)) < 1e-6, "{name}");
            let relative = |a: f64, b: f32| (a - f64::from(b)).abs() <= 1e-5 * a.abs();
            assert!(relative(wide.slope, narrow.slope) && relative(wide.radius, narrow.radius), "{name}");
        }
    }

    #[test]
    fn a_reduced_image_has_the_rays_of_its_blocks() {
        for (k, _) in examples() {
            for level in 1..4 {
                let (factor, reduced) = (f64::from(1_u32 << level), k.reduced(level));
                let (own, other) =
                    (k.ray([24.0, 16.0]).unwrap(), reduced.ray([24.0 / factor, 16.0 / factor]).unwrap());
                assert!(apart(own.direction, other.direction) + apart(own.origin, other.origin) < 1e-12);
                let (own, other) =
                    (k.cone([24.0, 16.0], factor), reduced.cone([24.0 / factor, 16.0 / factor], 1.0));
                let near = |a: f64, b: f64| (a - b).abs() < 1e-12 * a.abs().max(1e-9);
                assert!(
                    near(own.slope, other.slope) && near(own.radius, other.radius),
                    "{}",
                    k.lens.model.name()
                );
            }
        }
    }

    #[test]
    fn the_image_of_a_ball_lies_within_its_bounds() {
        for model in Model::ALL {
            let k = model.example(64, 64);
            for (i, distance) in [1.5, 4.0, 20.0].into_iter().enumerate() {
                let centre = distance * DVec3::new(0.1 * i as f64, -0.05, -1.0);
                let radius = 0.3;
                let BallImage::Within { at, reach } = k.ball(centre, radius) else { continue };
                for j in 0..200 {
                    let (height, turn) = (f64::from(j) / 100.0 - 0.995, 2.4 * f64::from(j));
                    let across = (1.0 - height * height).sqrt();
                    let point =
                        centre + radius * DVec3::new(across * turn.cos(), across * turn.sin(), height);
                    let [x, y] = k.image_of(point).expect("seen");
                    let out = (x - at[0]).abs().max((y - at[1]).abs());
                    assert!(out <= reach, "{}: {out} pixels, not {reach}", model.name());
                }
            }
            assert!(matches!(k.ball(DVec3::new(0.0, 0.0, -4.0), 0.2), BallImage::Within { .. }));
        }
    }

    #[test]
    fn names_are_those_of_one_model() {
        let names = |model: &Model| model.definition().file_names.to_vec();
        let mut all: Vec<&str> = Model::ALL.iter().flat_map(names).collect();
        for model in Model::ALL {
            assert!(names(model).iter().all(|name| Model::named(name) == Some(*model)));
            let stored = serde_json::to_string(model).unwrap();
            assert_eq!(stored, format!("\"{}\"", model.name()));
        }
        let count = all.len();
        all.sort_unstable();
        all.dedup();
        assert_eq!(all.len(), count);
        assert_eq!(Model::named("FOV"), None);
        assert_eq!(Model::default(), Model::Perspective);
    }
}
