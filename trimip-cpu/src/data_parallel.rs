//! Training on several ranks, bit-identical to training on one. Neither a step's partial gradients nor the tree in which they are
//! added up ([`ReductionTree`](crate::reduction_tree::ReductionTree)) depend on the number of ranks.
//!
//! If the encoder's parameters can be divided among ranks ([`Divided`](crate::encoders::Divided)), each rank sums the gradients of
//! its own leaves of a step. It then adds up the sums of all ranks for its part of the parameters, updates this part, and sends the
//! changed parameters to the other ranks. With any other encoder, every rank receives all partial gradients.

use crate::CpuBackend;
use crate::backend::partials;
use crate::encoder::CpuEncoder;
use crate::encoders::Divided;
use crate::optimizer::CpuOptimizer;
use crate::reduction_tree::ReductionTree;
use crate::wire::{Reader, put, put_counted};
use std::sync::Arc;
use trimip_core::config::TrainConfig;
use trimip_core::engine::backend::Stages;
use trimip_core::engine::batch::{PartialGradients, StepResult, Update};
use trimip_core::engine::error_map::CellErrors;
use trimip_core::engine::exchange::{Exchange, Rank, Ranks, Summed};
use trimip_core::{Backend, Error, Field, Optimizer, Result};

/// The exchange of the CPU backend.
pub struct DataParallel {
    ranks: Arc<dyn Ranks>,
    this_rank: Rank,
    /// Messages to and from each rank.
    out: Vec<Vec<u8>>,
    into: Vec<Vec<u8>>,
}

impl DataParallel {
    /// Creates an exchange over `ranks` for steps with the settings `train`.
    ///
    /// # Errors
    /// When there are more ranks than leaves.
    pub fn new(ranks: Arc<dyn Ranks>, train: &TrainConfig) -> Result<Self> {
        let this_rank = ranks.rank();
        // A small step may have fewer sets of partial gradients than `train.leaves`, and so fewer leaves.
        let leaves = ReductionTree::new(train.leaves, partials(train.samples_per_step)).count();
        if this_rank.size > leaves {
            let advice = match this_rank.size.next_power_of_two() {
                65.. => "start at most 64 ranks".into(),
                needed if needed > train.leaves as usize => format!(
                    "start fewer ranks, or begin a new run with train.leaves = {needed} (a run keeps its leaves)"
                ),
                _ => "start fewer ranks, or begin a new run with a larger train.samples_per_step".into(),
            };
            return Err(Error::input(
                format!("{} ranks", this_rank.size),
                format!("are more than the {leaves} leaves of a step of the CPU backend"),
                advice,
            ));
        }
        let messages = || vec![Vec::new(); this_rank.size];
        Ok(Self { ranks, this_rank, out: messages(), into: messages() })
    }

    fn others(&self) -> impl Iterator<Item = usize> + use<> {
        let Rank { id: rank, size: of } = self.this_rank;
        (0..of).filter(move |other| *other != rank)
    }

    /// Sends each rank its message in `out`, and receives one message per rank in `into`.
    fn all_to_all(&mut self) -> Result<()> {
        let out: Vec<&[u8]> = self.out.iter().map(Vec::as_slice).collect();
        self.ranks.all_to_all(&out, &mut self.into)
    }

    /// Sends `message` to every rank, and receives one message per rank in `into`.
    fn tell(&mut self, message: &[u8]) -> Result<()> {
        self.ranks.all_to_all(&vec![message; self.this_rank.size], &mut self.into)
    }

    /// Returns the encoder if its parameters are divided among ranks. This requires an optimiser that skips untouched
    /// parameters, because ranks send only the touched ones.
    fn divided<'a>(
        &self,
        encoder: &'a mut CpuEncoder,
        optimizer: &CpuOptimizer,
    ) -> Option<&'a mut dyn Divided> {
        encoder.divided().filter(|_| self.this_rank.size > 1 && optimizer.policy().skips_untouched())
    }
}

impl Exchange<CpuBackend> for DataParallel {
    fn rank(&self) -> Rank {
        self.this_rank
    }

