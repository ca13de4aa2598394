//! Panoramas: all rays meet at one point; columns are longitudes and rows are latitudes. Focal lengths are pixels per π radians,
//! as in nerfstudio's `EQUIRECTANGULAR`: for a whole panorama, fx is half the width and fy is the height. The ray of the
//! principal point runs along −z.

use super::{BallImage, Colmap, Definition, LocalRay, Model, Projection, plain};
use crate::Intrinsics;
use crate::math::scalar::Real;
use glam::DVec3;
use std::f64::consts::{FRAC_PI_2, PI};

/// The equirectangular model of panoramas.
pub struct Equirectangular;

impl Projection for Equirectangular {
    const DEFINITION: Definition = Definition {
        name: "equirectangular",
        file_names: &["EQUIRECTANGULAR"],
        flags: &["equirectangular"],
        colmap: &[Colmap { number: 17, name: "EQUIRECTANGULAR", parameters: &["w", "h"] }],
        distorted: false,
        angles: false,
        extent_key: None,
        focal: Some(|width, height| [0.5 * width, height]),
        directed: false,
    };

    /// Returns intrinsics that show a third of a whole panorama along each axis: 120 by 60 degrees.
    fn example(width: u32, height: u32) -> Intrinsics {
        plain(Model::Equirectangular, [width, height], [1.5 * f64::from(width), 3.0 * f64::from(height)])
    }

    /// Returns the ray of a place. Depth is distance, because half of a panorama lies behind the camera.
    fn ray<R: Real>(k: &Intrinsics, at: [R; 2]) -> Option<LocalRay<R>> {
        let (zero, pi) = (R::zero(), R::from_f64(PI));
        let [x, y] = k.normalised(at);
        let (longitude, latitude) = (pi * x, -(pi * y));
        if !(latitude.abs() <= R::from_f64(FRAC_PI_2)) {
            return None;
        }
        let ((sine, cosine), (up, across)) = (longitude.sin_cos(), latitude.sin_cos());
        let [by_x, by_y] = [k.fx, k.fy].map(|focal| pi / R::from_f64(focal));
        Some(LocalRay {
            origin: [zero; 3],
            direction: [sine * across, up, -(cosine * across)],
            origin_by: [[zero; 3]; 2],
            direction_by: [
                [by_x * cosine * across, zero, by_x * sine * across],
                [by_y * sine * up, -(by_y * across), -(by_y * cosine * up)],
            ],
            cosine: R::one(),
        })
    }

    fn image_of(k: &Intrinsics, point: DVec3) -> Option<[f64; 2]> {
        let [longitude, latitude] = angles(point)?;
        let (x, width) = (k.cx + k.fx * longitude / PI, f64::from(k.width));
        // A place beyond the left or right side of the image may lie within the image after a whole turn.
        let turned = if x < 0.0 { x + 2.0 * k.fx } else { x - 2.0 * k.fx };
        let inside = |x: &f64| (0.0..width).contains(x);
        let x = if !inside(&x) && inside(&turned) { turned } else { x };
        Some([x, k.cy - k.fy * latitude / PI])
    }

    fn ball(k: &Intrinsics, centre: DVec3, radius: f64) -> BallImage {
        let distance = centre.length();
        let Some([_, latitude]) = angles(centre).filter(|_| distance > 2.0 * radius) else {
            return BallImage::Anywhere;
        };
        let high = (radius / distance).asin();
        // A ball at a pole covers all longitudes.
        if latitude.abs() + high > 0.999 * FRAC_PI_2 {
            return BallImage::Anywhere;
        }
        let wide = (high.sin() / latitude.cos()).asin();
        match k.image_of(centre) {
            Some(at) => BallImage::Within { at, reach: (k.fx * wide).max(k.fy * high) / PI + 1.0 },
            None => BallImage::Anywhere,
        }
    }

    /// Returns the width of the widest pixels, those at the horizon.
    fn footprint(k: &Intrinsics, distance: f64) -> f64 {
        distance * PI / (k.fx * k.fy).sqrt()
    }

    fn half_angle(_: &Intrinsics) -> f64 {
        PI
    }
}

