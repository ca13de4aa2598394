//! The preconditioner of a camera's parameters (CamP, Park et al. 2023, Eqs. 5 to 8): every preconditioned parameter
//! moves the picture by the same amount, and no parameter undoes the effect of another.

use crate::{Camera, Space, math::symmetric::inverse_root_and_root};
use glam::DVec3;

/// Motion is measured at this number of places along each side of the picture, and at this number of points along the
/// ray of each place.
const PLACES: usize = 8;

/// Damping: the multiple of the matrix's diagonal that is added to the matrix (λ of CamP).
const DIAGONAL: f64 = 0.1;

/// Damping: the value that is added to the diagonal (μ of CamP).
const LEAST: f64 = 1e-8;

/// Largest change of a camera, measured as the motion of its picture: a tenth of the picture's longer side.
const MOST: f64 = 0.1;

/// Rotation around the camera's axes (radians), then translation along them (world units).
pub type Motion = [f64; 6];

/// The map from parameters to changes of a camera: P = (JᵀJ/n + λ·diag(JᵀJ/n) + μ)^(−1/2), where J is the derivative of
/// the positions of n points in the picture with respect to the change, as a fraction of the picture's longer side.
#[derive(Clone, Debug, PartialEq)]
pub struct Preconditioner<const N: usize> {
    matrix: [[f64; N]; N],
    inverse: [[f64; N]; N],
}

impl<const N: usize> Preconditioner<N> {
    /// Creates the preconditioner whose J has these rows, one for each point and direction of motion.
    pub fn of(rows: impl IntoIterator<Item = [f64; N]>) -> Self {
        let mut sum = [[0.0; N]; N];
        let mut count = 0_u32;
        for row in rows {
            for (sums, left) in sum.iter_mut().zip(row) {
                sums.iter_mut().zip(row).for_each(|(sum, right)| *sum += left * right);
            }
            count += 1;
        }
        for (i, row) in sum.iter_mut().enumerate() {
            // Each point has two rows.
            row.iter_mut().for_each(|value| *value *= 2.0 / f64::from(count.max(2)));
            row[i] += DIAGONAL * row[i] + LEAST;
        }
        let [matrix, inverse] = inverse_root_and_root(sum);
        Self { matrix, inverse }
    }

    /// Returns the change of the camera for these parameters.
    pub fn change(&self, parameters: [f64; N]) -> [f64; N] {
        product(&self.matrix, parameters)
    }

    /// Returns the parameters that produce a change.
    pub fn parameters(&self, change: [f64; N]) -> [f64; N] {
        product(&self.inverse, change)
    }

    /// Converts derivatives with respect to the change into derivatives with respect to the parameters.
    pub fn gradient(&self, by_change: [f64; N]) -> [f64; N] {
        // The matrix is symmetric.
        product(&self.matrix, by_change)
    }
}

impl Preconditioner<6> {
    /// Creates the preconditioner of the pose of a camera that sees `space`. Points are spread evenly over the camera's
    /// picture and along each ray, where they are evenly spaced in the parameter of the marching steps.
    pub fn of_pose(camera: &Camera, space: &Space<f64>) -> Self {
        let mut rows = Vec::new();
        each_point(camera, space, |direction, point, radius| {
            let longer = f64::from(camera.intrinsics.width.max(camera.intrinsics.height));
            // The sphere's disc has the area of a pixel, so the side of a pixel at this point is √π · `radius`.
            let fraction = (std::f64::consts::PI.sqrt() * radius * longer).recip();
            for across in [direction.any_orthonormal_pair().0, direction.any_orthonormal_pair().1] {
                // If the camera turns by ω and moves by τ, a point at x in its axes moves by −(ω × x + τ). The sign
                // does not matter.
                let turn = point.cross(across);
                rows.push(
                    [turn.x, turn.y, turn.z, across.x, across.y, across.z].map(|value| value * fraction),
                );
            }
        });
        Self::of(rows)
    }
}

/// Returns places that are spread evenly over a picture, as fractions of the picture's sides.
pub fn places() -> impl Iterator<Item = [f64; 2]> {
    (0..PLACES).flat_map(|y| (0..PLACES).map(move |x| [middle(x), middle(y)]))
}

/// Returns the middle of part `i`, if the unit interval is divided into [`PLACES`] equal parts.
fn middle(i: usize) -> f64 {
    (i as f64 + 0.5) / PLACES as f64
}

