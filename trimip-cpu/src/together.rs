//! Training on several ranks with the bits of one. A step's deposits do not depend on the number of ranks. Each rank computes
//! some of them and sends every other rank what it needs, and all sums have the order of the deposits.
//!
//! An encoder that can be divided ([`Divided`](crate::encoders::Divided)) does its part of the sums and of the update on each
//! rank, and the ranks then send each other the parameters that changed. Any other encoder gets all deposits on every rank.

use crate::CpuBackend;
use crate::backend::has;
use crate::buffer::Buffer;
use crate::encoder::CpuEncoder;
use crate::encoders::Divided;
use crate::field::PARTS;
use crate::optimizer::CpuOptimizer;
use crate::wire::{Reader, put, put_counted};
use std::sync::Arc;
use trimip_core::backend::Stages;
use trimip_core::batch::{Deposit, StepResult};
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
    /// An exchange over `ranks`.
    ///
    /// # Errors
    /// When there are more ranks than parts of a step.
    pub fn new(ranks: Arc<dyn Ranks>) -> Result<Self> {
        let share = ranks.share();
        if share.of > PARTS {
            return Err(Error::input(
                format!("{} ranks", share.of),
                format!("a step of the CPU backend has {PARTS} parts"),
                format!("start at most {PARTS} ranks, with more threads each"),
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
        encoder.divided().filter(|_| self.share.of > 1 && optimizer.skips_untouched())
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
        if let Some(divided) = self.divided(&mut stages.encoder, &stages.optimizer) {
            divided.divide(self.share);
        }
        stages.field.fold(deposits, self.share);
        let parts = PARTS.min(deposits.len());
        for to in self.others() {
            let out = &mut self.out[to];
            out.clear();
            for (i, deposit) in deposits.iter().enumerate().filter(|(i, _)| has(self.share, *i)) {
                if i < parts {
                    deposit.field.put(out);
                }
                put_counted(out, &deposit.sums.to_words());
                stages.encoder.put(&deposit.encoder, to, out);
            }
        }
        self.trade()?;
        let mut words = Vec::new();
        for from in self.others() {
            let mut reader = Reader::new(&self.into[from]);
            let share = Share { rank: from, ..self.share };
            for (i, deposit) in deposits.iter_mut().enumerate().filter(|(i, _)| has(share, *i)) {
                if i < parts {
                    deposit.field.take(&mut reader);
                }
                reader.list(&mut words);
                deposit.sums = StepResult::of_words(&words);
                stages.encoder.take(&mut reader, &mut deposit.encoder);
            }
        }
        Ok(())
    }

    fn update(
        &mut self,
        backend: &CpuBackend,
        stages: &mut Stages<CpuBackend>,
        parameters: &mut Buffer<f32>,
        gradient: &mut Buffer<f32>,
        deposits: &mut [Deposit<CpuBackend>],
        learning_rate: f64,
        step: u64,
    ) -> Result<()> {
        if self.divided(&mut stages.encoder, &stages.optimizer).is_none() {
            backend.update(stages, parameters, gradient, deposits, learning_rate, step);
            self.ranks.tally(size_of_val(&gradient[..]) as u64);
            return Ok(());
        }
        let Stages { encoder, optimizer, field, .. } = stages;
        let Some(divided) = encoder.divided() else { return Ok(()) };
        let mut message = std::mem::take(&mut self.out[self.share.rank]);
        message.clear();
        divided.put_common(&mut message);
        self.tell(&message)?;
        for from in self.others() {
            divided.take_common(&mut Reader::new(&self.into[from]), from);
        }
        divided.complete(gradient);
        // Without a weight nothing moves, on any rank.
        if backend.weight(deposits) > 0.0 {
            let left_out =
                optimizer.step_within(parameters, gradient, deposits, learning_rate, step, divided.pieces());
            message.clear();
            put(&mut message, &[left_out]);
            divided.put_changed(parameters, &mut message);
            self.tell(&message)?;
            for from in self.others() {
                let mut reader = Reader::new(&self.into[from]);
                optimizer.count_non_finite(reader.one());
                divided.take_changed(&mut reader, from, parameters);
            }
            self.ranks.tally((divided.count_touched() * size_of::<f32>()) as u64);
            encoder.refresh_touched(parameters);
            field.refresh(parameters);
        }
        self.out[self.share.rank] = message;
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
                parts[from].iter().for_each(|range| reader.copy(&mut moments[range.clone()]));
            }
        }
        Ok(())
    }
}
