//! Bundle adjustment: finds the cameras and points with the smallest reprojection errors (Triggs et al. 2000). The
//! Levenberg–Marquardt method minimises the sum of Huber's function of these errors. Points are eliminated from each
//! step (the Schur complement), which leaves a dense system of six unknowns per camera and one focal length per lens.

use super::cholesky;
use crate::points::Observation;
use glam::{DMat3, DQuat, DVec3};
use rayon::prelude::*;
use trimip_core::{Camera, Intrinsics};

/// Largest number of steps, and the relative decrease of the cost below which the adjustment ends.
const MOST_STEPS: usize = 40;
const SETTLED: f64 = 1e-5;

/// Damping as a multiple of the diagonal: its value for the first step, its factors after a step that lowers the cost
/// and after one that does not, and its limits.
const DAMPING: f64 = 1e-4;
const RELAX: f64 = 0.3;
const TIGHTEN: f64 = 5.0;
const MOST_DAMPING: f64 = 1e6;
const LEAST_DAMPING: f64 = 1e-9;

/// Number of steps of a point while the cameras are fixed.
const POINT_STEPS: usize = 8;

/// Number of parts into which the points are divided, to sum them in parallel. It is fixed, so that sums have the same
/// bits for any number of threads.
const PARTS: usize = 4;

/// Number of unknowns of a camera: rotation and translation in the camera's axes. The focal length is an unknown of the lens.
const POSE: usize = 6;

/// A point and its observations.
#[derive(Clone, Debug)]
pub(super) struct Seen {
    pub(super) position: DVec3,
    pub(super) track: Vec<Observation>,
}

/// One observation, linearised around the current state.
struct Linear {
    /// Index of the camera's first unknown, and index of the lens's unknown.
    unknowns: [usize; 2],
    /// Derivatives of the projection with respect to the pose, the logarithm of the focal length, and the point.
    by_pose: [[f64; POSE]; 2],
    by_focal: [f64; 2],
    by_point: [[f64; 3]; 2],
    /// Projection minus observation, pixels.
    residual: [f64; 2],
    /// Weight of the observation in Huber's function.
    weight: f64,
}

/// Cameras that are adjusted.
pub(super) struct Bundle<'a> {
    cameras: &'a mut [Camera],
    /// Index of the lens of each camera.
    lenses: Vec<usize>,
    lens_count: usize,
    /// Error above which Huber's function is linear, pixels.
    huber: f64,
}

impl<'a> Bundle<'a> {
    /// Creates a bundle; cameras with the same intrinsics share one lens.
    pub(super) fn new(cameras: &'a mut [Camera], huber: f64) -> Self {
        let mut known: Vec<Intrinsics> = Vec::new();
        let lens = |camera: &Camera| {
            let own = camera.intrinsics;
            known.iter().position(|lens| *lens == own).unwrap_or_else(|| {
                known.push(own);
                known.len() - 1
            })
        };
        let lenses = cameras.iter().map(lens).collect();
        Self { cameras, lenses, lens_count: known.len(), huber }
    }

    /// Adjusts cameras and points. Photographs do not determine the position, orientation and size of the scene;
    /// damping keeps changes of these small, so the scene stays about where it is.
    pub(super) fn adjust(&mut self, points: &mut [Seen]) {
        let mut damping = DAMPING;
        let mut cost = cost_of(self.cameras, points, self.huber);
        for _ in 0..MOST_STEPS {
            let linear = self.linearised(points);
            let mut next = None;
            while damping <= MOST_DAMPING {
                if let Some((cameras, moved)) = self.step(points, &linear, damping) {
                    let after = cost_of(&cameras, &moved, self.huber);
                    if after < cost {
                        next = Some((cameras, moved, after));
                        break;
                    }
                }
                damping *= TIGHTEN;
            }
            let Some((cameras, moved, after)) = next else { return };
            self.cameras.copy_from_slice(&cameras);
            points.iter_mut().zip(moved).for_each(|(point, moved)| *point = moved);
            damping = (RELAX * damping).max(LEAST_DAMPING);
            let settled = cost - after < SETTLED * cost;
            cost = after;
            if settled {
                return;
            }
        }
    }

