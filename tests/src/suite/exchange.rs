//! Tests of the gradient exchange between machines: it runs in every step, between the complete gradient and the
//! update.

use super::training::{configuration, scheduled, steps};
use crate::fixtures;
use std::sync::mpsc::{Receiver, Sender, channel};
use trimip_core::{
    Backend, Config, Result,
    batch::Deposit,
    config::Untouched,
    exchange::{Exchange, Exchanged},
    trainer::Trainer,
};

/// A second machine with the same rays: the sum of gradients is twice the gradient, and so is the sum of weights.
struct Twin;

impl<B: Backend> Exchange<B> for Twin {
    fn exchange(
        &mut self,
        backend: &B,
        gradient: &mut B::Buffer<f32>,
        deposits: &mut [Deposit<B>],
    ) -> Exchanged {
        let doubled: Vec<f32> = backend.read(gradient).iter().map(|g| 2.0 * g).collect();
        backend.write(gradient, &doubled);
        backend.set_weight(deposits, 2.0 * backend.weight(deposits));
        Exchanged::Everything
    }
}

/// An exchange that returns a zero gradient and zero weight.
struct Nothing;

impl<B: Backend> Exchange<B> for Nothing {
    fn exchange(
        &mut self,
        backend: &B,
        gradient: &mut B::Buffer<f32>,
        deposits: &mut [Deposit<B>],
    ) -> Exchanged {
        let length = backend.read(gradient).len();
        backend.write(gradient, &vec![0.0; length]);
        backend.set_weight(deposits, 0.0);
        Exchanged::Everything
    }
}

/// Configurations that cover every path from the gradient to the parameters.
fn configurations() -> Result<Vec<Config>> {
    let mut all = vec![scheduled()?];
    for encoder in fixtures::every_encoder() {
        for untouched in [Untouched::Decay, Untouched::Skip] {
            let mut config = fixtures::encoded(configuration(), &encoder);
            config.optimizer.untouched = untouched;
            all.push(config);
        }
    }
    Ok(all)
}

/// Training next to a twin with the same rays moves the parameters by the same bits as training alone; with zero weight
/// nothing moves.
///
/// # Errors
/// When a step fails.
pub fn twin<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for config in configurations()? {
        let fresh = || Trainer::new(make(), &config, fixtures::noise(3, 16, 2, 2));
        let (mut alone, mut beside, mut idle) = (fresh()?, fresh()?, fresh()?);
        let first = idle.parameters();
        beside.exchange_by(Twin)?;
        idle.exchange_by(Nothing)?;
        steps(&mut alone, &config, 12)?;
        steps(&mut beside, &config, 12)?;
        steps(&mut idle, &config, 3)?;
        let bits = |values: Vec<f32>| values.into_iter().map(f32::to_bits).collect::<Vec<_>>();
        let name = format!("{:?}, {:?}", config.encoder.kind, config.optimizer.untouched);
        assert!(alone.parameters() != first, "{name}: twelve steps move something");
        assert!(bits(alone.parameters()) == bits(beside.parameters()), "{name}: a twin changes no bit");
        assert!(idle.parameters() == first, "{name}: without weight nothing moves");
    }
    Ok(())
}

/// Gains of photographs are not exchanged: several machines refuse them.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn no_gains<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut trainer = Trainer::new(make(), &super::exposure::exposed(), fixtures::noise(3, 16, 2, 2))?;
    let refused = trainer.exchange_by(Twin).expect_err("gains are this machine's own");
    assert!(refused.exit_code() == 2 && refused.message.contains("loss.exposure"), "{refused}");
    Ok(())
}

/// Sums gradients with one other machine.
struct Link {
    to: Sender<(Vec<f32>, f64)>,
    from: Receiver<(Vec<f32>, f64)>,
}

impl<B: Backend> Exchange<B> for Link {
    fn exchange(
        &mut self,
        backend: &B,
        gradient: &mut B::Buffer<f32>,
        deposits: &mut [Deposit<B>],
    ) -> Exchanged {
        let (mut sum, weight) = (backend.read(gradient), backend.weight(deposits));
        self.to.send((sum.clone(), weight)).expect("the other machine listens");
        let (other, its_weight) = self.from.recv().expect("the other machine answers");
        // The sum of two values has the same bits in either order.
        sum.iter_mut().zip(other).for_each(|(sum, other)| *sum += other);
        backend.write(gradient, &sum);
        backend.set_weight(deposits, weight + its_weight);
        Exchanged::Everything
    }
}

/// Two machines with different photographs and equal initial parameters keep equal parameters. These differ from what
/// either machine reaches alone.
///
/// # Errors
/// When a step fails.
pub fn together<B: Backend>(make: impl Fn() -> B + Sync) -> Result<()> {
    for config in configurations()? {
        let views = |machine| fixtures::noise(3, 16, 2, machine);
        let (to_second, from_first) = channel();
        let (to_first, from_second) = channel();
        let train = |machine: u64, link: Option<Link>| -> Result<Vec<f32>> {
            let mut trainer = Trainer::new(make(), &config, views(machine))?;
            if let Some(link) = link {
                trainer.exchange_by(link)?;
            }
            steps(&mut trainer, &config, 12)?;
            Ok(trainer.parameters())
        };
        let (first, second) = std::thread::scope(|scope| {
            let (first, second) =
                (Link { to: to_second, from: from_second }, Link { to: to_first, from: from_first });
            let other = scope.spawn(|| train(8, Some(second)));
            (train(7, Some(first)), other.join().expect("the second machine trains"))
        });
        let (first, second) = (first?, second?);
        assert!(
            first.iter().zip(&second).all(|(a, b)| a.to_bits() == b.to_bits()),
            "both have the same bits"
        );
        assert!(first != train(7, None)? && second != train(8, None)?, "each learns from the other");
    }
    Ok(())
}
