//! The interface for training on several machines. In every training step there is one moment at which the gradient
//! of all parameters and the sum of the weights of its rays are complete on this machine, and no parameter has
//! changed yet. Machines that train one model together sum both at this moment. Each machine then updates its own
//! copy of the parameters, with the same bits.

use crate::{Backend, batch::Deposit};

/// What an [`Exchange`] did to the gradient.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exchanged {
    /// Nothing: gradient and weight are still this machine's.
    Nothing,
    /// The gradient may be non-zero anywhere, even at parameters that no ray of this machine touched.
    Everything,
}

/// Sums the gradient and the weight of a step over all machines.
///
/// The trainer calls it once per step, after [`Stages::flush`](crate::backend::Stages::flush) and before
/// [`Backend::update`]. The result must have the same bits on every machine; only then do their parameters stay
/// equal.
pub trait Exchange<B: Backend>: Send {
    /// Exchanges one step. `gradient` is flat, in the order of the layout, and not yet divided by the weight;
    /// [`Backend::read`] and [`Backend::write`] give access to it. The weight is stored in the deposits;
    /// [`Backend::weight`] and [`Backend::set_weight`] read and replace it. A machine whose rays hit nothing makes
    /// the call too, with a gradient and a weight of zero.
    fn exchange(
        &mut self,
        backend: &B,
        gradient: &mut B::Buffer<f32>,
        deposits: &mut [Deposit<B>],
    ) -> Exchanged;
}

/// A single machine: leaves everything unchanged.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl<B: Backend> Exchange<B> for Alone {
    fn exchange(&mut self, _: &B, _: &mut B::Buffer<f32>, _: &mut [Deposit<B>]) -> Exchanged {
        Exchanged::Nothing
    }
}