    /// Returns the linearised observations of each point.
    fn linearised(&self, points: &[Seen]) -> Vec<Vec<Linear>> {
        let of_point = |point: &Seen| {
            let linear = |seen: &Observation| {
                let view = seen.view as usize;
                let unknowns = [POSE * view, POSE * self.cameras.len() + self.lenses[view]];
                Linear::of(point.position, seen, &self.cameras[view], unknowns, self.huber)
            };
            point.track.iter().filter_map(linear).collect()
        };
        points.par_iter().map(of_point).collect()
    }

    /// Returns the cameras and points after a step.
    fn step(
        &self,
        points: &[Seen],
        linear: &[Vec<Linear>],
        damping: f64,
    ) -> Option<(Vec<Camera>, Vec<Seen>)> {
        let n = POSE * self.cameras.len() + self.lens_count;
        let size = linear.len().div_ceil(PARTS).max(1);
        let parts: Vec<Reduced> = linear
            .par_chunks(size)
            .map(|chunk| {
                let mut part = Reduced::new(n);
                chunk.iter().for_each(|observations| part.add(observations, damping));
                part
            })
            .collect();
        let mut whole = Reduced::new(n);
        for part in parts {
            whole.matrix.par_iter_mut().zip(part.matrix).for_each(|(sum, value)| *sum += value);
            whole.diagonal.iter_mut().zip(part.diagonal).for_each(|(sum, value)| *sum += value);
            whole.right.iter_mut().zip(part.right).for_each(|(sum, value)| *sum += value);
        }
        for i in 0..n {
            // The constant keeps the matrix positive definite: a camera without observations, and a lens without a focal length, stay.
            whole.matrix[i * n + i] += damping * whole.diagonal[i] + 1e-12;
        }
        let x = cholesky::solve(&mut whole.matrix, &whole.right)?;
        let cameras = self.cameras.iter().enumerate().map(|(view, camera)| {
            let [a, b, c, d, e, f]: [f64; POSE] = std::array::from_fn(|i| x[POSE * view + i]);
            let turn = DMat3::from_quat(DQuat::from_scaled_axis(DVec3::new(a, b, c)));
            let scale = x[POSE * self.cameras.len() + self.lenses[view]].exp();
            let k = camera.intrinsics;
            Camera {
                rotation: camera.rotation * turn,
                origin: camera.origin + camera.rotation * DVec3::new(d, e, f),
                intrinsics: Intrinsics { fx: scale * k.fx, fy: scale * k.fy, ..k },
            }
        });
        let moved = points.par_iter().zip(linear).map(|(point, observations)| {
            let own = Own::of(observations, damping);
            let along = own.right - observations.iter().map(|linear| linear.pull(&x)).sum::<DVec3>();
            Seen { position: point.position + own.inverse * along, track: point.track.clone() }
        });
        Some((cameras.collect(), moved.collect()))
    }
}

/// Returns the sum of Huber's function of all reprojection errors, which are capped at the longer side of the
/// photograph. A point without an image in a camera has this largest error.
fn cost_of(cameras: &[Camera], points: &[Seen], huber: f64) -> f64 {
    let costs: Vec<f64> = points
        .par_iter()
        .map(|point| {
            let cost = |seen: &Observation| {
                let camera = &cameras[seen.view as usize];
                let most = f64::from(camera.intrinsics.width.max(camera.intrinsics.height));
                let error = seen.error(point.position, camera).map_or(most, |error| error.min(most));
                if error <= huber { 0.5 * error * error } else { huber * (error - 0.5 * huber) }
            };
            point.track.iter().map(cost).sum()
        })
        .collect();
    costs.iter().sum()
}

