//! The encoders on the CPU: each is a file or folder here with an [`Encoding`], registered in `encoder.rs`.

mod bands;
pub mod frequencies;
pub mod hash_grid;
pub mod rip_map;
pub mod tensor;
pub mod tri_mip;
pub mod voxels;

use crate::simd::Simd;
use crate::wire::Reader;
use std::ops::Range;
use trimip_core::engine::batch::{Interval, Ray, Sphere};
use trimip_core::engine::exchange::Rank;
use trimip_core::{Config, Result};

/// The interface of an encoder on the CPU.
pub(crate) trait Encoding: Sized + Send + Sync {
    /// Feature gradients collected from several tiles.
    type Gradient: Send + Sync;

    /// Creates the configured encoder; `training` adds room for gradients.
    fn new(simd: Simd, config: &Config, training: bool) -> Self;

    /// Creates an empty gradient.
    fn gradient(&self) -> Self::Gradient;

    /// Switches to the parameters that are in use at growth stage `stage`.
    fn grow(&mut self, _stage: u32) {}

    /// Rebuilds data derived from the parameters. If `all` is false, only parameters that the last gradient touched
    /// have changed.
    fn refresh(&mut self, _parameters: &[f32], _all: bool) {}

    /// Encodes every sample. A row of features has `stride` floats; those beyond the encoder's width stay zero. A row
    /// of the context has the length that the encoder's definition states.
    fn forward(&self, at: Places<'_>, context: &mut [f32], features: &mut [f32], stride: usize);

    /// Adds the gradients of a tile's features, which are rows of `stride` floats, to the partial gradients.
    fn backward(
        &self,
        at: Places<'_>,
        context: &[f32],
        rows: &[f32],
        stride: usize,
        gradient: &mut Self::Gradient,
    );

    /// Sums all partial gradients in order, overwrites the encoder's part of `parameter_gradient` with the sums, and empties the
    /// partial gradients.
    fn reduce(&mut self, gradients: &mut [&mut Self::Gradient], parameter_gradient: &mut [f32]);

    /// Returns the memory that the accumulated gradients need.
    fn gradient_memory(config: &Config) -> GradientMemory;

    /// Appends a set of partial gradients to a message.
    fn put(&self, gradient: &Self::Gradient, out: &mut Vec<u8>);

    /// Replaces a set of partial gradients with the set that another rank wrote with [`put`](Self::put).
    ///
    /// # Errors
    /// When the message is not a set of partial gradients of this encoder.
    fn take(&self, from: &mut Reader<'_>, gradient: &mut Self::Gradient) -> Result<()>;

    /// Returns the encoder as [`Divided`] if its parameters can be divided among ranks. Otherwise every rank receives and sums all
    /// partial gradients.
    fn divided(&mut self) -> Option<&mut dyn Divided> {
        None
    }

    /// Returns pieces of the first slot, outside of which the last gradient is zero; `None` if such pieces are unknown.
    fn touched(&self) -> Option<Vec<Piece<'_>>> {
        None
    }
}

/// The interface of an encoder whose parameters are divided among ranks. Each rank sums the gradient of its part and updates
/// it; then the ranks exchange the changed parameters.
pub(crate) trait Divided {
    /// Chooses this rank's part. [`Rank::ONLY`] divides nothing.
    fn divide(&mut self, this_rank: Rank);

    /// Writes the sums that rank `to` needs. Called after [`Encoding::reduce`], which sums the leaves of this rank.
    fn put_sums(&mut self, gradient: &mut [f32], to: usize, out: &mut Vec<u8>);

    /// Adds the sums that the other ranks wrote for this rank; `from` is indexed by rank. The gradient of this rank's part
    /// then includes the leaves of all ranks.
    ///
    /// # Errors
    /// When a message is not what [`put_sums`](Self::put_sums) writes for this rank.
    fn take_sums(&mut self, from: &[Vec<u8>], gradient: &mut [f32]) -> Result<()>;

    /// Completes the gradient of this rank's part: propagates the gradients of derived values to the parameters.
    fn complete(&mut self, gradient: &mut [f32]);

    /// Returns the touched pieces of this rank's part, see [`Encoding::touched`].
    fn pieces(&self) -> Option<Vec<Piece<'_>>>;

    /// Writes the changed parameters of this rank's part, after the update.
    fn put_changed(&self, parameters: &[f32], out: &mut Vec<u8>);

    /// Reads the changed parameters that `rank` wrote.
    ///
    /// # Errors
    /// When the message is not what [`put_changed`](Self::put_changed) writes on that rank.
    fn take_changed(&mut self, from: &mut Reader<'_>, rank: usize, parameters: &mut [f32]) -> Result<()>;

    /// Returns the parameters in the part of `rank`, as ranges of the first slot.
    fn part(&self, rank: usize) -> Vec<Range<usize>>;

    /// Returns the number of touched parameters of all ranks. Valid after [`take_changed`](Self::take_changed) has read
    /// the changes of every rank.
    fn count_touched(&self) -> usize;
}

/// Memory in bytes of a gradient that is collected until the end of a step.
pub(crate) struct GradientMemory {
    /// Bytes per sample.
    pub by_sample: usize,
    /// Bytes per set of partial gradients, however many samples it has.
    pub by_partial: usize,
}

/// The parameters, and the geometry of a tile's samples.
#[derive(Clone, Copy)]
pub(crate) struct Places<'a> {
    /// All parameters as a flat array, beginning with the encoder's.
    pub parameters: &'a [f32],
    /// Rays of the tile.
    pub rays: &'a [Ray],
    /// Index of each sample's ray.
    pub owners: &'a [u32],
    /// One per sample.
    pub intervals: &'a [Interval],
    /// One per sample.
    pub spheres: &'a [Sphere],
}

/// A part of a slot, divided into rows of `row` floats; a range of floats in each row is touched.
pub(crate) struct Piece<'a> {
    /// Number of floats in the piece.
    pub length: usize,
    /// Number of floats in a row.
    pub row: usize,
    /// Returns the range of touched floats in a row.
    pub within: Box<dyn Fn(usize) -> Range<usize> + Sync + 'a>,
}
