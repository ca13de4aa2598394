//! Tests of training on several ranks, which are threads here.

use super::exposure::exposed;
use super::poses::refined;
use super::training::{configuration, drawn, scheduled, steps};
use crate::fixtures;
use crate::ranks::Threads;
use std::sync::{
    Arc,
    atomic::{AtomicUsize, Ordering},
};
use trimip_core::{
    Backend, Config, Error, ErrorKind, Result, Session,
    config::{TrainConfig, Untouched},
    engine::{
        checkpoint::Checkpoint,
        exchange::{Exchange, Rank, Ranks, Summed},
        trainer::Trainer,
    },
    field::tensors::Values,
};

/// A function that creates the exchange of a backend.
type Make<'a, B> = &'a (dyn Fn(Arc<dyn Ranks>, &Config) -> Box<dyn Exchange<B>> + Sync);

/// Returns configurations that cover every path from the gradient to the parameters.
fn configurations() -> Result<Vec<Config>> {
    let mut all = vec![scheduled()?, exposed(), refined(), drawn()];
    for encoder in fixtures::every_encoder().into_iter().chain(fixtures::growing()) {
        for untouched in [Untouched::Decay, Untouched::Skip] {
            let mut config = fixtures::encoded(configuration(), &encoder);
            config.optimizer.untouched = untouched;
            all.push(config);
        }
    }
    Ok(all)
}

/// Takes `count` steps on `ranks` ranks, starting from `checkpoint`; returns the checkpoint of every rank.
fn train<B: Backend>(
    make: &(impl Fn() -> B + Sync),
    exchange: Make<'_, B>,
    config: &Config,
    ranks: usize,
    checkpoint: Option<&Checkpoint>,
    count: u64,
) -> Result<Vec<Checkpoint>> {
    let one = |rank: Option<Arc<Threads>>| -> Result<Checkpoint> {
        let mut trainer = Trainer::new(make(), config, fixtures::noise(3, 16, 2, 7))?;
        let number = rank.as_ref().map(|rank| rank.rank().id);
        if let Some(rank) = rank {
            trainer.exchange_by(exchange(rank, config));
        }
        if let Some(checkpoint) = checkpoint {
            trainer.restore(checkpoint)?;
        }
        // Only rank 0 takes the checkpoint halfway, and this changes nothing.
        steps(&mut trainer, config, count / 2)?;
        match number {
            None => {}
            Some(0) => drop(trainer.checkpoint()?),
            Some(_) => trainer.join_checkpoint()?,
        }
        steps(&mut trainer, config, count - count / 2)?;
        trainer.checkpoint()
    };
    if ranks == 0 {
        return Ok(vec![one(None)?]);
    }
    std::thread::scope(|scope| {
        let run = |rank| scope.spawn(|| one(Some(rank)));
        let runs: Vec<_> = Threads::new(ranks).into_iter().map(run).collect();
        runs.into_iter().map(|run| run.join().expect("a rank trains")).collect()
    })
}

/// Returns true if two checkpoints have the same bits, counters included.
fn same(a: &Checkpoint, b: &Checkpoint) -> bool {
    let bits = |checkpoint: &Checkpoint| format!("{:?}", checkpoint.state);
    bits(a) == bits(b) && a.file == b.file
}

/// With any number of ranks, every rank has the bits of a run in one process: parameters, moments, occupancy, gains and counters. A run
/// can resume from a checkpoint of another number of ranks.
///
/// # Errors
/// When a step fails.
pub fn same_bits<B: Backend>(make: impl Fn() -> B + Sync, exchange: Make<'_, B>) -> Result<()> {
    for config in configurations()? {
        let name = format!("{:?}, {:?}", config.encoder.kind, config.optimizer.untouched);
        let half = train(&make, exchange, &config, 0, None, 6)?.remove(0);
        let whole = train(&make, exchange, &config, 0, Some(&half), 6)?.remove(0);
        assert!(!same(&half, &whole), "{name}: six steps change something");
        for ranks in [1, 2, 3, 4] {
            for checkpoint in train(&make, exchange, &config, ranks, None, 12)? {
                assert!(same(&checkpoint, &whole), "{name}: {ranks} ranks");
            }
        }
        // Five ranks: more than the usual number of leaves, and not a power of two.
        let finer = Config { train: TrainConfig { leaves: 8, ..config.train.clone() }, ..config.clone() };
        let alone = train(&make, exchange, &finer, 0, None, 4)?.remove(0);
        for checkpoint in train(&make, exchange, &finer, 5, None, 4)? {
            assert!(same(&checkpoint, &alone), "{name}: 5 ranks");
        }
        let [first, then] = [3, 2];
        let begun = train(&make, exchange, &config, first, None, 6)?.remove(first - 1);
        assert!(same(&begun, &half), "{name}: {first} ranks, half of the steps");
        let ended = train(&make, exchange, &config, then, Some(&begun), 6)?.remove(0);
        assert!(same(&ended, &whole), "{name}: {first} ranks, then {then}");
    }
    Ok(())
}

