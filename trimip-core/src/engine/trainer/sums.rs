//! Sums of the last steps. A device runs ahead of the host, so the sums of a step are used some steps later. The lag
//! is always the same number of steps, whatever the timing.

use super::Trainer;
use crate::{
    Backend, Error, Result,
    engine::{
        backend::{Loss, Sampler},
        batch::{MOST_PENDING, StepSums},
        poses::Poses,
    },
};

/// Sums of a step that are not yet used.
pub(super) struct Pending<B: Backend> {
    /// The step's spacing, see [`TrainState`](crate::engine::checkpoint::TrainState).
    pub spacing: f64,
    pub sums: Arrival<B>,
}

/// The state of a step's sums.
pub(super) enum Arrival<B: Backend> {
    /// In transit from the device.
    Posted(B::Receipt),
    /// Already read and added to the totals, because a checkpoint was taken in the meantime.
    Counted(StepSums),
}

impl<B: Backend> Trainer<B> {
    /// Adds the sums of a step to the totals.
    fn count(&mut self, sums: &StepSums) {
        let totals = &mut self.state.totals;
        totals.samples += sums.kept;
        totals.marched += sums.marched;
        totals.rays += sums.rays;
        totals.left_out += sums.kept.saturating_sub(sums.drawn);
        totals.empty_batches += u64::from(sums.kept == 0);
    }

    /// Returns the oldest unused sums with their spacing, after adding them to the totals. Returns `None` if the number
    /// of pending sums does not exceed the lag.
    pub(super) fn oldest_sums(&mut self) -> Result<Option<(f64, StepSums)>> {
        if self.pending.len() <= B::LAG {
            return Ok(None);
        }
        let Some(Pending { spacing, sums }) = self.pending.pop_front() else { return Ok(None) };
        Ok(Some((spacing, self.arrived(sums)?)))
    }

    /// Waits for sums and adds them to the totals, unless this was done already.
    fn arrived(&mut self, sums: Arrival<B>) -> Result<StepSums> {
        match sums {
            Arrival::Counted(sums) => Ok(sums),
            Arrival::Posted(receipt) => {
                let result = self.exchange.sums(self.loaded.backend.redeem(receipt)?)?;
                self.count(&result.sums);
                if is_finite(&result.sums) {
                    self.exposures.iter_mut().for_each(|exposures| exposures.take(&result));
                    self.poses.iter_mut().for_each(|poses| poses.take(&result));
                }
                Ok(result.sums)
            }
        }
    }

    /// Returns an error if the sums of a step that has already updated the parameters are not finite. The parameters
    /// are then unusable, too.
    pub(super) fn expect_finite(&mut self, step: u64, sums: &StepSums) -> Result<()> {
        finite(step, sums).inspect_err(|error| self.spoilt = Some(error.clone()))
    }

    /// Returns an error if the parameters hold the update of a step whose loss was not finite.
    pub(super) fn expect_usable(&self) -> Result<()> {
        self.spoilt.clone().map_or(Ok(()), Err)
    }

    /// Updates exposures and poses of photographs with the gradients that are due. `rate` is the networks' learning
    /// rate at `progress`.
    pub(super) fn adapt_photographs(&mut self, rate: f64, progress: f64) {
        let in_transit =
            self.pending.iter().filter(|pending| matches!(pending.sums, Arrival::Posted(_))).count();
        let Self { loaded, state, exposures, poses, .. } = self;
        let (config, step) = (&loaded.config.optimizer, state.totals.step);
        let schedule = rate / config.learning_rate;
        if let Some(exposures) = exposures
            && exposures.advance(config, config.exposure_rate * schedule, step, in_transit)
        {
            loaded.stages.loss.set_gains(&exposures.gains());
        }
        if let Some(poses) = poses
            && poses.advance(config, Poses::rate(config, schedule, progress), step, in_transit)
        {
            loaded.stages.sampler.set_cameras(&poses.cameras());
        }
    }

    /// Reads all pending sums into the state, for a checkpoint.
    pub(super) fn drain(&mut self) -> Result<()> {
        self.state.pending = [None; MOST_PENDING];
        let first = self.state.totals.step.saturating_sub(self.pending.len() as u64);
        for (place, Pending { spacing, sums }) in std::mem::take(&mut self.pending).into_iter().enumerate() {
            let sums = self.arrived(sums)?;
            self.expect_finite(first + place as u64, &sums)?;
            self.pending.push_back(Pending { spacing, sums: Arrival::Counted(sums) });
            self.state.pending[place] = Some((spacing, sums));
        }
        Ok(())
    }
}

fn is_finite(sums: &StepSums) -> bool {
    sums.non_finite == 0 && sums.loss.is_finite()
}

/// Returns an error if the sums of a step are not finite.
pub(super) fn finite(step: u64, sums: &StepSums) -> Result<()> {
    if is_finite(sums) {
        return Ok(());
    }
    Err(Error::run(format!(
        "step {step}: {} of {} pixels are not finite (loss {}); lower optimizer.learning_rate",
        sums.non_finite, sums.rays, sums.loss
    )))
}