impl Linear {
    /// Linearises an observation. Returns `None` if the camera has no image of the point.
    fn of(
        position: DVec3,
        seen: &Observation,
        camera: &Camera,
        unknowns: [usize; 2],
        huber: f64,
    ) -> Option<Self> {
        let to_camera = camera.rotation.transpose();
        let local = to_camera * (position - camera.origin);
        let k = &camera.intrinsics;
        let at = k.image_of(local)?;
        let mut by_local = [[0.0; 3]; 2];
        let h = 1e-5 * local.length();
        for axis in 0..3 {
            let step = h * DVec3::AXES[axis];
            let (ahead, behind) = (k.image_of(local + step)?, k.image_of(local - step)?);
            (0..2).for_each(|i| by_local[i][axis] = (ahead[i] - behind[i]) / (2.0 * h));
        }
        let residual = [at[0] - seen.at[0], at[1] - seen.at[1]];
        let error = residual[0].hypot(residual[1]);
        if !(error.is_finite() && by_local.as_flattened().iter().all(|value| value.is_finite())) {
            return None;
        }
        // If the camera turns by ω and moves by τ, the point moves by local × ω − τ in the camera's axes.
        let by_pose = by_local.map(|row| {
            let row = DVec3::from(row);
            let turn = row.cross(local);
            [turn.x, turn.y, turn.z, -row.x, -row.y, -row.z]
        });
        let by_point = by_local.map(|row| (camera.rotation * DVec3::from(row)).to_array());
        let has_focal = k.lens.model.definition().distorted;
        let by_focal = if has_focal { [at[0] - k.cx, at[1] - k.cy] } else { [0.0; 2] };
        let weight = if error <= huber { 1.0 } else { huber / error };
        Some(Self { unknowns, by_pose, by_focal, by_point, residual, weight })
    }

    /// Returns the derivatives with respect to the unknowns of the pose and of the lens, each with the index of its unknown.
    fn columns(&self) -> [([f64; 2], usize); POSE + 1] {
        std::array::from_fn(|i| match i {
            POSE => (self.by_focal, self.unknowns[1]),
            _ => ([self.by_pose[0][i], self.by_pose[1][i]], self.unknowns[0] + i),
        })
    }

    /// Returns the coupling of the point to a step `x` of all cameras and lenses: Jₚᵀ·w·J·x.
    fn pull(&self, x: &[f64]) -> DVec3 {
        let mut moved = [0.0; 2];
        for (column, at) in self.columns() {
            (0..2).for_each(|i| moved[i] += column[i] * x[at]);
        }
        (0..2).map(|i| self.weight * moved[i] * DVec3::from(self.by_point[i])).sum()
    }
}

/// The damped normal equations of one point.
struct Own {
    /// Inverse of the damped matrix: (Σ w·Jₚᵀ·Jₚ + damping · its diagonal)⁻¹.
    inverse: DMat3,
    /// Right-hand side: −Σ w·Jₚᵀ·r.
    right: DVec3,
}

impl Own {
    fn of(observations: &[Linear], damping: f64) -> Self {
        let (mut matrix, mut right) = (DMat3::ZERO, DVec3::ZERO);
        for linear in observations {
            for i in 0..2 {
                let row = DVec3::from(linear.by_point[i]);
                let weighted = linear.weight * row;
                matrix += DMat3::from_cols(weighted * row.x, weighted * row.y, weighted * row.z);
                right -= linear.residual[i] * weighted;
            }
        }
        let diagonal = DVec3::new(matrix.x_axis.x, matrix.y_axis.y, matrix.z_axis.z);
        matrix += DMat3::from_diagonal((damping * diagonal).max(DVec3::splat(1e-12)));
        let inverse = matrix.inverse();
        // A point whose lines of sight coincide is not determined, so it stays.
        let inverse = if inverse.is_finite() { inverse } else { DMat3::ZERO };
        Self { inverse, right }
    }
}

/// The normal equations of all cameras and lenses after points are eliminated.
struct Reduced {
    /// Lower triangle of the matrix, [n, n].
    matrix: Vec<f64>,
    /// Diagonal before points are eliminated; damping adds a multiple of it.
    diagonal: Vec<f64>,
    right: Vec<f64>,
    n: usize,
}

impl Reduced {
    fn new(n: usize) -> Self {
        Self { matrix: vec![0.0; n * n], diagonal: vec![0.0; n], right: vec![0.0; n], n }
    }

