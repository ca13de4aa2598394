//! Intrinsics of photographs, for `train.cameras = "refine"`: training also changes the focal length, the principal
//! point and the first radial coefficient of each camera. Photographs with equal intrinsics share one camera. Training
//! changes only perspective cameras, and k₁ only if the lens has distortion: photographs without distortion were
//! undistorted or rendered.
//!
//! The changes are preconditioned ([`Preconditioner`]), trained like the poses, and not part of a model.

use crate::{
    Intrinsics, Result,
    config::OptimizerConfig,
    engine::{
        lagged::Lagged,
        preconditioner::{Preconditioner, places, shorten},
        step_result::{CameraSums, StepResult},
    },
    field::tensors::TensorFile,
    geometry::{lens::Lens, projections::Model},
};
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

/// Prefix of the names of the intrinsics' tensors in checkpoints.
const PREFIX: &str = "poses.intrinsics.";

/// A change of intrinsics: [logarithm of the factor of both focal lengths, shift of the principal point in x and y in
/// focal lengths, increase of k₁].
pub type Change = [f64; 4];

/// Returns the intrinsics `given`, of any scale of the photograph, after a change.
pub fn changed(given: &Intrinsics, change: &Change) -> Intrinsics {
    ChangedCamera::new(given, *change).at(given)
}

/// A changed camera. Computing its lens takes longer than everything else, so the lens is computed once and used at
/// every scale of each photograph.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ChangedCamera {
    change: Change,
    lens: Lens,
}

impl ChangedCamera {
    fn new(given: &Intrinsics, change: Change) -> Self {
        Self { change, lens: given.lens.with_more_k1(change[3]) }
    }

    /// Returns the changed intrinsics of a photograph whose given intrinsics, at any scale, are `given`.
    pub fn at(&self, given: &Intrinsics) -> Intrinsics {
        let [focal, x, y, _] = self.change;
        Intrinsics {
            fx: given.fx * focal.exp(),
            fy: given.fy * focal.exp(),
            cx: given.cx + given.fx * x,
            cy: given.cy + given.fy * y,
            lens: self.lens,
            ..*given
        }
    }
}

/// A camera that one or more photographs share.
#[derive(Clone, Debug, PartialEq)]
struct Shared {
    /// Given intrinsics at the finest scale.
    given: Intrinsics,
    preconditioner: Preconditioner<4>,
}

impl Shared {
    fn new(given: Intrinsics) -> Self {
        let (width, height) = (f64::from(given.width), f64::from(given.height));
        let lens = &given.lens;
        let longer = width.max(height);
        let bends = !lens.is_straight();
        let rows = places().filter_map(|[x, y]| {
            let at = given.normalised([x * width, y * height]);
            let [u, v] = if bends { lens.unbend(at)?.at } else { at };
            let cubed = |along: f64| if bends { along * (u * u + v * v) } else { 0.0 };
            let [fx, fy] = [given.fx, given.fy].map(|focal| focal / longer);
            Some([[fx * at[0], fx, 0.0, fx * cubed(u)], [fy * at[1], 0.0, fy, fy * cubed(v)]])
        });
        Self { given, preconditioner: Preconditioner::of(rows.flatten()) }
    }

    /// Returns the derivatives of a loss with respect to this camera's change, for a photograph with the camera axes
    /// `axes` and the camera sums `of`. The direction of a fixed pixel moves opposite to each change. A distorted lens
    /// does not move all directions equally; the derivatives neglect this.
    fn by_change(&self, axes: &DMat3, of: &CameraSums) -> Change {
        if self.given.lens.model != Model::Perspective {
            return [0.0; 4];
        }
        let [turned, cubed] = [&of[6..9], &of[9..12]].map(DVec3::from_slice);
        let [right, up, ahead] = [axes.x_axis, axes.y_axis, -axes.z_axis];
        let k1 = if self.given.lens.is_straight() { 0.0 } else { ahead.dot(cubed) };
        [ahead.dot(turned), -right.dot(turned), up.dot(turned), k1]
    }
}

/// Intrinsics of all photographs in training.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct SharedIntrinsics {
    cameras: Vec<Shared>,
    /// For each photograph, the index of its camera and the camera's axes as given.
    photographs: Vec<(usize, DMat3)>,
    corrections: Lagged<4>,
}

/// How far refined intrinsics are from the given ones: medians over the cameras.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ChangedIntrinsics {
    /// Number of cameras.
    pub cameras: usize,
    /// Relative change of the focal length.
    pub focal: f64,
    /// Shift of the principal point, as a fraction of the longer side of a picture.
    pub principal: f64,
    /// Change of the first radial coefficient.
    pub k1: f64,
}

