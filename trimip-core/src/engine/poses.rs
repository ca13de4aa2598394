//! Poses of photographs, for `train.cameras = "refine"`: training also moves each photograph's camera, by a rotation
//! and a translation in its own axes, and changes its intrinsics ([`intrinsics`](super::intrinsics)). Motions are
//! trained alongside the parameters, are preconditioned ([`Preconditioner`]), and are not part of a model. Training
//! keeps two quantities at zero, so that the scene keeps its place and its size: the mean motion of all cameras, in the
//! axes of the world, and the growth of the cameras' distances to their centroid.

use crate::{
    Camera, Config, Intrinsics, Result, Space, ViewSet,
    config::{CameraPoses, OptimizerConfig},
    engine::{
        exposure::photographs,
        intrinsics::{Change, ChangedCamera, ChangedIntrinsics, SharedIntrinsics},
        lagged::Lagged,
        preconditioner::{Motion, Preconditioner, shorten},
        step_result::StepResult,
    },
    field::tensors::TensorFile,
    plural::count,
};
use glam::{DMat3, DQuat, DVec3};
use serde::{Deserialize, Serialize};

/// Prefix of the names of the poses' tensors in checkpoints.
pub const PREFIX: &str = "poses.";

/// The given pose of a photograph's camera, relative to the centre of the box.
#[derive(Clone, Debug, PartialEq)]
struct Given {
    /// Name of the photograph.
    name: String,
    /// The camera of the photograph's finest view.
    camera: Camera,
    preconditioner: Preconditioner<6>,
}

impl Given {
    /// Converts the derivatives `by_world` to derivatives with respect to the camera's motion, at `motion`. `by_world`
    /// are the derivatives with respect to a translation of the camera in the world's axes and a rotation around the
    /// world's origin.
    fn by_motion(&self, motion: &Motion, by_world: [f64; 6]) -> Motion {
        let Camera { rotation, origin, .. } = self.camera;
        let [force, torque] = [&by_world[..3], &by_world[3..]].map(DVec3::from_slice);
        let now = rotation * turn(motion);
        let centre = origin + rotation * DVec3::from_slice(&motion[3..]);
        let by_rotation = now.transpose() * (torque - centre.cross(force));
        let by_translation = rotation.transpose() * force;
        joined([by_rotation, by_translation])
    }
}

/// Poses of all photographs in training.
#[derive(Clone, Debug, PartialEq)]
pub struct Poses {
    /// One per photograph.
    given: Vec<Given>,
    /// One per view: the given camera, relative to the centre of the box, and the index of its photograph.
    views: Vec<(Camera, usize)>,
    corrections: Lagged<6>,
    intrinsics: SharedIntrinsics,
    /// True if the mean motion may differ from zero.
    free: bool,
}

/// The poses that training has found.
#[derive(Clone, Debug, PartialEq)]
pub struct Refined {
    /// Name of each training photograph, and the camera of its finest view, in the world.
    pub cameras: Vec<(String, Camera)>,
    /// Given intrinsics of each camera at its finest scale, and their change by training.
    pub intrinsics: Vec<(Intrinsics, Change)>,
    /// How far the cameras are from the given ones.
    pub moved: Moved,
}

/// How far refined cameras are from the given ones: medians over the photographs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Moved {
    /// Number of photographs.
    pub photographs: usize,
    /// Rotation, in degrees.
    pub degrees: f64,
    /// Translation, in world units.
    pub distance: f64,
    /// Motion of the picture, as a fraction of its longer side.
    pub picture: f64,
    /// Change of the cameras' intrinsics.
    #[serde(default)]
    pub intrinsics: ChangedIntrinsics,
}

impl std::fmt::Display for Moved {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "poses of {} refined: median change {:.3}°, {:.3e} world units, {:.2} % of a picture; focal length {:+.2} %, principal point by \
             {:.2} % of a picture, k1 {:+.4}",
            count(self.photographs, "photograph"),
            self.degrees,
            self.distance,
            100.0 * self.picture,
            100.0 * self.intrinsics.focal,
            100.0 * self.intrinsics.principal,
            self.intrinsics.k1
        )
    }
}

/// Aligned test views, measured on the right half of their pictures.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Aligned {
    /// Number of views.
    pub views: usize,
    /// Mean PSNR with the given poses, in dB.
    pub given: f64,
    /// Mean PSNR with the poses that fit the left half best, in dB.
    pub aligned: f64,
}

