//! Similarities: a rotation, a scale and a shift.

use glam::{DMat3, DQuat, DVec3};
use trimip_core::{Camera, math::symmetric::eigen};

/// The map x ↦ scale · rotation · x + shift, in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Similarity {
    pub(super) scale: f64,
    pub(super) rotation: DMat3,
    pub(super) shift: DVec3,
}

impl Similarity {
    /// Returns the similarity that maps `from` to `to` best, by least squares (Horn 1987: the rotation is the eigenvector of the largest
    /// eigenvalue of a matrix of four rows). `None` for fewer than three points, points on one line, and points that are not finite.
    pub(super) fn fit(from: &[DVec3], to: &[DVec3]) -> Option<Self> {
        if from.len() < 3 || from.len() != to.len() {
            return None;
        }
        let mean = |points: &[DVec3]| points.iter().sum::<DVec3>() / points.len() as f64;
        let (middle, target) = (mean(from), mean(to));
        let (mut m, mut squares, mut target_squares) = ([[0.0; 3]; 3], 0.0, 0.0);
        for (x, y) in from.iter().zip(to) {
            let (x, y) = (*x - middle, *y - target);
            for (row, a) in m.iter_mut().zip(x.to_array()) {
                row.iter_mut().zip(y.to_array()).for_each(|(sum, b)| *sum += a * b);
            }
            squares += x.length_squared();
            target_squares += y.length_squared();
        }
        let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = m;
        let (values, vectors) = eigen([
            [xx + yy + zz, yz - zy, zx - xz, xy - yx],
            [yz - zy, xx - yy - zz, xy + yx, zx + xz],
            [zx - xz, xy + yx, yy - xx - zz, yz + zy],
            [xy - yx, zx + xz, yz + zy, zz - xx - yy],
        ]);
        let largest = (0..4).max_by(|&a, &b| values[a].total_cmp(&values[b]))?;
        let [w, x, y, z] = vectors.map(|row| row[largest]);
        let rotation = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize());
        let scale = (target_squares / squares).sqrt();
        let shift = target - scale * (rotation * middle);
        let found = Self { scale, rotation, shift };
        (scale > 0.0 && scale.is_finite() && rotation.is_finite() && shift.is_finite()).then_some(found)
    }

    /// Maps a point.
    pub(super) fn of(&self, point: DVec3) -> DVec3 {
        self.scale * (self.rotation * point) + self.shift
    }

    /// Returns the camera that sees the moved scene as `camera` sees the scene.
    pub(super) fn of_camera(&self, camera: &Camera) -> Camera {
        Camera { rotation: self.rotation * camera.rotation, origin: self.of(camera.origin), ..*camera }
    }

    /// Returns the inverse map.
    pub(super) fn inverse(&self) -> Self {
        let (scale, rotation) = (self.scale.recip(), self.rotation.transpose());
        Self { scale, rotation, shift: -scale * (rotation * self.shift) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::Intrinsics;

    fn example() -> (Similarity, Vec<DVec3>) {
        let rotation = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(2.0, -0.4, 1.1)));
        let points = (0..9).map(|i| {
            let i = f64::from(i);
            DVec3::new((3.0 * i).sin(), (7.0 * i).cos(), 0.3 * i - 1.0)
        });
        (Similarity { scale: 1.7, rotation, shift: DVec3::new(4.0, -2.0, 0.5) }, points.collect())
    }

    #[test]
    fn the_fit_is_the_similarity_of_its_points() {
        let (true_one, from) = example();
        let to: Vec<DVec3> = from.iter().map(|point| true_one.of(*point)).collect();
        let found = Similarity::fit(&from, &to).unwrap();
        for point in &from {
            assert!((found.of(*point) - true_one.of(*point)).length() < 1e-12, "{found:?}");
            assert!((found.inverse().of(found.of(*point)) - *point).length() < 1e-12);
        }
        assert!(Similarity::fit(&from[..2], &to[..2]).is_none());
        assert!(Similarity::fit(&[DVec3::ONE; 5], &[DVec3::ZERO; 5]).is_none());
        assert!(Similarity::fit(&[DVec3::NAN; 5], &to[..5]).is_none());
    }

    /// Checks that no similarity nearby has a smaller sum of squares.
    #[test]
    fn the_fit_of_noisy_points_is_the_least_in_rotation_and_shift() {
        let (true_one, from) = example();
        let noise = |i: usize| {
            0.05 * DVec3::new((9.0 * i as f64).sin(), (5.0 * i as f64).cos(), (i % 3) as f64 - 1.0)
        };
        let to: Vec<DVec3> = from.iter().enumerate().map(|(i, x)| true_one.of(*x) + noise(i)).collect();
        let cost = |s: &Similarity| -> f64 {
            from.iter().zip(&to).map(|(x, y)| (s.of(*x) - *y).length_squared()).sum()
        };
        let found = Similarity::fit(&from, &to).unwrap();
        let middle = from.iter().sum::<DVec3>() / from.len() as f64;
        for axis in [DVec3::X, DVec3::Y, DVec3::Z, -DVec3::X, -DVec3::Y, -DVec3::Z] {
            let rotation = DMat3::from_quat(DQuat::from_scaled_axis(1e-3 * axis)) * found.rotation;
            let shift = found.of(middle) - found.scale * (rotation * middle);
            assert!(cost(&Similarity { rotation, shift, ..found }) > cost(&found));
            assert!(cost(&Similarity { shift: found.shift + 1e-3 * axis, ..found }) > cost(&found));
        }
    }

    #[test]
    fn a_moved_camera_sees_the_moved_points_where_it_saw_them() {
        let (similarity, points) = example();
        let intrinsics = Intrinsics::from_angle(400, 300, 0.9);
        let camera = Camera::look_at(intrinsics, DVec3::new(5.0, 1.0, 2.0), DVec3::ZERO, DVec3::Z);
        let moved = similarity.of_camera(&camera);
        let seen = |camera: &Camera, point: DVec3| {
            camera.intrinsics.image_of(camera.rotation.transpose() * (point - camera.origin)).unwrap()
        };
        for point in points {
            let (before, after) = (seen(&camera, point), seen(&moved, similarity.of(point)));
            assert!((0..2).all(|i| (before[i] - after[i]).abs() < 1e-9), "{before:?} {after:?}");
        }
    }
}
