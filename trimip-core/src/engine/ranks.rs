//! The transport between the processes that train one model, called ranks: MPI, or channels between threads.

use crate::{Error, Result};

/// A rank's share of the work of all ranks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Rank {
    /// Number of this rank, from 0.
    pub id: usize,
    /// Number of ranks.
    pub size: usize,
}

impl Rank {
    /// The only rank, which does all of the work.
    pub const ONLY: Self = Self { id: 0, size: 1 };

    /// Returns true if item `index` belongs to this rank, when work is dealt out round-robin.
    pub fn has(self, index: usize) -> bool {
        index % self.size == self.id
    }

    /// Returns the part of `count` items that belongs to this rank, when every rank takes a contiguous part.
    pub fn part(self, count: u32) -> std::ops::Range<u32> {
        let bound = |rank: usize| (u64::from(count) * rank as u64 / self.size as u64) as u32;
        bound(self.id)..bound(self.id + 1)
    }
}

/// Returns the error for an unexpected message from another rank. It has the kind of the error for a lost rank, because
/// the results of the other ranks are unavailable in both cases.
pub fn fault(what: impl std::fmt::Display) -> Error {
    Error::device(format!(
        "message of another rank: {what}; start the same build of the program on every rank"
    ))
}

/// The processes that train one model together. Every rank makes the same calls in the same order; a call returns when
/// this rank has what it needs from the others.
pub trait Ranks: Send + Sync {
    /// Returns this rank among all ranks.
    fn rank(&self) -> Rank;

    /// Returns this rank among the ranks on the same machine.
    fn on_machine(&self) -> Rank {
        self.rank()
    }

    /// Sends `out[r]` to every other rank r, and stores the bytes that rank r sent to this rank in `into[r]`. Both
    /// slices have one entry per rank; the entries of this rank are not used.
    ///
    /// # Errors
    /// When another rank is gone.
    fn all_to_all(&self, out: &[&[u8]], into: &mut [Vec<u8>]) -> Result<()>;

    /// Replaces `bytes` on every rank with those of rank 0.
    ///
    /// # Errors
    /// When another rank is gone.
    fn broadcast(&self, bytes: &mut Vec<u8>) -> Result<()>;

    /// Sends a message to one rank, which must [`receive`](Self::receive) it.
    ///
    /// # Errors
    /// When that rank is gone.
    fn send(&self, to: usize, bytes: &[u8]) -> Result<()>;

    /// Waits for a message from any rank; returns its sender and its bytes.
    ///
    /// # Errors
    /// When another rank is gone.
    fn receive(&self) -> Result<(usize, Vec<u8>)>;

    /// Returns a message that has arrived from any rank, with its sender; `None` if there is none.
    ///
    /// # Errors
    /// When another rank is gone.
    fn try_receive(&self) -> Result<Option<(usize, Vec<u8>)>>;

    /// Records, after a step, the size in bytes of the part of the gradient that the step touched.
    fn record_traffic(&self, touched: u64) {
        let _ = touched;
    }
}