impl std::fmt::Display for Aligned {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Self { views, given, aligned } = self;
        let of = count(*views, "test view");
        write!(
            f,
            "right halves of {of}: {given:.2} dB with the given poses, {aligned:.2} dB with poses aligned on the left halves"
        )
    }
}

impl Poses {
    /// Creates the poses of `views` as given, relative to the centre of the box. Returns `None` unless the
    /// configuration refines poses.
    pub fn new(config: &Config, views: &ViewSet) -> Option<Self> {
        if config.train.cameras == CameraPoses::Fixed {
            return None;
        }
        let (centred, centre) = config.centred();
        let space = Space::new(&centred.scene);
        let mut given: Vec<Option<Given>> = Vec::new();
        let mut all = Vec::new();
        for (view, photograph) in views.views.iter().zip(photographs(views)) {
            let camera = Camera { origin: view.camera.origin - centre, ..view.camera };
            let photograph = photograph as usize;
            given.resize(given.len().max(photograph + 1), None);
            given[photograph].get_or_insert_with(|| Given {
                name: view.name.clone(),
                camera,
                preconditioner: Preconditioner::of_pose(&camera, &space),
            });
            all.push((camera, photograph));
        }
        let given: Vec<Given> = given.into_iter().flatten().collect();
        let intrinsics =
            SharedIntrinsics::new(given.iter().map(|given| (given.camera.intrinsics, given.camera.rotation)));
        Some(Self { corrections: Lagged::new(given.len()), given, views: all, intrinsics, free: false })
    }

    /// Lets each camera move independently of the others, with its intrinsics as given. This is for a model that does
    /// not change, which keeps the scene in its place.
    pub(crate) fn set_free(&mut self) {
        self.free = true;
    }

    /// Returns the learning rate at `progress` in [0, 1]; `schedule` is the networks' learning rate relative to its
    /// initial value. The rate is zero in the first half of `optimizer.camera_delay`, and rises along a quarter of a
    /// sine in the second half.
    pub fn rate(config: &OptimizerConfig, schedule: f64, progress: f64) -> f64 {
        let half = 0.5 * config.camera_delay;
        let risen = if progress < half { 0.0 } else { ((progress - half) / half.max(1e-9)).min(1.0) };
        config.camera_rate * schedule * (std::f64::consts::FRAC_PI_2 * risen).sin()
    }

    /// Returns the current cameras of all views of the training set, in their order, relative to the centre of the box.
    pub fn cameras(&self) -> Vec<Camera> {
        let motions: Vec<Motion> = (0..self.given.len()).map(|i| self.motion(i)).collect();
        let changed = self.intrinsics.changed();
        let camera = |(camera, photograph): &(Camera, usize)| {
            moved(camera, &motions[*photograph], &changed[*photograph])
        };
        self.views.iter().map(camera).collect()
    }

    /// Returns the poses that training has found so far; `centre` is the centre of the box.
    pub fn refined(&self, centre: DVec3) -> Refined {
        let changed = self.intrinsics.changed();
        let camera = |(i, given): (usize, &Given)| {
            let camera = moved(&given.camera, &self.motion(i), &changed[i]);
            (given.name.clone(), Camera { origin: camera.origin + centre, ..camera })
        };
        Refined {
            cameras: self.given.iter().enumerate().map(camera).collect(),
            intrinsics: self.intrinsics.refined(),
            moved: self.moved(),
        }
    }

    /// Replaces the motions of the photographs' cameras: one per photograph, in the order of [`photographs`].
    pub fn set(&mut self, motions: &[Motion]) {
        for ((value, given), motion) in self.corrections.values.iter_mut().zip(&self.given).zip(motions) {
            *value = given.preconditioner.parameters(*motion).map(|value| value as f32);
        }
    }

    /// Replaces the change of every camera's intrinsics.
    pub fn set_intrinsics(&mut self, change: Change) {
        self.intrinsics.set(change);
    }

    /// Returns how far the cameras are from the given ones.
    fn moved(&self) -> Moved {
        let median = |of: &dyn Fn(usize) -> f64| {
            let mut all: Vec<f64> = (0..self.given.len()).map(of).collect();
            all.sort_by(f64::total_cmp);
            all.get(all.len() / 2).copied().unwrap_or_default()
        };
        let length = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>().sqrt();
        Moved {
            photographs: self.given.len(),
            degrees: median(&|i| length(&self.motion(i)[..3]).to_degrees()),
            distance: median(&|i| length(&self.motion(i)[3..])),
            picture: median(&|i| length(&self.corrections.values[i].map(f64::from))),
            intrinsics: self.intrinsics.moved(),
        }
    }