/// Calls `take` for each point with the direction of its ray, its position and the radius of its sphere, in the
/// camera's axes.
fn each_point(camera: &Camera, space: &Space<f64>, mut take: impl FnMut(DVec3, DVec3, f64)) {
    let (width, height) = (f64::from(camera.intrinsics.width), f64::from(camera.intrinsics.height));
    for [x, y] in places() {
        let cone = camera.cone_at::<f64>([x * width, y * height], 1.0);
        if cone.is_none() {
            continue;
        }
        let course = space.parameterisation(cone.origin, cone.direction);
        let (enter, leave) = course.range();
        if !(enter < leave) {
            continue;
        }
        let [origin, direction] = [cone.origin, cone.direction].map(DVec3::from_array);
        for t in (0..PLACES).map(|i| course.distance(enter + middle(i) * (leave - enter))) {
            let point = origin + t * direction - camera.origin;
            let axes = camera.rotation.transpose();
            take(axes * direction, axes * point, cone.radius_at(t));
        }
    }
}

/// Shortens a vector of parameters that moves the picture by more than [`MOST`].
pub(crate) fn shorten<const N: usize>(value: &mut [f32; N]) {
    let length = value.iter().map(|value| f64::from(*value).powi(2)).sum::<f64>().sqrt();
    if length > MOST {
        *value = value.map(|value| (MOST / length * f64::from(value)) as f32);
    }
}

fn product<const N: usize>(matrix: &[[f64; N]; N], vector: [f64; N]) -> [f64; N] {
    matrix.map(|row| row.iter().zip(vector).map(|(a, b)| a * b).sum())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Aabb, Intrinsics};

    fn camera() -> Camera {
        let intrinsics = Intrinsics::from_angle(400, 300, 0.8);
        Camera::look_at(intrinsics, DVec3::new(3.0, -2.0, 1.5), DVec3::ZERO, DVec3::Z)
    }

    fn spaces() -> [Space<f64>; 2] {
        let aabb = Aabb { min: [-1.0; 3], max: [1.0; 3] };
        [Space::of(aabb), Space::contracted(aabb)]
    }

    /// Checks that a vector of parameters of length h moves the picture by about h of its longer side, whatever the
    /// vector's direction. The damping makes the motion smaller.
    #[test]
    fn every_parameter_moves_the_picture_by_as_much() {
        for space in spaces() {
            let (camera, h) = (camera(), 1e-4);
            let preconditioner = Preconditioner::of_pose(&camera, &space);
            for i in 0..6 {
                let mut parameters = [0.0; 6];
                parameters[i] = h;
                let motion = preconditioner.change(parameters);
                let [turn, shift] = [&motion[..3], &motion[3..]].map(DVec3::from_slice);
                let (mut squares, mut count) = (0.0, 0.0);
                each_point(&camera, &space, |_, point, _| {
                    // The position in the picture, in pixels.
                    let at = |p: DVec3| camera.intrinsics.fx / -p.z * p.truncate();
                    let moved = point + turn.cross(point) + shift;
                    squares += (at(moved) - at(point)).length_squared();
                    count += 1.0;
                });
                let fraction = f64::sqrt(squares / count) / 400.0;
                assert!(fraction < 1.3 * h && fraction > 0.2 * h, "{i}: {fraction} for {h}");
            }
        }
    }

    #[test]
    fn parameters_and_motions_are_inverse() {
        for space in spaces() {
            let preconditioner = Preconditioner::of_pose(&camera(), &space);
            let parameters = [0.1, -0.2, 0.3, 0.4, -0.5, 0.6];
            let back = preconditioner.parameters(preconditioner.change(parameters));
            for (found, expected) in back.into_iter().zip(parameters) {
                assert!((found - expected).abs() < 1e-9, "{back:?}");
            }
        }
    }

    /// Checks that a camera that sees nothing of the scene still gets finite motions.
    #[test]
    fn a_camera_that_looks_away_has_finite_parameters() {
        let [space, _] = spaces();
        let away = Camera::look_at(camera().intrinsics, DVec3::X * 5.0, DVec3::X * 9.0, DVec3::Z);
        let motion = Preconditioner::of_pose(&away, &space).change([1e-4; 6]);
        assert!(motion.iter().all(|value| value.is_finite()), "{motion:?}");
    }
}
