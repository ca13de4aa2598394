//! A named part of the parameters, as encoders and networks declare it.

use crate::config::FilePrecision;
use std::ops::Range;

/// Alignment of slots in floats: one vector register, one cache line. The padding between slots is zero.
pub const ALIGNMENT: usize = 16;

/// A named part of the flat array.
#[derive(Clone, Debug, PartialEq)]
pub struct Slot {
    /// Name in files: `planes`, `density.0.weight`, `color.2.weight`, ...
    pub name: String,
    /// Shape; the last axis is contiguous.
    pub shape: Vec<usize>,
    /// Range in the flat array.
    pub range: Range<usize>,
    /// Initial values are uniform in [-bound, bound].
    pub bound: f32,
    /// True if initial values are normal with standard deviation `bound` instead.
    pub normal: bool,
    /// Learning rate as a multiple of `optimizer.learning_rate`.
    pub rate: f64,
    /// Weight decay as a multiple of `optimizer.weight_decay`.
    pub decay: f64,
    /// Group size of a sparse slot, a divisor of [`ALIGNMENT`]. `optimizer.untouched` decides what happens to groups
    /// without a gradient in a step. `None` (dense): every value is updated in every step.
    pub group: Option<usize>,
    /// Precision in model files. Checkpoints use f32.
    pub precision: FilePrecision,
    /// True if early stages of training use only the front part; see [`Definition::stage`](crate::field::encoders::Definition::stage).
    pub grows: bool,
}

impl Slot {
    /// Creates a dense slot of the given shape, last axis contiguous, whose range begins at 0. It has the learning rate
    /// and decay of the networks, is stored as f32 and does not grow.
    pub fn new(name: impl Into<String>, shape: Vec<usize>, bound: f32) -> Self {
        let range = 0..shape.iter().product::<usize>();
        Self {
            name: name.into(),
            shape,
            range,
            bound,
            normal: false,
            rate: 1.0,
            decay: 1.0,
            group: None,
            precision: FilePrecision::F32,
            grows: false,
        }
    }

    /// Returns the slot's range, including the padding after it.
    pub fn padded(&self) -> Range<usize> {
        self.range.start..self.range.end.next_multiple_of(ALIGNMENT)
    }
}

/// Places the slots one after the other in a flat array: each begins after the padding of the previous slot.
pub fn in_sequence(slots: impl IntoIterator<Item = Slot>) -> Vec<Slot> {
    let mut start = 0;
    let placed = slots.into_iter().map(|mut slot| {
        slot.range = start..start + slot.range.len();
        start = slot.padded().end;
        slot
    });
    placed.collect()
}

/// The part of a slot that is in use at a stage of growth.
#[derive(Clone, Debug, PartialEq)]
pub struct ActiveRange {
    /// Range in the flat array.
    pub range: Range<usize>,
    /// Weight of the absolute value of each parameter in the loss (L1).
    pub sparsity: f64,
}

impl ActiveRange {
    /// Returns the range of a whole slot, including the padding after it.
    pub fn whole(slot: &Slot) -> Self {
        Self { range: slot.padded(), sparsity: 0.0 }
    }
}