impl SharedIntrinsics {
    /// Groups photographs into cameras, given the intrinsics of each photograph's finest view and its camera's axes in
    /// the world.
    pub fn new(photographs: impl IntoIterator<Item = (Intrinsics, DMat3)>) -> Self {
        let mut cameras: Vec<Shared> = Vec::new();
        let mut number = |given: Intrinsics| {
            let known = cameras.iter().position(|camera| camera.given == given);
            known.unwrap_or_else(|| {
                cameras.push(Shared::new(given));
                cameras.len() - 1
            })
        };
        let photographs: Vec<(usize, DMat3)> =
            photographs.into_iter().map(|(given, axes)| (number(given), axes)).collect();
        Self { corrections: Lagged::new(cameras.len()), cameras, photographs }
    }

    /// Returns the current camera of each photograph.
    pub fn changed(&self) -> Vec<ChangedCamera> {
        let camera = |(i, camera): (usize, &Shared)| ChangedCamera::new(&camera.given, self.change(i));
        let cameras: Vec<ChangedCamera> = self.cameras.iter().enumerate().map(camera).collect();
        self.photographs.iter().map(|(camera, _)| cameras[*camera]).collect()
    }

    /// Returns the current change of camera `i`.
    fn change(&self, i: usize) -> Change {
        self.cameras[i].preconditioner.change(self.corrections.values[i].map(f64::from))
    }

    /// Returns the given intrinsics of each camera at its finest scale, and the camera's current change.
    pub fn refined(&self) -> Vec<(Intrinsics, Change)> {
        let camera = |(i, camera): (usize, &Shared)| (camera.given, self.change(i));
        self.cameras.iter().enumerate().map(camera).collect()
    }

    /// Replaces the change of every camera.
    pub fn set(&mut self, change: Change) {
        for (value, camera) in self.corrections.values.iter_mut().zip(&self.cameras) {
            *value = camera.preconditioner.parameters(change).map(|value| value as f32);
        }
    }

    /// Returns how far the intrinsics are from the given ones.
    pub fn moved(&self) -> ChangedIntrinsics {
        let median = |of: &dyn Fn(usize) -> f64| {
            let mut all: Vec<f64> = (0..self.cameras.len()).map(of).collect();
            all.sort_by(f64::total_cmp);
            all.get(all.len() / 2).copied().unwrap_or_default()
        };
        let principal = |i: usize| {
            let (given, [_, x, y, _]) = (&self.cameras[i].given, self.change(i));
            (given.fx * x).hypot(given.fy * y) / f64::from(given.width.max(given.height).max(1))
        };
        ChangedIntrinsics {
            cameras: self.cameras.len(),
            focal: median(&|i| self.change(i)[0].exp_m1()),
            principal: median(&principal),
            k1: median(&|i| self.change(i)[3]),
        }
    }

    /// Returns the gradient of a step's mean loss with respect to the changes of all cameras: one element per camera, in
    /// the order of [`refined`](Self::refined).
    pub fn by_changes(&self, step: &StepResult) -> Vec<Change> {
        let mut sums = vec![[0.0; 4]; self.cameras.len()];
        if step.sums.weight > 0.0 {
            for ((camera, axes), of) in self.photographs.iter().zip(&step.cameras) {
                let by_change = self.cameras[*camera].by_change(axes, of);
                let sums = &mut sums[*camera];
                sums.iter_mut().zip(by_change).for_each(|(sum, by)| *sum += by / step.sums.weight);
            }
        }
        sums
    }

    /// Queues the gradient of `step`, the result of the next step in order.
    pub fn take(&mut self, step: &StepResult) {
        let gradient =
            |(camera, by): (&Shared, Change)| camera.preconditioner.gradient(by).map(|by| by as f32);
        let gradients = self.cameras.iter().zip(self.by_changes(step)).map(gradient).collect();
        self.corrections.take(gradients);
    }

    /// Applies the gradients that are due ([`Lagged::due`]).
    pub fn advance(&mut self, config: &OptimizerConfig, rate: f64, steps: u64, in_transit: usize) {
        while let Some((step, gradient)) = self.corrections.due(steps, in_transit) {
            self.corrections.apply(config, rate, step, &gradient);
            self.corrections.values.iter_mut().for_each(shorten);
        }
    }

    /// Adds the tensors from which training resumes, of shape [cameras, 4].
    pub fn to_tensors(&self, file: &mut TensorFile) {
        self.corrections.to_tensors(PREFIX, file);
    }

