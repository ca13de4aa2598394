//! Perspective images: rays meet at one point, and a ray has its image where it meets the plane at distance 1, displaced by
//! the distortion of the lens. Without distortion the camera is a pinhole.

use super::{BallImage, Colmap, Definition, LocalRay, Projection, dot};
use crate::Intrinsics;
use crate::geometry::camera::LocalCone;
use crate::geometry::lens::Unbent;
use crate::math::scalar::Real;
use glam::DVec3;

/// The pinhole and perspective lenses.
pub struct Perspective;

impl Projection for Perspective {
    const DEFINITION: Definition = Definition {
        name: "perspective",
        file_names: &[
            "PINHOLE",
            "SIMPLE_PINHOLE",
            "SIMPLE_RADIAL",
            "RADIAL",
            "OPENCV",
            "FULL_OPENCV",
            "PERSPECTIVE",
        ],
        flags: &[],
        colmap: &[
            Colmap { number: 0, name: "SIMPLE_PINHOLE", parameters: &["f", "cx", "cy"] },
            Colmap { number: 1, name: "PINHOLE", parameters: &["fx", "fy", "cx", "cy"] },
            Colmap { number: 2, name: "SIMPLE_RADIAL", parameters: &["f", "cx", "cy", "k1"] },
            Colmap { number: 3, name: "RADIAL", parameters: &["f", "cx", "cy", "k1", "k2"] },
            Colmap {
                number: 4,
                name: "OPENCV",
                parameters: &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2"],
            },
            Colmap {
                number: 6,
                name: "FULL_OPENCV",
                parameters: &["fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "d1", "d2", "d3"],
            },
        ],
        distorted: true,
        angles: true,
        extent_key: None,
        focal: None,
        directed: true,
    };

    fn example(width: u32, height: u32) -> Intrinsics {
        Intrinsics::from_angle(width, height, 0.8)
    }

    fn ray<R: Real>(k: &Intrinsics, at: [R; 2]) -> Option<LocalRay<R>> {
        let ([x, y], by) = undistorted(k, at)?;
        let zero = R::zero();
        let axis = [x, -y, -R::one()];
        let inverse = dot(axis, axis).sqrt().recip();
        let direction = axis.map(|value| value * inverse);
        // The component of a derivative along the direction changes only the direction's length, so it is removed.
        let across = |change: [R; 3]| {
            let along = dot(change, direction);
            std::array::from_fn(|i| (change[i] - along * direction[i]) * inverse)
        };
        Some(LocalRay {
            origin: [zero; 3],
            direction,
            origin_by: [[zero; 3]; 2],
            direction_by: by.map(|[x, y]| across([x, -y, zero])),
            cosine: inverse,
        })
    }

    /// Returns the cone of a square part of a pixel. The part's disc, on the plane at distance 1, has radius side ·
    /// sqrt(Δx·Δy/π) with Δx = 1/fx, Δy = 1/fy. The tangent of the angle to the optical axis is computed from the pixel's
    /// position: derived from the cosine in f32, it would lose 8.5 % of its value near the centre of an 800-pixel image. A
    /// lens moves the axis and divides the disc's area by the determinant of its Jacobian.
    #[inline]
    fn cone<R: Real>(k: &Intrinsics, at: [R; 2], side: R) -> LocalCone<R> {
        let (image, disc) = (k.normalised(at), k.disc(side));
        if k.lens.is_straight() {
            return LocalCone::through(image, disc);
        }
        // Before the lens, the part covers 1/area of its area in the image.
        let through = |Unbent { at, area }: Unbent<R>| LocalCone::through(at, disc / area.sqrt());
        k.lens.unbend(image).map_or_else(LocalCone::none, through)
    }

    fn image_of(k: &Intrinsics, point: DVec3) -> Option<[f64; 2]> {
        let (x, y, ahead) = (point.x, -point.y, -point.z);
        if !(ahead > 0.0) {
            return None;
        }
        let at = [x / ahead, y / ahead];
        if k.lens.is_straight() {
            return Some([k.cx + k.fx * at[0], k.cy + k.fy * at[1]]);
        }
        if !(at[0].hypot(at[1]) < k.lens.domain()) {
            return None;
        }
        let [u, v] = k.lens.bend(at).0;
        Some([k.cx + k.fx * u, k.cy + k.fy * v])
    }

    fn ball(k: &Intrinsics, centre: DVec3, radius: f64) -> BallImage {
        lens_ball(k, centre, radius)
    }
}

/// Returns the undistorted coordinates of a place, and their derivatives with respect to the place's two coordinates.
pub(super) fn undistorted<R: Real>(k: &Intrinsics, at: [R; 2]) -> Option<([R; 2], [[R; 2]; 2])> {
    let image = k.normalised(at);
    let [x, y] = [k.fx, k.fy].map(|focal| R::from_f64(focal).recip());
    if k.lens.is_straight() {
        return Some((image, [[x, R::zero()], [R::zero(), y]]));
    }
    let Unbent { at, area } = k.lens.unbend(image)?;
    // The derivatives are the inverse of the lens' Jacobian.
    let [[a, b], [c, d]] = k.lens.bend(at).1;
    Some((at, [[d * x / area, -c * x / area], [-b * y / area, a * y / area]]))
}

/// Returns the bounds of the image of a ball through a lens.
pub(super) fn lens_ball(k: &Intrinsics, centre: DVec3, radius: f64) -> BallImage {
    let at = centre;
    let depth = -at.z;
    if depth <= 2.0 * radius {
        return if depth < -radius { BallImage::None } else { BallImage::Anywhere };
    }
    // The image of the ball grows with the ball's angle to the optical axis.
    let off_axis = (1.0 + (at.x * at.x + at.y * at.y) / (depth * depth)).sqrt();
    let reach = k.fx.max(k.fy) * radius * off_axis / (depth - radius) + 1.0;
    if k.lens.is_straight() {
        return BallImage::Within { at: [k.cx + k.fx * at.x / depth, k.cy - k.fy * at.y / depth], reach };
    }
    // `stretch` is the lens' factor at the middle of the ball; twice this factor allows for larger factors elsewhere in the
    // ball.
    let Some(bent) = k.image_of(at) else { return BallImage::Anywhere };
    let straight = [at.x / depth, -at.y / depth];
    BallImage::Within { at: bent, reach: 1.0 + 2.0 * (reach - 1.0) * k.lens.stretch(straight) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Lens;
    use crate::geometry::projections::Model;

    #[test]
    fn the_jacobian_of_a_lens_is_that_of_its_cones() {
        // Eq. 3 differs from the disc of the pixel's solid angle by the factor √cosθ, because the disc is seen at a slant,
        // and by a relative error below the disc's radius.
        let lens = Lens::perspective([-0.28, 0.07, -0.008, 0.0], [0.001, -0.002], [0.0; 3]);
        let k = Intrinsics { lens, ..Model::Perspective.example(640, 480) };
        for at in [[320.5, 240.5], [3.5, 470.5], [600.5, 17.5]] {
            let (own, general) = (k.cone::<f64>(at, 1.0), k.ray(at).unwrap().cone(1.0));
            assert!((own.slope / (general.slope * own.cosine.sqrt()) - 1.0).abs() < 2e-3);
            assert_eq!((general.radius, own.radius), (0.0, 0.0));
        }
    }
}