    /// Returns the gradient of a step's mean loss with respect to the motions of the photographs' cameras: one element
    /// per photograph, in the order of [`photographs`].
    pub fn by_motions(&self, step: &StepResult) -> Vec<Motion> {
        let by_world = self.by_world(step).into_iter().enumerate();
        by_world.map(|(i, by)| self.given[i].by_motion(&self.motion(i), by)).collect()
    }

    /// Returns the gradient of a step's mean loss with respect to the changes of each camera's intrinsics, in the order
    /// of [`Refined::intrinsics`].
    pub fn by_intrinsics(&self, step: &StepResult) -> Vec<Change> {
        self.intrinsics.by_changes(step)
    }

    /// Returns the gradient of a step's mean loss with respect to a translation of each camera in the world's axes and
    /// a rotation around the world's origin.
    fn by_world(&self, step: &StepResult) -> Vec<[f64; 6]> {
        let weight = step.sums.weight;
        let mean = |i: usize| match step.cameras.get(i) {
            Some([first @ .., _, _, _, _, _, _]) if weight > 0.0 => first.map(|sum| sum / weight),
            _ => [0.0; 6],
        };
        (0..self.given.len()).map(mean).collect()
    }

    /// Returns the current motion of camera `i`.
    fn motion(&self, i: usize) -> Motion {
        self.given[i].preconditioner.change(self.corrections.values[i].map(f64::from))
    }

    /// Queues the gradient of `step`, the result of the next step in order.
    pub(crate) fn take(&mut self, step: &StepResult) {
        let by_world = self.by_world(step).into_iter();
        self.corrections.take(by_world.map(|by| by.map(|by| by as f32)).collect());
        if !self.free {
            self.intrinsics.take(step);
        }
    }

    /// Applies the gradients that are due ([`Lagged::due`]). Returns whether any camera may have moved.
    pub(crate) fn advance(
        &mut self,
        config: &OptimizerConfig,
        rate: f64,
        steps: u64,
        in_transit: usize,
    ) -> bool {
        let mut moved = false;
        while let Some((step, mut gradient)) = self.corrections.due(steps, in_transit) {
            // Queued derivatives are in the world's axes and are converted here, with the current motions: because of a
            // checkpoint they may have arrived earlier, when the motions were still different.
            for (i, gradient) in gradient.iter_mut().enumerate() {
                let given = &self.given[i];
                let by_motion = given.by_motion(&self.motion(i), gradient.map(f64::from));
                *gradient = given.preconditioner.gradient(by_motion).map(|by| by as f32);
            }
            self.corrections.apply(config, rate, step, &gradient);
            let values = &mut self.corrections.values;
            if !self.free {
                centre(&self.given, values);
            }
            values.iter_mut().for_each(shorten);
            moved = true;
        }
        if !self.free {
            self.intrinsics.advance(config, rate, steps, in_transit);
        }
        moved
    }

    /// Adds the tensors from which training resumes: the poses' tensors, of shape [photographs, 6], and the intrinsics'
    /// tensors.
    pub(crate) fn to_tensors(&self, file: &mut TensorFile) {
        self.corrections.to_tensors(PREFIX, file);
        self.intrinsics.to_tensors(file);
    }

    /// Reads the state from a checkpoint of a run on the same number of photographs; `name` names the checkpoint in
    /// errors.
    pub(crate) fn restored(&self, file: &TensorFile, name: &str) -> Result<Self> {
        Ok(Self {
            corrections: self.corrections.restored(PREFIX, file, name)?,
            intrinsics: self.intrinsics.restored(file, name)?,
            ..self.clone()
        })
    }
}