    /// Reads the state from a checkpoint of a run with the same number of cameras; `name` names the checkpoint in
    /// errors.
    ///
    /// # Errors
    /// When a tensor is missing, or has another type or shape.
    pub fn restored(&self, file: &TensorFile, name: &str) -> Result<Self> {
        Ok(Self { corrections: self.corrections.restored(PREFIX, file, name)?, ..self.clone() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, engine::batch::StepSums};

    const CHANGE: Change = [0.02, -0.01, 0.015, 0.03];

    fn lens() -> Lens {
        Lens::perspective([-0.05, 0.01, 0.0, 0.0], [0.0; 2], [0.0; 3])
    }

    fn camera(lens: Lens) -> Camera {
        let intrinsics = Intrinsics { lens, ..Intrinsics::from_angle(400, 300, 0.8) };
        Camera::look_at(intrinsics, DVec3::new(3.0, -2.0, 1.5), DVec3::ZERO, DVec3::Z)
    }

    /// Checks that changes commute with scaling: after a change, a pixel at half size still covers the same block of
    /// full-size pixels.
    #[test]
    fn a_change_is_one_for_all_scales() {
        let given = camera(lens()).intrinsics;
        assert_eq!(changed(&given, &[0.0; 4]), given);
        let [one, other] = [changed(&given, &CHANGE).reduced(1), changed(&given.reduced(1), &CHANGE)];
        for (one, other) in
            [one.fx, one.fy, one.cx, one.cy].iter().zip([other.fx, other.fy, other.cx, other.cy])
        {
            assert!((one - other).abs() < 1e-9, "{one} {other}");
        }
        assert!(
            (one.lens.radial[0] - (lens().radial[0] + CHANGE[3])).abs() < 1e-15 && one.lens == other.lens
        );
    }

    /// Checks the derivatives that follow from the camera sums against difference quotients, for a loss that pulls the
    /// directions of two pixels.
    #[test]
    fn the_gradient_is_the_slope_by_each_change() {
        for (lens, tolerance) in [(Lens::default(), 1e-6), (lens(), 0.05)] {
            let camera = camera(lens);
            let shared = SharedIntrinsics::new([(camera.intrinsics, camera.rotation)]);
            let pixels =
                [([37.0, 45.0], DVec3::new(0.3, -1.0, 0.4)), ([350.0, 271.0], DVec3::new(-0.7, 0.2, 0.9))];
            let direction = |camera: &Camera, at: [f64; 2]| camera.cone_at::<f64>(at, 1.0);
            let mut sums = [0.0; 12];
            for (at, pull) in pixels {
                let cone = direction(&camera, at);
                let along = DVec3::from_array(cone.direction);
                let across = cone.cosine * (pull - along.dot(pull) * along);
                let tangent2 = cone.cosine.powi(-2) - 1.0;
                for axis in 0..3 {
                    sums[6 + axis] += across[axis];
                    sums[9 + axis] += tangent2 * across[axis];
                }
            }
            let step = StepResult {
                sums: StepSums { weight: 1.0, ..StepSums::default() },
                cameras: vec![sums],
                ..StepResult::default()
            };
            let found = shared.by_changes(&step)[0];
            let loss = |change: &Change| {
                let camera = Camera { intrinsics: changed(&camera.intrinsics, change), ..camera };
                let pulls = pixels
                    .iter()
                    .map(|(at, pull)| pull.dot(DVec3::from_array(direction(&camera, *at).direction)));
                pulls.sum::<f64>()
            };
            let h = 1e-5;
            for (i, found) in found.iter().enumerate() {
                if i == 3 && lens.is_straight() {
                    assert_eq!(*found, 0.0, "no distortion, no k1");
                    continue;
                }
                let mut change = [0.0; 4];
                change[i] = h;
                let slope = (loss(&change) - loss(&change.map(|part| -part))) / (2.0 * h);
                assert!(
                    (found - slope).abs() < tolerance * slope.abs().max(0.1),
                    "{i}: {found}, not {slope}"
                );
            }
        }
    }

    /// Checks that photographs of one camera share its change, that cameras without gradient and fisheyes keep their
    /// intrinsics, and that a checkpoint restores the state.
    #[test]
    fn equal_intrinsics_are_one_camera() {
        let one = camera(Lens::default());
        let other = Camera { intrinsics: Intrinsics { fx: 300.0, ..one.intrinsics }, ..one };
        let fisheye =
            Camera { intrinsics: Intrinsics { lens: Lens::of(Model::Fisheye), ..one.intrinsics }, ..one };
        let given = || [one, other, one, fisheye].map(|camera| (camera.intrinsics, camera.rotation));
        let mut shared = SharedIntrinsics::new(given());
        let pull: CameraSums = std::array::from_fn(|i| if i < 6 { 0.0 } else { 1.0 + i as f64 });
        let step = StepResult {
            sums: StepSums { weight: 1.0, ..StepSums::default() },
            cameras: vec![pull, [0.0; 12], pull, pull],
            ..StepResult::default()
        };
        let config = crate::Config::default().optimizer;
        for i in 0..4 {
            shared.take(&step);
            shared.advance(&config, 1e-3, i + 1, 0);
        }
        let changes: Vec<Change> = shared.changed().iter().map(|camera| camera.change).collect();
        assert_eq!(changes[0], changes[2]);
        assert!(changes[0][..3].iter().all(|part| part.abs() > 1e-6) && changes[0][3] == 0.0, "{changes:?}");
        assert!(changes[1] == [0.0; 4] && changes[3] == [0.0; 4], "{changes:?}");
        let mut file = TensorFile::default();
        shared.to_tensors(&mut file);
        assert_eq!(SharedIntrinsics::new(given()).restored(&file, "checkpoint").unwrap(), shared);
    }
}
