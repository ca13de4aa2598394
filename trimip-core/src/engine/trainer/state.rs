//! Saves and restores the state of a training: models and checkpoints.

use super::{Trainer, sums::Arrival, sums::Pending};
use crate::{
    Advice, Backend, Error, Optimizer, Renderer, Result,
    config::FilePrecision,
    engine::{
        backend::{Loss, Occupancy, Sampler},
        checkpoint::{Checkpoint, OCCUPANCY_DENSITY, TrainState},
        events::progress,
    },
    field::{model::Model, tensors::Tensor},
};

impl<B: Backend> Trainer<B> {
    /// Returns the model at full size, whatever size the model has reached in training.
    pub(super) fn full_model(&mut self) -> Result<Model> {
        let mut values = self.parameters();
        self.grow(&mut values, 0);
        let tensors = self.loaded.tensors(&values);
        self.device().health()?;
        Ok(Model::new(self.loaded.config.clone(), tensors))
    }

    /// Returns the model as its file will hold it. Afterwards the session renders the model of the file, with the
    /// schedules at their end.
    pub(super) fn finished_model(&mut self) -> Result<Model> {
        self.expect_usable()?;
        let model = self.full_model()?.rounded();
        self.loaded.stages.renderer.set_progress(1.0);
        if self.layout().slots.iter().any(|slot| slot.precision != FilePrecision::F32) {
            // The model has full size, even if the run ended before the model had grown to it.
            self.enter(0);
            self.loaded.restore_model("model", &model.file, None)?;
        }
        Ok(model)
    }

    /// Collects the data that a checkpoint needs from other ranks and from the device.
    pub(super) fn gather(&mut self) -> Result<()> {
        self.expect_usable()?;
        self.drain()?;
        self.gather_errors()?;
        self.gather_moments()
    }

    pub(super) fn save_state(&mut self) -> Result<Checkpoint> {
        self.gather()?;
        // No tensor is copied twice, because a run's memory use peaks here, at the moments of a large model.
        let device = self.device();
        let mut file = device.look(&self.loaded.parameters, |values| self.loaded.tensors(values));
        for (suffix, moments) in [".m", ".v"].into_iter().zip(self.loaded.stages.optimizer.moments()) {
            device.look(moments, |values| self.layout().to_tensors(values, suffix, &mut file));
        }
        // Reading the moments has updated the device's count of left-out gradients.
        self.count_left_out();
        let densities = self.loaded.stages.occupancy.densities();
        file.tensors.insert(OCCUPANCY_DENSITY.into(), Tensor::f32(&[densities.len()], densities));
        if let Some(exposures) = &self.exposures {
            exposures.to_tensors(&mut file);
        }
        if let Some(map) = self.loaded.stages.sampler.policy().error_map() {
            map.to_tensors(&self.errors, &mut file);
        }
        if let Some(poses) = &self.poses {
            poses.to_tensors(&mut file);
        }
        self.device().health()?;
        Ok(Checkpoint { config: self.loaded.config.clone(), state: self.state, file })
    }

    pub(super) fn load_state(&mut self, checkpoint: &Checkpoint) -> Result<()> {
        let name = "checkpoint";
        let data = self.state.data;
        let other = data.zip(checkpoint.state.data).and_then(|(ours, theirs)| ours.difference(&theirs));
        if let Some(difference) = other {
            return Err(Error::input(
                "training photographs",
                format!("differ from those that the run began with: {difference}"),
                Advice::AnyOf(vec!["restore them".into(), Advice::StartOver, Advice::OtherFolder]),
            ));
        }
        let densities = checkpoint.file.f32(name, OCCUPANCY_DENSITY, &[self.loaded.cells()])?;
        let first = self.layout().from_tensors(&checkpoint.file, name, ".m")?;
        let second = self.layout().from_tensors(&checkpoint.file, name, ".v")?;
        let exposures =
            self.exposures.as_ref().map(|new| new.restored(&checkpoint.file, name)).transpose()?;
        let poses = self.poses.as_ref().map(|new| new.restored(&checkpoint.file, name)).transpose()?;
        let map = self.loaded.stages.sampler.policy().error_map();
        let map = map.map(|new| new.restored(&checkpoint.file, name)).transpose()?;
        self.loaded.restore_model(name, &checkpoint.file, Some(densities))?;
        if let Some(exposures) = exposures {
            self.loaded.stages.loss.set_gains(&exposures.gains());
            self.exposures = Some(exposures);
        }
        if let Some(poses) = poses {
            self.loaded.stages.sampler.set_cameras(&poses.cameras());
            self.poses = Some(poses);
        }
        if let Some((map, errors)) = map {
            self.loaded.stages.sampler.set_error_map(map);
            self.loaded.stages.sampler.take_errors();
            self.errors = errors;
        }
        for (buffer, values) in self.loaded.stages.optimizer.moments_mut().into_iter().zip([first, second]) {
            self.loaded.backend.write(buffer, &values);
        }
        self.spoilt = None;
        self.state = TrainState { data, ..checkpoint.state };
        // Reading the moments updates the device's count of the gradients that steps before the restore left out.
        let _ = self.loaded.stages.optimizer.moments();
        self.left_out_before =
            self.state.totals.non_finite.wrapping_sub(self.loaded.stages.optimizer.non_finite());
        let counted = |(spacing, sums)| Pending { spacing, sums: Arrival::Counted(sums) };
        self.pending = self.state.pending.into_iter().flatten().map(counted).collect();
        self.enter(self.state.stage);
        self.loaded.refresh();
        let progress = progress(&self.loaded.config, &self.state.totals);
        // A backend with less lag than the one that wrote the checkpoint would have used these sums already.
        while self.pending.len() > B::LAG {
            let Some((spacing, sums)) = self.oldest_sums()? else { break };
            self.adapt_batch(&sums, spacing, progress);
        }
        self.loaded.stages.renderer.set_progress(progress);
        self.loaded.stages.sampler.set_progress(progress);
        self.loaded.stages.loss.set_progress(progress);
        Ok(())
    }
}