    /// Adds the observations of a point.
    fn add(&mut self, observations: &[Linear], damping: f64) {
        let own = Own::of(observations, damping);
        // Jₚᵀ·w·J of each observation, by column.
        let couplings: Vec<[(DVec3, usize); POSE + 1]> = observations
            .iter()
            .map(|linear| {
                let points = linear.by_point.map(DVec3::from);
                linear
                    .columns()
                    .map(|(column, at)| (linear.weight * (column[0] * points[0] + column[1] * points[1]), at))
            })
            .collect();
        for linear in observations {
            let columns = linear.columns();
            for (a, i) in columns {
                self.right[i] -= linear.weight * (a[0] * linear.residual[0] + a[1] * linear.residual[1]);
                self.diagonal[i] += linear.weight * (a[0] * a[0] + a[1] * a[1]);
                for (b, j) in columns {
                    if j <= i {
                        self.matrix[i * self.n + j] += linear.weight * (a[0] * b[0] + a[1] * b[1]);
                    }
                }
            }
        }
        for first in &couplings {
            for (a, i) in first {
                let solved = own.inverse * *a;
                self.right[*i] -= solved.dot(own.right);
                let row = &mut self.matrix[i * self.n..][..self.n];
                for (b, j) in couplings.as_flattened() {
                    if j <= i {
                        row[*j] -= solved.dot(*b);
                    }
                }
            }
        }
    }
}

