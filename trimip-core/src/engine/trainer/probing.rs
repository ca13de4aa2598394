//! Loss and gradients without a step. Training does not need them: tests compare them with finite differences and with
//! other backends.

use super::Trainer;
use crate::{
    Backend, Result,
    engine::{
        backend::{Loss, Sampler},
        batch::{SampleDraw, StepResult, StepSums},
        intrinsics::Change,
        preconditioner::Motion,
    },
};
use std::sync::Arc;

impl<B: Backend> Trainer<B> {
    /// Replaces the log-gains (RGB) of each training photograph. Does nothing without `loss.exposure`.
    pub fn set_log_gains(&mut self, values: &[[f32; 3]]) {
        if let Some(exposures) = &mut self.exposures {
            exposures.set(values);
            self.loaded.stages.loss.set_gains(&exposures.gains());
        }
    }

    /// Returns loss and gradient of the current parameters on the rays of `rays` pixels of step `step`; does not change
    /// the parameters. The gradient has the form of [`parameters`](Self::parameters) and is divided by the sum of the
    /// weights.
    ///
    /// # Errors
    /// When the device fails.
    pub fn loss_and_gradient(&mut self, step: u64, rays: u32) -> Result<(StepSums, Vec<f32>)> {
        let StepResult { sums, .. } = self.result_of(step, rays, None)?;
        Ok((sums, self.mean_gradient(&sums)))
    }

    /// Works like [`loss_and_gradient`](Self::loss_and_gradient), but draws samples by the threshold `threshold`
    /// ([`SampleDraw`]) with the random numbers of step `draw`.
    ///
    /// # Errors
    /// When the device fails.
    pub fn loss_and_drawn_gradient(
        &mut self,
        step: u64,
        rays: u32,
        threshold: f64,
        draw: u64,
    ) -> Result<(StepSums, Vec<f32>)> {
        let draw = self.draw_at(draw, threshold);
        let StepResult { sums, .. } = self.result_of(step, rays, Some(draw))?;
        Ok((sums, self.mean_gradient(&sums)))
    }

    /// Returns the gradient divided by the sum of the weights.
    fn mean_gradient(&self, sums: &StepSums) -> Vec<f32> {
        let gradient = self.device().read(&self.gradient);
        gradient.iter().map(|g| (f64::from(*g) / sums.weight) as f32).collect()
    }

    /// Works like [`loss_and_gradient`](Self::loss_and_gradient), but returns the gradient with respect to the
    /// log-gains (RGB) of each photograph.
    ///
    /// # Errors
    /// When the device fails.
    pub fn loss_and_exposure_gradient(&mut self, step: u64, rays: u32) -> Result<(StepSums, Vec<[f32; 3]>)> {
        let result = self.result_of(step, rays, None)?;
        let gradient = self.exposures.as_ref().map(|exposures| exposures.gradient(&result));
        Ok((result.sums, gradient.unwrap_or_default()))
    }

    /// Replaces the motions of the photographs' cameras, one per photograph in the order of
    /// [`photographs`](crate::engine::exposure::photographs): a rotation (radians) and a translation (world units) of
    /// each camera in its own axes. Does nothing unless poses are refined.
    pub fn set_poses(&mut self, motions: &[Motion]) {
        if let Some(poses) = &mut self.poses {
            poses.set(motions);
            self.loaded.stages.sampler.set_cameras(&poses.cameras());
        }
    }

    /// Works like [`loss_and_gradient`](Self::loss_and_gradient), but returns the gradient with respect to motions of
    /// the photographs' cameras, in the form of [`set_poses`](Self::set_poses).
    ///
    /// # Errors
    /// When the device fails.
    pub fn loss_and_pose_gradient(&mut self, step: u64, rays: u32) -> Result<(StepSums, Vec<Motion>)> {
        let result = self.result_of(step, rays, None)?;
        let gradient = self.poses.as_ref().map(|poses| poses.by_motions(&result));
        Ok((result.sums, gradient.unwrap_or_default()))
    }

    /// Replaces the change of every camera's intrinsics. Does nothing unless cameras are refined.
    pub fn set_intrinsics(&mut self, change: Change) {
        if let Some(poses) = &mut self.poses {
            poses.set_intrinsics(change);
            self.loaded.stages.sampler.set_cameras(&poses.cameras());
        }
    }

    /// Works like [`loss_and_gradient`](Self::loss_and_gradient), but returns the gradient with respect to changes of
    /// each camera's intrinsics. ([`set_intrinsics`](Self::set_intrinsics) takes one change for all cameras.)
    ///
    /// # Errors
    /// When the device fails.
    pub fn loss_and_intrinsics_gradient(&mut self, step: u64, rays: u32) -> Result<(StepSums, Vec<Change>)> {
        let result = self.result_of(step, rays, None)?;
        let gradient = self.poses.as_ref().map(|poses| poses.by_intrinsics(&result));
        Ok((result.sums, gradient.unwrap_or_default()))
    }

    /// Runs the forward and backward passes over `rays` pixels of step `step`; afterwards the gradient is complete.
    fn result_of(&mut self, step: u64, rays: u32, draw: Option<SampleDraw>) -> Result<StepResult> {
        self.state.totals.step = step;
        let backend = Arc::clone(&self.loaded.backend);
        let receipt = backend.install(|| {
            self.gradients(rays, draw.as_ref());
            let receipt = backend.post(&self.partials);
            self.loaded.stages.reduce(&mut self.partials, &self.loaded.parameters, &mut self.gradient);
            receipt
        });
        backend.redeem(receipt)
    }
}
