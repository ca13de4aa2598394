//! Aligns the poses of photographs outside the training set with a model that does not change.

use super::Trainer;
use crate::{
    Backend, Camera, Config, Renderer, Result, Session, ViewSet,
    config::CameraPoses,
    engine::backend::{Occupancy, Sampler},
};
use std::sync::Arc;

/// Number of steps of an alignment.
const STEPS: u64 = 200;

/// Largest number of samples of a step.
const SAMPLES: u32 = 1 << 16;

/// Learning rates at the start and at the end, in the units of `optimizer.camera_rate`.
const RATES: [f64; 2] = [1e-3, 5e-5];

impl<B: Backend> Trainer<B> {
    /// Returns the cameras of the photographs `views`, moved so that the current model shows them best.
    pub(super) fn aligned(&mut self, views: ViewSet) -> Result<Vec<Camera>> {
        let config = settings(&self.loaded.config);
        let model = self.full_model()?;
        let mut other = Self::on(Arc::clone(&self.loaded.backend), &config, views)?;
        if let Some(poses) = &mut other.poses {
            poses.set_free();
        }
        other.enter(0);
        other.loaded.restore_model("model", &model.file, None)?;
        let bits = other.loaded.stages.occupancy.bits();
        other.loaded.stages.occupancy.restore(&bits, Some(&vec![0.0; other.loaded.cells()]));
        other.loaded.stages.renderer.set_progress(1.0);
        other.loaded.stages.sampler.set_progress(1.0);
        other.loaded.refresh();
        let backend = Arc::clone(&other.loaded.backend);
        for step in 0..STEPS {
            backend.install(|| other.align_step(step as f64 / STEPS as f64))?;
        }
        let refined = other.refined().map(|refined| refined.cameras).unwrap_or_default();
        Ok(refined.into_iter().map(|(_, camera)| camera).collect())
    }

    /// Performs one step that changes only the poses.
    fn align_step(&mut self, progress: f64) -> Result<()> {
        self.gradients(self.state.rays_per_step, None);
        let receipt = self.device().post(&self.partials);
        self.loaded.stages.reduce(&mut self.partials, &self.loaded.parameters, &mut self.gradient);
        self.device().submit();
        let result = self.device().redeem(receipt)?;
        self.state.totals.step += 1;
        let spacing = self.state.spacing;
        self.adapt_batch(&result.sums, spacing, 1.0);
        let config = &self.loaded.config.optimizer;
        let rate = RATES[0] * (RATES[1] / RATES[0]).powf(progress);
        let Some(poses) = &mut self.poses else { return Ok(()) };
        poses.take(&result);
        if poses.advance(config, rate, self.state.totals.step, 0) {
            self.loaded.stages.sampler.set_cameras(&poses.cameras());
        }
        Ok(())
    }
}

/// Returns the settings of an alignment: those of the training, changed so that only poses are trained.
fn settings(config: &Config) -> Config {
    let mut config = config.clone();
    config.train.cameras = CameraPoses::Refine;
    config.train.samples_per_step = config.train.samples_per_step.min(SAMPLES);
    config.occupancy.hull = false;
    (config.occupancy.seeded, config.occupancy.cleared) = (0.0, 0.0);
    config
}
