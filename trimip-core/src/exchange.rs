//! The seam for several machines. In every training step there is one moment at which the gradient of all parameters and
//! the sum of the weights of its rays are complete on this machine, and no parameter has moved yet. Machines that train
//! one model together add up both there. Each then moves its own copy of the parameters by the same bits.

use crate::{Backend, batch::Deposit};

/// What an [`Exchange`] did to the gradient.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exchanged {
    /// Nothing: gradient and weight are this machine's.
    Nothing,
    /// The gradient may differ from zero anywhere, also at parameters that no ray of this machine touched.
    Everything,
}

/// Joins gradient and weight of a step with those of other machines.
///
/// The trainer calls it once per step, after [`Stages::flush`](crate::backend::Stages::flush) and before
/// [`Backend::update`]. It must give the same bits on every machine; only then do their parameters stay equal.
pub trait Exchange<B: Backend>: Send {
    /// `gradient` is flat, in the order of the layout, not yet divided by the weight; [`Backend::read`] and
    /// [`Backend::write`] give access to it. [`Backend::weight`] and [`Backend::set_weight`] read and replace the weight,
    /// which stands in the deposits. A machine whose rays met nothing has a gradient and a weight of zero and calls this
    /// as well.
    fn exchange(
        &mut self,
        backend: &B,
        gradient: &mut B::Buffer<f32>,
        deposits: &mut [Deposit<B>],
    ) -> Exchanged;
}

/// One machine alone: leaves everything as it is.
#[derive(Clone, Copy, Debug, Default)]
pub struct Alone;

impl<B: Backend> Exchange<B> for Alone {
    fn exchange(&mut self, _: &B, _: &mut B::Buffer<f32>, _: &mut [Deposit<B>]) -> Exchanged {
        Exchanged::Nothing
    }
}
