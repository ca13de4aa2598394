//! Training on several ranks with the bits of one. Neither a step's deposits nor the tree in which they are added up
//! ([`Parts`](crate::parts::Parts)) depend on the number of ranks.
//!
//! An encoder that can be divided ([`Divided`](crate::encoders::Divided)) sums the parts of a step on the ranks that have them.
//! Each rank adds these sums up for a part of the parameters, updates it, and sends the others what changed. Any other encoder gets
//! all deposits on every rank.

use crate::CpuBackend;
use crate::backend::deposits;
use crate::encoder::CpuEncoder;
use crate::encoders::Divided;
use crate::optimizer::CpuOptimizer;
use crate::parts::Parts;
use crate::wire::{Reader, put, put_counted};
use std::sync::Arc;
use trimip_core::backend::Stages;
use trimip_core::batch::{Deposit, StepResult, Update};
use trimip_core::config::TrainConfig;
use trimip_core::exchange::{Exchange, Ranks, Share};
use trimip_core::{Backend, Error, Field, Optimizer, Result};

/// The exchange of the CPU backend.
pub struct Together {
    ranks: Arc<dyn Ranks>,
    share: Share,
    /// Messages to and from each rank.
    out: Vec<Vec<u8>>,
    into: Vec<Vec<u8>>,
}

impl Together {
    /// An exchange over `ranks` for steps with these settings.
    ///
    /// # Errors
    /// When there are more ranks than parts.
    pub fn new(ranks: Arc<dyn Ranks>, train: &TrainConfig) -> Result<Self> {
        let share = ranks.share();
        // Small steps have fewer deposits than parts are asked for.
        let parts = Parts::new(train.parts, deposits(train.samples_per_step)).count();
        if share.of > parts {
            let advice = match share.of.next_power_of_two() {
                65.. => "start at most 64 ranks".into(),
                needed if needed > train.parts as usize => format!(
                    "start fewer ranks, or begin a new run with train.parts = {needed} (a run keeps its parts)"
                ),
                _ => "start fewer ranks, or begin a new run with a larger train.samples_per_step".into(),
            };
            return Err(Error::input(
                format!("{} ranks", share.of),
                format!("a step of the CPU backend has {parts} parts here"),
                advice,
            ));
        }
        let messages = || vec![Vec::new(); share.of];
        Ok(Self { ranks, share, out: messages(), into: messages() })
    }

    fn others(&self) -> impl Iterator<Item = usize> + use<> {
        let Share { rank, of } = self.share;
        (0..of).filter(move |other| *other != rank)
    }

    /// Sends what is in `out`.
    fn trade(&mut self) -> Result<()> {
        let out: Vec<&[u8]> = self.out.iter().map(Vec::as_slice).collect();
        self.ranks.trade(&out, &mut self.into)
    }

    /// Sends `message` to every rank.
    fn tell(&mut self, message: &[u8]) -> Result<()> {
        self.ranks.trade(&vec![message; self.share.of], &mut self.into)
    }

    /// The encoder, if it is divided: untouched parameters must be left alone, as nobody sends them.
    fn divided<'a>(
        &self,
        encoder: &'a mut CpuEncoder,
        optimizer: &CpuOptimizer,
    ) -> Option<&'a mut dyn Divided> {
        encoder.divided().filter(|_| self.share.of > 1 && optimizer.policy().skips_untouched())
    }
}

impl Exchange<CpuBackend> for Together {
    fn share(&self) -> Share {
        self.share
    }

    fn deposits(
        &mut self,
        _: &CpuBackend,
        stages: &mut Stages<CpuBackend>,
        deposits: &mut [Deposit<CpuBackend>],
    ) -> Result<()> {
        let divided = self.divided(&mut stages.encoder, &stages.optimizer);
        let is_divided = divided.is_some();
        if let Some(divided) = divided {
            divided.divide(self.share);
        }
        stages.field.fold(deposits, self.share);
        let parts = stages.field.parts(deposits.len());
        let own = parts.of(self.share).start;
        for to in self.others() {
            let out = &mut self.out[to];
            out.clear();
            deposits[own].field.put(out);
            for deposit in
                deposits.iter().enumerate().filter_map(|(i, d)| parts.has(self.share, i).then_some(d))
            {
                put_counted(out, &deposit.sums.to_words());
                if !is_divided {
                    stages.encoder.put(&deposit.encoder, out);
                }
            }
        }
        self.trade()?;
        let mut words = Vec::new();
        for from in self.others() {
            let mut reader = Reader::new(&self.into[from]);
            let share = Share { rank: from, ..self.share };
            deposits[parts.of(share).start].field.take(&mut reader)?;
            for (_, deposit) in deposits.iter_mut().enumerate().filter(|(i, _)| parts.has(share, *i)) {
                reader.list(&mut words)?;
                deposit.sums = StepResult::of_words(&words)?;
                if !is_divided {
                    stages.encoder.take(&mut reader, &mut deposit.encoder)?;
                }
            }
            reader.end()?;
        }
        Ok(())
    }

    fn update(
        &mut self,
        backend: &CpuBackend,
        stages: &mut Stages<CpuBackend>,
        update: &mut Update<'_, CpuBackend>,
    ) -> Result<()> {
        if self.divided(&mut stages.encoder, &stages.optimizer).is_none() {
            backend.update(stages, update);
            self.ranks.tally(size_of_val(&update.gradient[..]) as u64);
            return Ok(());
        }
        let Stages { encoder, optimizer, field, .. } = stages;
        let Some(divided) = encoder.divided() else { return Ok(()) };
        for to in self.others() {
            let out = &mut self.out[to];
            out.clear();
            divided.put_sums(update.gradient, to, out);
        }
        self.trade()?;
        divided.take_sums(&self.into, update.gradient)?;
        divided.complete(update.gradient);
        // Without a weight nothing moves, on any rank.
        if backend.weight(update.deposits) > 0.0 {
            let left_out = optimizer.step_within(update, divided.pieces());
            let mut message = std::mem::take(&mut self.out[self.share.rank]);
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
            self.ranks.tally((divided.count_touched() * size_of::<f32>()) as u64);
            self.out[self.share.rank] = message;
            encoder.refresh_touched(update.parameters);
            field.refresh(update.parameters);
        }
        Ok(())
    }

    fn moments(&mut self, _: &CpuBackend, stages: &mut Stages<CpuBackend>) -> Result<()> {
        let Stages { encoder, optimizer, .. } = stages;
        let Some(divided) = self.divided(encoder, optimizer) else { return Ok(()) };
        let parts: Vec<_> = (0..self.share.of).map(|rank| divided.part(rank)).collect();
        let mut message = Vec::new();
        for moments in optimizer.moments() {
            parts[self.share.rank].iter().for_each(|range| put(&mut message, &moments[range.clone()]));
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