/// Returns the longitude and latitude of a point; `None` for the centre of projection.
fn angles(point: DVec3) -> Option<[f64; 2]> {
    let across = point.x.hypot(point.z);
    (across + point.y.abs() > 0.0).then(|| [point.x.atan2(-point.z), point.y.atan2(across)])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, Cone};

    /// Returns the intrinsics of a whole panorama.
    fn whole(width: u32, height: u32) -> Intrinsics {
        let focal = Equirectangular::DEFINITION.focal.map(|focal| focal(width.into(), height.into()));
        plain(Model::Equirectangular, [width, height], focal.unwrap_or_default())
    }

    fn cones(k: &Intrinsics) -> Vec<Cone<f64>> {
        let camera = Camera { intrinsics: *k, rotation: glam::DMat3::IDENTITY, origin: DVec3::ZERO };
        (0..k.width * k.height).map(|i| camera.cone(i % k.width, i / k.width)).collect()
    }

    #[test]
    fn cones_of_a_panorama_fill_the_sphere() {
        for (width, height) in [(64, 32), (200, 100), (90, 90)] {
            let (mut total, mut mean) = (0.0, DVec3::ZERO);
            for cone in cones(&whole(width, height)) {
                let solid = PI * cone.slope.powi(2);
                total += solid;
                mean += solid * DVec3::from(cone.direction);
            }
            // The cosine of a row's middle latitude is the row's mean cosine, up to a relative Δ²/24 for rows of height Δ.
            let bound = 4.0 * PI * (PI / f64::from(height)).powi(2) / 20.0;
            assert!((total - 4.0 * PI).abs() < bound, "{total}");
            assert!(mean.length() < 1e-9, "{mean}");
        }
    }

    #[test]
    fn pixels_are_narrower_by_the_cosine_of_their_latitude() {
        let k = whole(64, 32);
        let cones = cones(&k);
        for y in 0..32 {
            let latitude = PI * (0.5 - (y as f64 + 0.5) / 32.0);
            let expected = (latitude.cos() / PI).sqrt() * PI / 32.0;
            assert!((cones[64 * y + 5].slope / expected - 1.0).abs() < 1e-12, "row {y}");
        }
    }

    #[test]
    fn the_sides_of_a_panorama_meet() {
        let k = whole(64, 32);
        let own = cones(&k);
        let apart =
            |a: usize, b: usize| (DVec3::from(own[a].direction) - DVec3::from(own[b].direction)).length();
        // The seam lies behind the camera; the pixels on both sides of it are neighbours.
        assert!((apart(64 * 16, 64 * 16 + 63) - apart(64 * 16 + 31, 64 * 16 + 32)).abs() < 1e-12);
        assert!(own[64 * 16].direction[2] > 0.99 && own[64 * 16 + 32].direction[2] < -0.99);
        // If the principal point lies elsewhere, every direction still has a place in the image.
        let moved = Intrinsics { cx: 50.0, ..k };
        for cone in &own {
            let [x, y] = moved.image_of(cone.direction.into()).unwrap();
            assert!((0.0..64.0).contains(&x) && (0.0..32.0).contains(&y), "{x} {y}");
        }
    }

    #[test]
    fn axes_have_their_places() {
        let k = whole(64, 32);
        for (axis, [x, y]) in [
            (-DVec3::Z, [32.0, 16.0]),
            (DVec3::X, [48.0, 16.0]),
            (-DVec3::X, [16.0, 16.0]),
            (DVec3::Y, [32.0, 0.0]),
            (-DVec3::Y, [32.0, 32.0]),
        ] {
            let found = k.image_of(3.0 * axis).unwrap();
            assert!((found[1] - y).abs() < 1e-12, "{axis}: {found:?}");
            assert!(axis.y != 0.0 || (found[0] - x).abs() < 1e-12, "{axis}: {found:?}");
        }
    }

    #[test]
    fn rows_beyond_the_poles_have_no_rays() {
        let k = Intrinsics { height: 40, cy: 20.0, ..whole(64, 32) };
        assert_eq!(k.blind_pixels(), 8 * 64);
        assert_eq!(whole(64, 32).blind_pixels(), 0);
    }
}
