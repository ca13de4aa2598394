//! Changes in the course of a run: schedules of the stages, and parameters that grow.

use super::{Trainer, rays::LEAST_RAYS};
use crate::{
    Backend, Encoder, Optimizer, Renderer, Result, Slot,
    engine::backend::{Loss, Occupancy, Sampler},
    field::{encoders, params::ActiveRange},
    geometry::occupancy::OUTSIDE,
    math::bits,
    scene::known_space::Confinement,
};

impl<B: Backend> Trainer<B> {
    /// Updates every stage to the schedules at `progress`. Moments grow with their parameters. If the marching step
    /// shrinks or pixels get more cones, each pixel has more samples, so the batch gets fewer pixels.
    pub(super) fn set_progress(&mut self, progress: f64) -> Result<()> {
        self.loaded.stages.renderer.set_progress(progress);
        self.loaded.stages.sampler.set_progress(progress);
        self.loaded.stages.loss.set_progress(progress);
        let cones_per_pixel = self.loaded.stages.sampler.scale_weights().cones_per_pixel();
        let spacing = self.loaded.config.renderer.step_scale.at(progress) / cones_per_pixel;
        if self.state.spacing > 0.0 && self.state.spacing != spacing {
            let ratio = spacing / self.state.spacing;
            self.state.rays_per_step = ((f64::from(self.state.rays_per_step) * ratio) as u32).max(LEAST_RAYS);
            self.state.marched_per_ray /= ratio as f32;
        }
        self.state.spacing = spacing;
        let sees_directions = progress >= self.loaded.config.field.direction_delay;
        if sees_directions != self.trains_directions {
            self.trains_directions = sees_directions;
            self.restrict();
        }
        let stage = encoders::of(&self.loaded.config).stage(&self.loaded.config, progress);
        if stage >= self.state.stage {
            return Ok(());
        }
        let restarts = encoders::of(&self.loaded.config).restarted(&self.loaded.config, progress).is_some();
        if restarts {
            self.state.moments_since = self.state.totals.step;
        }
        self.gather_moments()?;
        let mut values = self.parameters();
        self.grow(&mut values, stage);
        self.loaded.backend.write(&mut self.loaded.parameters, &values);
        for moment in 0..2 {
            let mut values = self.device().read(self.loaded.stages.optimizer.moments()[moment]);
            if restarts {
                values.fill(0.0);
            } else {
                self.grow(&mut values, stage);
            }
            let buffer = &mut self.loaded.stages.optimizer.moments_mut()[moment];
            self.loaded.backend.write(buffer, &values);
        }
        self.enter(stage);
        self.loaded.refresh();
        Ok(())
    }

    /// Applies the confinement at `progress` to the occupancy grid. A confinement is never tightened again, because
    /// extending a run lowers its progress.
    pub(super) fn follow_confinement(&mut self, progress: f64) {
        let next = Confinement::at(&self.loaded.config, progress);
        if next > self.state.confinement {
            self.confine(next);
        }
    }

    /// Updates the error map with the errors of the last steps.
    pub(super) fn follow_errors(&mut self, progress: f64) -> Result<()> {
        self.gather_errors()?;
        let fraction = self.loaded.config.train.error_map.at(progress);
        let sampler = &mut self.loaded.stages.sampler;
        if let Some(mut map) = sampler.policy().error_map().cloned() {
            map.update(&std::mem::take(&mut self.errors), fraction);
            sampler.set_error_map(map);
        }
        Ok(())
    }

    /// Collects, on every rank, the errors that all ranks have observed.
    pub(super) fn gather_errors(&mut self) -> Result<()> {
        let sampler = &mut self.loaded.stages.sampler;
        let Some(map) = sampler.policy().error_map() else { return Ok(()) };
        self.errors.resize(map.len(), [0; 2]);
        let errors = self.exchange.errors(sampler.take_errors())?;
        let added = errors.as_flattened().iter();
        self.errors.as_flattened_mut().iter_mut().zip(added).for_each(|(sum, error)| *sum += error);
        Ok(())
    }

    /// Empties the cells that cannot be occupied. Cells that may be occupied again stay empty until a refresh queries
    /// them.
    pub(super) fn confine(&mut self, confinement: Confinement) {
        self.state.confinement = confinement;
        let occupancy = &mut self.loaded.stages.occupancy;
        let (mut densities, mut bits) = (occupancy.densities(), occupancy.bits());
        for (cell, density) in densities.iter_mut().enumerate() {
            if self.known_space.as_ref().is_none_or(|known| known.allows(confinement, cell)) {
                *density = density.max(0.0);
            } else {
                *density = OUTSIDE;
                bits::clear(&mut bits, cell);
            }
        }
        occupancy.restore(&bits, Some(&densities));
    }

    /// Collects, on every rank, the optimiser's moments of all ranks.
    pub(super) fn gather_moments(&mut self) -> Result<()> {
        self.exchange.moments(&self.loaded.backend, &mut self.loaded.stages)
    }

    /// Grows the values of the growing slots to `stage`; `values` is flat and holds all slots.
    pub(super) fn grow(&self, values: &mut [f32], stage: u32) {
        let (config, _) = self.loaded.config.centred();
        for slot in self.layout().slots.iter().filter(|slot| slot.grows) {
            encoders::of(&config).grow(
                &config,
                slot,
                &mut values[slot.range.clone()],
                self.state.stage,
                stage,
            );
        }
    }

    /// Switches encoder and optimiser to the parameters of `stage`.
    pub(super) fn enter(&mut self, stage: u32) {
        self.state.stage = stage;
        self.loaded.stages.encoder.grow(stage);
        self.restrict();
    }

    /// Restricts the optimiser to the parameters in use: those of the stage, without the weights of the view direction
    /// until `field.direction_delay` ends.
    fn restrict(&mut self) {
        let stage = self.state.stage;
        let encoder = encoders::of(&self.loaded.config);
        let (config, _) = self.loaded.config.centred();
        let part = |slot: &Slot| match slot.grows {
            true => ActiveRange {
                range: slot.range.start..slot.range.start + encoder.length(&config, slot, stage),
                sparsity: encoder.sparsity(&config, slot, stage),
            },
            false => ActiveRange { range: slot.range.clone(), sparsity: 0.0 },
        };
        let mut parts: Vec<_> = self.layout().slots.iter().map(part).collect();
        if !self.trains_directions
            && let Some(weights) = self.layout().direction_weights(&config)
            && let Some(part) = parts.iter_mut().find(|part| part.range.start == weights.start)
        {
            part.range.start = weights.end;
        }
        self.loaded.stages.optimizer.restrict(&parts);
    }
}