/// Moves a point to where its reprojection errors are smallest. The cameras stay.
pub(super) fn triangulate(point: &mut Seen, cameras: &[Camera], huber: f64) {
    let mut damping = DAMPING;
    for _ in 0..POINT_STEPS {
        let linear = |seen: &Observation| {
            Linear::of(point.position, seen, &cameras[seen.view as usize], [0; 2], huber)
        };
        let linear: Vec<Linear> = point.track.iter().filter_map(linear).collect();
        let own = Own::of(&linear, damping);
        let moved = Seen { position: point.position + own.inverse * own.right, track: point.track.clone() };
        let [before, after] =
            [&*point, &moved].map(|point| cost_of(cameras, std::slice::from_ref(point), huber));
        if after < before {
            *point = moved;
            damping *= RELAX;
        } else {
            damping *= TIGHTEN;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns cameras on an arc around points, and the points with their observations.
    fn scene() -> (Vec<Camera>, Vec<Seen>) {
        let intrinsics = Intrinsics {
            lens: trimip_core::Lens::perspective([0.02, -0.01, 0.0, 0.0], [0.001, 0.0], [0.0; 3]),
            ..Intrinsics::from_angle(400, 300, 0.9)
        };
        let cameras: Vec<Camera> = (0..12)
            .map(|i| {
                let angle = 0.3 * f64::from(i);
                let origin = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.0 + 0.3 * angle.sin());
                Camera::look_at(intrinsics, origin, DVec3::new(0.1, 0.0, 0.2), DVec3::Z)
            })
            .collect();
        let points = (0..150).map(|i| {
            let wave = |by: f64| (by * f64::from(i)).sin();
            let position = 1.2 * DVec3::new(wave(1.1), wave(2.3), wave(3.7));
            let seen = |(view, camera): (usize, &Camera)| {
                let at =
                    camera.intrinsics.image_of(camera.rotation.transpose() * (position - camera.origin))?;
                Some(Observation { view: view as u32, at })
            };
            Seen { position, track: cameras.iter().enumerate().filter_map(seen).collect() }
        });
        let points = points.collect();
        (cameras, points)
    }

    fn errors(cameras: &[Camera], points: &[Seen]) -> Vec<f64> {
        let of = |point: &Seen| -> Vec<f64> {
            point
                .track
                .iter()
                .map(|seen| seen.error(point.position, &cameras[seen.view as usize]).unwrap())
                .collect()
        };
        points.iter().flat_map(of).collect()
    }

    fn disturb(cameras: &mut [Camera], points: &mut [Seen]) {
        for (i, camera) in cameras.iter_mut().enumerate() {
            let i = i as f64;
            let turn = DMat3::from_quat(DQuat::from_scaled_axis(
                0.01 * DVec3::new(i.sin(), i.cos(), (2.0 * i).sin()),
            ));
            camera.rotation *= turn;
            camera.origin += 0.05 * DVec3::new((3.0 * i).sin(), (5.0 * i).cos(), i.sin());
            camera.intrinsics.fx *= 1.02;
            camera.intrinsics.fy *= 1.02;
        }
        for (i, point) in points.iter_mut().enumerate() {
            point.position +=
                0.03 * DVec3::new((i as f64).sin(), (2.0 * i as f64).cos(), (3.0 * i as f64).sin());
        }
    }

    #[test]
    fn cameras_points_and_the_focal_length_come_back() {
        let (true_cameras, true_points) = scene();
        let (mut cameras, mut points) = (true_cameras.clone(), true_points.clone());
        disturb(&mut cameras, &mut points);
        assert!(errors(&cameras, &points).iter().sum::<f64>() / 1800.0 > 3.0);
        Bundle::new(&mut cameras, 1.0).adjust(&mut points);
        let worst = errors(&cameras, &points).into_iter().fold(0.0, f64::max);
        assert!(worst < 1e-3, "{worst} pixels");
        let focal = cameras[0].intrinsics.fx / true_cameras[0].intrinsics.fx;
        assert!((focal - 1.0).abs() < 1e-3, "{focal}");
        // Equal except for position, orientation and size, which photographs do not determine.
        let between =
            |cameras: &[Camera], a: usize, b: usize| (cameras[a].origin - cameras[b].origin).length();
        let size = between(&cameras, 0, 11) / between(&true_cameras, 0, 11);
        for (a, b) in [(0, 5), (3, 9), (2, 11)] {
            let ratio = between(&cameras, a, b) / between(&true_cameras, a, b);
            assert!((ratio / size - 1.0).abs() < 1e-4, "{ratio} {size}");
        }
    }

    /// Checks the effect of Huber's function: half of the points have one observation that is wrong by up to 100
    /// pixels. With Huber's function the other observations still fit; with squares they do not.
    #[test]
    fn wrong_observations_do_little_harm() {
        let (true_cameras, mut disturbed) = scene();
        for (i, point) in disturbed.iter_mut().enumerate().filter(|(i, _)| i % 2 == 0) {
            point.track[i % 12].at[i / 2 % 2] += 100.0 * (i as f64).sin();
        }
        let middle = |huber: f64| {
            let (mut cameras, mut points) = (true_cameras.clone(), disturbed.clone());
            disturb(&mut cameras, &mut points);
            Bundle::new(&mut cameras, huber).adjust(&mut points);
            let mut errors = errors(&cameras, &points);
            errors.sort_by(f64::total_cmp);
            errors[errors.len() / 2]
        };
        let [robust, squares] = [1.0, 1e9].map(middle);
        assert!(robust < 0.3 && squares > 3.0 * robust, "{robust} {squares} pixels");
    }

    #[test]
    fn derivatives_are_finite_differences() {
        let (cameras, points) = scene();
        let (camera, seen) = (&cameras[3], points[7].track[3]);
        let seen = Observation { at: [seen.at[0] + 0.3, seen.at[1] - 0.2], ..seen };
        let linear = Linear::of(points[7].position, &seen, camera, [0, POSE], 10.0).unwrap();
        let residual = |camera: &Camera, position: DVec3| {
            let at =
                camera.intrinsics.image_of(camera.rotation.transpose() * (position - camera.origin)).unwrap();
            DVec3::new(at[0] - seen.at[0], at[1] - seen.at[1], 0.0)
        };
        let h = 1e-5;
        let moved = |i: usize, by: f64| {
            let axis = by * DVec3::AXES[i % 3];
            let (mut camera, mut position) = (*camera, points[7].position);
            match i / 3 {
                0 => camera.rotation *= DMat3::from_quat(DQuat::from_scaled_axis(axis)),
                1 => camera.origin += camera.rotation * axis,
                2 => position += axis,
                _ => {
                    camera.intrinsics.fx *= by.exp();
                    camera.intrinsics.fy *= by.exp();
                }
            }
            residual(&camera, position)
        };
        for i in 0..10 {
            let slope = (moved(i, h) - moved(i, -h)) / (2.0 * h);
            let found = (0..2).map(|k| match i {
                0..6 => linear.by_pose[k][i],
                6..9 => linear.by_point[k][i - 6],
                _ => linear.by_focal[k],
            });
            for (found, slope) in found.zip(slope.to_array()) {
                assert!((found - slope).abs() < 1e-3 * slope.abs().max(1.0), "{i}: {found} {slope}");
            }
        }
    }

    #[test]
    fn a_point_goes_where_its_cameras_saw_it() {
        let (cameras, points) = scene();
        let mut point = points[3].clone();
        point.position += DVec3::new(0.05, -0.1, 0.08);
        triangulate(&mut point, &cameras, 1.0);
        assert!((point.position - points[3].position).length() < 1e-5, "{:?}", point.position);
    }
}