    fn partials(
        &mut self,
        _: &CpuBackend,
        stages: &mut Stages<CpuBackend>,
        partials: &mut [PartialGradients<CpuBackend>],
    ) -> Result<()> {
        let divided = self.divided(&mut stages.encoder, &stages.optimizer);
        let is_divided = divided.is_some();
        if let Some(divided) = divided {
            divided.divide(self.this_rank);
        }
        stages.field.fold(partials, self.this_rank);
        let tree = stages.field.reduction_tree(partials.len());
        let own = tree.of(self.this_rank).start;
        for to in self.others() {
            let out = &mut self.out[to];
            out.clear();
            partials[own].field.put(out);
            for partial in
                partials.iter().enumerate().filter_map(|(i, d)| tree.has(self.this_rank, i).then_some(d))
            {
                put_counted(out, &partial.sums.to_words());
                if !is_divided {
                    stages.encoder.put(&partial.encoder, out);
                }
            }
        }
        self.all_to_all()?;
        let mut words = Vec::new();
        for from in self.others() {
            let mut reader = Reader::new(&self.into[from]);
            let this_rank = Rank { id: from, ..self.this_rank };
            partials[tree.of(this_rank).start].field.take(&mut reader)?;
            for (_, partial) in partials.iter_mut().enumerate().filter(|(i, _)| tree.has(this_rank, *i)) {
                reader.list(&mut words)?;
                partial.sums = StepResult::of_words(&words)?;
                if !is_divided {
                    stages.encoder.take(&mut reader, &mut partial.encoder)?;
                }
            }
            reader.end()?;
        }
        Ok(())
    }

    fn errors(&mut self, errors: Vec<CellErrors>) -> Result<Vec<CellErrors>> {
        // The errors are integers, so their sums are the same for any number of ranks.
        Exchange::<CpuBackend>::errors(&mut Summed::new(Arc::clone(&self.ranks)), errors)
    }

    fn update(
        &mut self,
        backend: &CpuBackend,
        stages: &mut Stages<CpuBackend>,
        update: &mut Update<'_, CpuBackend>,
    ) -> Result<()> {
        if self.divided(&mut stages.encoder, &stages.optimizer).is_none() {
            backend.update(stages, update);
            self.ranks.record_traffic(size_of_val(&update.gradient[..]) as u64);
            return Ok(());
        }
        let Stages { encoder, optimizer, field, .. } = stages;
        let Some(divided) = encoder.divided() else { return Ok(()) };
        for to in self.others() {
            let out = &mut self.out[to];
            out.clear();
            divided.put_sums(update.gradient, to, out);
        }
        self.all_to_all()?;
        divided.take_sums(&self.into, update.gradient)?;
        divided.complete(update.gradient);
        // If the loss weights of the step sum to 0, no rank updates its parameters.
        if backend.weight(update.partials) > 0.0 {
            let left_out = optimizer.step_within(update, divided.pieces());
            let mut message = std::mem::take(&mut self.out[self.this_rank.id]);
            message.clear();
            put(&mut message, &[left_out]);
            divided.put_changed(update.parameters, &mut message);
            self.tell(&message)?;
            for from in self.others() {
                let mut reader = Reader::new(&self.into[from]);
                optimizer.count_non_finite(reader.one()?);
                divided.take_changed(&mut reader, from, update.parameters)?;
                reader.end()?;
            }
            self.ranks.record_traffic((divided.count_touched() * size_of::<f32>()) as u64);
            self.out[self.this_rank.id] = message;
            encoder.refresh_touched(update.parameters);
            field.refresh(update.parameters);
        }
        Ok(())
    }

    fn moments(&mut self, _: &CpuBackend, stages: &mut Stages<CpuBackend>) -> Result<()> {
        let Stages { encoder, optimizer, .. } = stages;
        let Some(divided) = self.divided(encoder, optimizer) else { return Ok(()) };
        let parts: Vec<_> = (0..self.this_rank.size).map(|rank| divided.part(rank)).collect();
        let mut message = Vec::new();
        for moments in optimizer.moments() {
            parts[self.this_rank.id].iter().for_each(|range| put(&mut message, &moments[range.clone()]));
        }
        self.tell(&message)?;
        for from in self.others() {
            let mut reader = Reader::new(&self.into[from]);
            for moments in optimizer.moments_mut() {
                parts[from].iter().try_for_each(|range| reader.copy(&mut moments[range.clone()]))?;
            }
            reader.end()?;
        }
        Ok(())
    }
}