/// Subtracts the motion that all cameras share: the mean of their motions in the axes of the world, and the growth of
/// their distances to their centroid, which is equivalent to scaling the scene.
fn centre(given: &[Given], values: &mut [[f32; 6]]) {
    let count = given.len().max(1) as f64;
    let world = |(given, value): (&Given, &[f32; 6])| {
        let motion = given.preconditioner.change(value.map(f64::from));
        [&motion[..3], &motion[3..]].map(|part| given.camera.rotation * DVec3::from_slice(part))
    };
    let motions: Vec<[DVec3; 2]> = given.iter().zip(&*values).map(world).collect();
    let mean = [0, 1].map(|part| motions.iter().map(|motion| motion[part]).sum::<DVec3>() / count);
    let middle = given.iter().map(|given| given.camera.origin).sum::<DVec3>() / count;
    let arms = || given.iter().map(|given| given.camera.origin - middle);
    let squares: f64 = arms().map(DVec3::length_squared).sum();
    let along: f64 = arms().zip(&motions).map(|(arm, [_, shift])| arm.dot(*shift - mean[1])).sum();
    let growth = if squares > 0.0 { along / squares } else { 0.0 };
    let arms: Vec<DVec3> = arms().collect();
    for (((given, value), [turn, shift]), arm) in given.iter().zip(values).zip(motions).zip(arms) {
        let own = [turn - mean[0], shift - mean[1] - growth * arm];
        let own = own.map(|part| given.camera.rotation.transpose() * part);
        *value = given.preconditioner.parameters(joined(own)).map(|value| value as f32);
    }
}

/// Returns a camera after a motion in its own axes, with changed intrinsics.
fn moved(camera: &Camera, motion: &Motion, changed: &ChangedCamera) -> Camera {
    Camera {
        intrinsics: changed.at(&camera.intrinsics),
        rotation: camera.rotation * turn(motion),
        origin: camera.origin + camera.rotation * DVec3::from_slice(&motion[3..]),
    }
}

/// Returns the rotation of a motion.
fn turn(motion: &Motion) -> DMat3 {
    DMat3::from_quat(DQuat::from_scaled_axis(DVec3::from_slice(&motion[..3])))
}