/// Ranks that sum their gradients have bit-identical checkpoints, and together they see every pixel of a step once. Their gradient is that
/// of one process up to rounding: the test compares the first moments after one step, which are proportional to the gradient.
///
/// # Errors
/// When a step fails.
pub fn summed<B: Backend>(make: impl Fn() -> B + Sync) -> Result<()> {
    let exchange: Make<'_, B> = &|ranks, _| Box::new(Summed::new(ranks));
    let gradient = |checkpoint: &Checkpoint| -> Vec<f64> {
        let moments = checkpoint.file.tensors.iter().filter(|(name, _)| name.ends_with(".m"));
        let values = moments.filter_map(|(_, tensor)| match &tensor.values {
            Values::F32(values) => Some(values),
            _ => None,
        });
        values.flatten().map(|value| f64::from(*value)).collect()
    };
    let norm = |values: &[f64]| values.iter().map(|value| value * value).sum::<f64>().sqrt();
    for config in [configuration(), exposed(), refined()] {
        let alone = train(&make, exchange, &config, 0, None, 1)?.remove(0);
        let expected = gradient(&alone);
        for ranks in [2, 3] {
            let one = train(&make, exchange, &config, ranks, None, 1)?.remove(0);
            assert_eq!(one.state.totals.rays, alone.state.totals.rays, "{ranks} ranks");
            let apart: Vec<f64> = expected.iter().zip(gradient(&one)).map(|(a, b)| a - b).collect();
            assert!(norm(&expected) > 0.0);
            assert!(
                norm(&apart) < 1e-5 * norm(&expected),
                "{ranks} ranks: {:e}",
                norm(&apart) / norm(&expected)
            );
            let all = train(&make, exchange, &config, ranks, None, 12)?;
            assert!(all.iter().all(|other| same(other, &all[0])), "{ranks} ranks have the same bits");
        }
    }
    Ok(())
}

/// A rank that changes the length of the messages it receives in one `all_to_all`.
struct Broken {
    ranks: Arc<Threads>,
    /// Number of `all_to_all` calls before the one with the changed messages.
    trades: AtomicUsize,
    change: fn(&mut Vec<u8>),
}

impl Ranks for Broken {
    fn rank(&self) -> Rank {
        self.ranks.rank()
    }

    fn all_to_all(&self, out: &[&[u8]], into: &mut [Vec<u8>]) -> Result<()> {
        self.ranks.all_to_all(out, into)?;
        if self.trades.fetch_sub(1, Ordering::Relaxed) == 0 {
            let own = self.rank().id;
            into.iter_mut()
                .enumerate()
                .filter(|(from, _)| *from != own)
                .for_each(|(_, bytes)| (self.change)(bytes));
        }
        Ok(())
    }

    fn broadcast(&self, bytes: &mut Vec<u8>) -> Result<()> {
        self.ranks.broadcast(bytes)
    }

    fn send(&self, to: usize, bytes: &[u8]) -> Result<()> {
        self.ranks.send(to, bytes)
    }

    fn receive(&self) -> Result<(usize, Vec<u8>)> {
        self.ranks.receive()
    }

    fn try_receive(&self) -> Result<Option<(usize, Vec<u8>)>> {
        self.ranks.try_receive()
    }
}

/// A message that arrives with a length other than the sent one ends the run on every rank with a device error. If the messages carry
/// partial gradients or their sums, no parameter changes.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn broken<B: Backend>(make: impl Fn() -> B + Sync, exchange: Make<'_, B>) -> Result<()> {
    let changes: [fn(&mut Vec<u8>); 4] = [
        |bytes| bytes.truncate(bytes.len().saturating_sub(1)),
        |bytes| bytes.push(0),
        Vec::clear,
        |bytes| bytes.truncate(bytes.len() / 2),
    ];
    let summed: Make<'_, B> = &|ranks, _| Box::new(Summed::new(ranks));
    let mut skipping = configuration();
    skipping.optimizer.untouched = Untouched::Skip;
    let whole =
        fixtures::every_encoder().into_iter().map(|encoder| fixtures::encoded(configuration(), &encoder));
    // A step exchanges its partial gradients. If planes are divided among the ranks, it also exchanges sums and changed texels, and a
    // checkpoint exchanges moments.
    let mut cases: Vec<(Config, Make<'_, B>, usize)> = whole.map(|config| (config, exchange, 0)).collect();
    cases.extend((0..4).map(|all_to_all| (skipping.clone(), exchange, all_to_all)));
    cases.extend((0..2).map(|all_to_all| (configuration(), summed, all_to_all)));
    for (config, exchange, all_to_all) in &cases {
        for change in changes {
            let one = |ranks: Arc<Threads>| -> Result<Error> {
                let mut trainer = Trainer::new(make(), config, fixtures::noise(3, 16, 2, 7))?;
                let trades = AtomicUsize::new(*all_to_all);
                trainer.exchange_by(exchange(Arc::new(Broken { ranks, trades, change }), config));
                let before = trainer.parameters();
                let stepped = trainer.step(0.0).map(drop);
                if stepped.is_err() {
                    assert!(
                        *all_to_all > 1 || trainer.parameters() == before,
                        "all_to_all {all_to_all}: nothing has moved"
                    );
                }
                let name = format!("{:?}, all_to_all {all_to_all}", config.encoder.kind);
                Ok(stepped.and_then(|()| trainer.checkpoint().map(drop)).expect_err(&name))
            };
            let errors = std::thread::scope(|scope| {
                let run = |rank| scope.spawn(|| one(rank));
                let runs: Vec<_> = Threads::new(2).into_iter().map(run).collect();
                runs.into_iter().map(|run| run.join().expect("a rank trains")).collect::<Result<Vec<_>>>()
            })?;
            for error in errors {
                assert_eq!(error.kind(), ErrorKind::Device, "{error}");
                assert!(error.message().starts_with("message of another rank: expected "), "{error}");
            }
        }
    }
    Ok(())
}
