//! The interface for training one model in several processes, called ranks. Every rank computes a share of each step's
//! pixels. An [`Exchange`] combines their results, and every rank takes the same step with the same bits. Messages are
//! sent through [`Ranks`].

pub use crate::engine::ranks::{Rank, Ranks, fault};

use crate::{
    Backend, Result,
    engine::{
        backend::Stages,
        batch::{PartialGradients, StepResult, Update},
        error_map::CellErrors,
    },
};
use std::sync::Arc;

/// Combines the results of the ranks in a step. The trainer calls [`partials`](Self::partials), then
/// [`update`](Self::update). On a backend without lag it calls [`sums`](Self::sums) between the two; on a backend with
/// lag it calls `sums` after them, for an earlier step.
pub trait Exchange<B: Backend>: Send {
    /// Returns this rank, which determines the process's share of each step's pixels.
    fn rank(&self) -> Rank {
        Rank::ONLY
    }

    /// Called when this rank's partial gradients are complete, before they are posted or reduced.
    ///
    /// # Errors
    /// When another rank is gone.
    fn partials(
        &mut self,
        backend: &B,
        stages: &mut Stages<B>,
        partials: &mut [PartialGradients<B>],
    ) -> Result<()> {
        let _ = (backend, stages, partials);
        Ok(())
    }

    /// Called with the sums of a step that this rank posted; returns the sums over all ranks.
    ///
    /// # Errors
    /// When another rank is gone.
    fn sums(&mut self, sums: StepResult) -> Result<StepResult> {
        Ok(sums)
    }

    /// Computes new parameters, as [`Backend::update`] does, from the gradients of all ranks. It is also called on a
    /// rank whose rays hit nothing, with a gradient and a weight of zero.
    ///
    /// # Errors
    /// When another rank is gone.
    fn update(&mut self, backend: &B, stages: &mut Stages<B>, update: &mut Update<'_, B>) -> Result<()> {
        backend.update(stages, update);
        Ok(())
    }

    /// Called with the errors of the pixels that this rank drew, one per cell of the error map; returns the sums over
    /// all ranks.
    ///
    /// # Errors
    /// When another rank is gone.
    fn errors(&mut self, errors: Vec<CellErrors>) -> Result<Vec<CellErrors>> {
        Ok(errors)
    }

    /// Called before the optimiser's moments are read. Afterwards every rank has all moments.
    ///
    /// # Errors
    /// When another rank is gone.
    fn moments(&mut self, backend: &B, stages: &mut Stages<B>) -> Result<()> {
        let _ = (backend, stages);
        Ok(())
    }
}

/// The exchange of a single process, which leaves all values unchanged.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl<B: Backend> Exchange<B> for Alone {}

/// An exchange for any backend: every rank adds up the gradients of all ranks in rank order and updates all parameters.
/// All ranks get the same bits, but the rounding of the sums depends on the number of ranks.
pub struct Summed {
    ranks: Arc<dyn Ranks>,
    received: Vec<Vec<u8>>,
}

impl Summed {
    /// Creates an exchange over `ranks`.
    pub fn new(ranks: Arc<dyn Ranks>) -> Self {
        let received = vec![Vec::new(); ranks.rank().size];
        Self { ranks, received }
    }

    /// Sends `own` to every rank; calls `add` with the bytes from each rank, in rank order.
    fn gather(&mut self, own: &[u8], mut add: impl FnMut(&[u8]) -> Result<()>) -> Result<()> {
        let Self { ranks, received } = self;
        let this_rank = ranks.rank();
        ranks.all_to_all(&vec![own; this_rank.size], received)?;
        for (rank, bytes) in received.iter().enumerate() {
            add(if rank == this_rank.id { own } else { bytes })?;
        }
        Ok(())
    }
}

impl<B: Backend> Exchange<B> for Summed {
    fn rank(&self) -> Rank {
        self.ranks.rank()
    }

    fn sums(&mut self, sums: StepResult) -> Result<StepResult> {
        let own = sums.to_words();
        let mut all = StepResult::default();
        self.gather(bytemuck::cast_slice(&own), |bytes| {
            let (words, rest) = bytes.as_chunks();
            if !rest.is_empty() {
                return Err(fault(format_args!("expected words of 8 bytes, found {} bytes", bytes.len())));
            }
            let words: Vec<u64> = words.iter().map(|word| u64::from_ne_bytes(*word)).collect();
            all.add(&StepResult::of_words(&words)?);
            Ok(())
        })?;
        Ok(all)
    }

    fn errors(&mut self, errors: Vec<CellErrors>) -> Result<Vec<CellErrors>> {
        let own: Vec<u8> = bytemuck::cast_slice(&errors).to_vec();
        let mut all = vec![[0; 2]; errors.len()];
        self.gather(&own, |bytes| {
            if bytes.len() != own.len() {
                let (expected, found) = (own.len(), bytes.len());
                return Err(fault(format_args!("expected errors of {expected} bytes, found {found}")));
            }
            let words = bytes.as_chunks().0.iter().map(|word| u64::from_ne_bytes(*word));
            all.as_flattened_mut().iter_mut().zip(words).for_each(|(sum, word)| *sum += word);
            Ok(())
        })?;
        Ok(all)
    }

    fn update(&mut self, backend: &B, stages: &mut Stages<B>, update: &mut Update<'_, B>) -> Result<()> {
        let mut own = backend.read(update.gradient);
        let mut message = bytemuck::bytes_of(&backend.weight(update.partials)).to_vec();
        message.extend_from_slice(bytemuck::cast_slice(&own));
        let mut weight = 0.0;
        own.fill(0.0);
        self.gather(&message, |bytes| {
            let Some((head, tail)) = bytes.split_first_chunk().filter(|_| bytes.len() == message.len())
            else {
                let (expected, found) = (message.len(), bytes.len());
                return Err(fault(format_args!(
                    "expected a weight and a gradient of {expected} bytes, found {found}"
                )));
            };
            weight += f64::from_ne_bytes(*head);
            let values = tail.as_chunks().0.iter().map(|bytes| f32::from_ne_bytes(*bytes));
            own.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
            Ok(())
        })?;
        self.ranks.record_traffic(size_of_val(&own[..]) as u64);
        backend.write(update.gradient, &own);
        backend.set_weight(update.partials, weight);
        backend.update_all(stages, update);
        Ok(())
    }
}