fn joined([first, last]: [DVec3; 2]) -> Motion {
    [first.x, first.y, first.z, last.x, last.y, last.z]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Intrinsics, Scale, View, engine::batch::StepSums};

    /// Returns three cameras around the origin.
    fn views() -> ViewSet {
        let camera =
            |origin| Camera::look_at(Intrinsics::from_angle(40, 30, 0.8), origin, DVec3::ZERO, DVec3::Z);
        let origins = [DVec3::new(3.0, 0.5, 1.0), DVec3::new(-1.0, 3.0, 0.2), DVec3::new(0.3, -2.0, -2.0)];
        let view = |(i, origin): (usize, DVec3)| View {
            name: i.to_string(),
            camera: camera(origin),
            offset: 1200 * i,
        };
        ViewSet {
            depths: Vec::new(),
            views: origins.into_iter().enumerate().map(view).collect(),
            pixels: vec![[255; 4]; 3600].into(),
            alpha: crate::Alpha::Straight,
            scales: vec![Scale { factor: 1, weight: 1.0, views: 0..3, pixels: 0..3600 }],
        }
    }

    fn configuration() -> Config {
        let mut config = Config::default();
        config.train.cameras = CameraPoses::Refine;
        // The box is away from the world's origin, so that the poses' frame differs from the world's.
        (config.scene.aabb_min, config.scene.aabb_max) = ([-1.0, -0.5, -2.0], [2.0, 1.5, 1.0]);
        config
    }

    const MOTIONS: [Motion; 3] = [
        [0.02, -0.01, 0.03, 0.04, -0.02, 0.01],
        [-0.01, 0.02, 0.01, -0.03, 0.01, 0.02],
        [0.01, 0.01, -0.02, 0.02, 0.03, -0.01],
    ];

    #[test]
    fn fixed_poses_are_none() {
        assert_eq!(Poses::new(&Config::default(), &views()), None);
    }

    #[test]
    fn motions_are_in_the_axes_of_their_cameras() {
        let mut poses = Poses::new(&configuration(), &views()).unwrap();
        let (_, centre) = configuration().centred();
        let intrinsics = ChangedIntrinsics { cameras: 1, ..ChangedIntrinsics::default() };
        assert_eq!(poses.refined(centre).moved, Moved { photographs: 3, intrinsics, ..Moved::default() });
        poses.set(&MOTIONS);
        for ((name, camera), (view, motion)) in
            poses.refined(centre).cameras.iter().zip(views().views.iter().zip(MOTIONS))
        {
            assert_eq!(*name, view.name);
            let shift = view.camera.rotation.transpose() * (camera.origin - view.camera.origin);
            let turn = view.camera.rotation.transpose() * camera.rotation;
            let turn = DQuat::from_mat3(&turn).to_scaled_axis();
            assert!((shift - DVec3::from_slice(&motion[3..])).length() < 1e-6, "{shift}");
            assert!((turn - DVec3::from_slice(&motion[..3])).length() < 1e-6, "{turn}");
        }
    }

    /// Checks the gradient against difference quotients of the loss pull·(a point fixed to camera i). Its derivatives
    /// follow from a force and a torque.
    #[test]
    fn the_gradient_is_the_slope_by_each_motion() {
        let config = configuration();
        let mut poses = Poses::new(&config, &views()).unwrap();
        poses.set(&MOTIONS);
        // A point fixed to each camera, in the camera's axes, and the force that pulls it.
        let (local, pull) = (DVec3::new(0.3, -0.2, -2.0), DVec3::new(0.7, -1.1, 0.4));
        let loss = |poses: &Poses, i: usize| {
            let camera = poses.cameras()[i];
            pull.dot(camera.origin + camera.rotation * local)
        };
        let pulled = |camera: &Camera| {
            let torque = (camera.origin + camera.rotation * local).cross(pull);
            let [p, t] = [4.0 * pull, 4.0 * torque];
            [p.x, p.y, p.z, t.x, t.y, t.z, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
        };
        let sums = StepSums { weight: 4.0, ..StepSums::default() };
        let step = StepResult {
            sums,
            cameras: poses.cameras().iter().map(pulled).collect(),
            ..StepResult::default()
        };
        let found = poses.by_motions(&step);
        let h = 1e-3;
        for (i, found) in found.iter().enumerate() {
            for (k, &by) in found.iter().enumerate() {
                let at = |by: f64| {
                    let mut motions = MOTIONS;
                    motions[i][k] += by;
                    let mut poses = poses.clone();
                    poses.set(&motions);
                    loss(&poses, i)
                };
                let slope = (at(h) - at(-h)) / (2.0 * h);
                // The gradient treats rotations as small: its error is half of the angle, which is 2 degrees here.
                assert!((by - slope).abs() < 0.05, "camera {i}, {k}: {by}, not {slope}");
            }
        }
    }

    #[test]
    fn steps_lower_the_loss_keep_the_mean_and_survive_a_checkpoint() {
        let mut config = configuration();
        config.optimizer.camera_rate = 1e-3;
        let mut poses = Poses::new(&config, &views()).unwrap();
        let sums = StepSums { weight: 1.0, ..StepSums::default() };
        let mut pulls = vec![[0.0; 12]; 3];
        (pulls[0][0], pulls[1][1], pulls[1][5]) = (1.0, -2.0, 1.0);
        let step = StepResult { sums, cameras: pulls, ..StepResult::default() };
        for i in 0..4 {
            poses.take(&step);
            poses.advance(&config.optimizer, 1e-3, i + 1, 0);
        }
        let found = poses.cameras();
        let shift = |i: usize| found[i].origin - poses.given[i].camera.origin;
        assert!(shift(0).x < -1e-5 && shift(1).y > 1e-5, "{} {}", shift(0), shift(1));
        assert!((shift(0) + shift(1) + shift(2)).length() < 1e-7);
        let middle = poses.given.iter().map(|given| given.camera.origin).sum::<DVec3>() / 3.0;
        let along: f64 = (0..3).map(|i| (poses.given[i].camera.origin - middle).dot(shift(i))).sum();
        assert!(along.abs() < 1e-7, "{along}");
        let mut file = TensorFile::default();
        poses.to_tensors(&mut file);
        let restored = Poses::new(&config, &views()).unwrap().restored(&file, "checkpoint").unwrap();
        assert_eq!(restored, poses);
    }

    #[test]
    fn no_camera_moves_its_picture_further_than_a_tenth() {
        let mut value = [0.3_f32, 0.0, -0.4, 0.0, 0.0, 0.0];
        shorten(&mut value);
        assert!((value[0] - 0.06).abs() < 1e-6 && (value[2] + 0.08).abs() < 1e-6, "{value:?}");
        let mut small = [0.01_f32; 6];
        shorten(&mut small);
        assert_eq!(small, [0.01; 6]);
    }

    #[test]
    fn the_learning_rate_waits_and_rises() {
        let config = OptimizerConfig { camera_rate: 2e-4, camera_delay: 0.2, ..Config::default().optimizer };
        let rate = |progress| Poses::rate(&config, 0.5, progress);
        assert_eq!([rate(0.0), rate(0.05), rate(0.1)], [0.0; 3]);
        assert!(rate(0.15) > 0.5e-4 && rate(0.15) < 1e-4);
        assert!((rate(0.2) - 1e-4).abs() < 1e-12 && rate(1.0) == rate(0.2));
    }
}
