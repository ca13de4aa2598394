//! Progress of reading or rendering a scene, in rows of pixels.

use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use trimip_core::{Error, Result};

/// Receives, from any thread, the number of finished rows of the finest views, and their total. Returning false stops
/// the work after the photographs in progress.
pub type Watch<'a> = &'a (dyn Fn(u64, u64) -> bool + Sync);

/// Ignores progress and never stops the work: the [`Watch`] for callers that need none.
pub fn unwatched(_: u64, _: u64) -> bool {
    true
}

/// Counts rows for a watch.
pub(crate) struct Meter<'a> {
    done: AtomicU64,
    total: u64,
    stopped: AtomicBool,
    watch: Watch<'a>,
}

impl<'a> Meter<'a> {
    /// Creates a meter of `total` rows, and reports 0 rows to the watch.
    pub(crate) fn new(total: u64, watch: Watch<'a>) -> Self {
        let stopped = !watch(0, total);
        Self { done: AtomicU64::new(0), total, stopped: stopped.into(), watch }
    }

    /// Adds `rows` finished rows.
    pub(crate) fn add(&self, rows: u64) {
        let done = self.done.fetch_add(rows, Ordering::Relaxed) + rows;
        if !(self.watch)(done, self.total) {
            self.stopped.store(true, Ordering::Relaxed);
        }
    }

    /// Checks that the work should continue.
    ///
    /// # Errors
    /// Of kind `Stopped`, once the watch has returned false.
    pub(crate) fn goes_on(&self) -> Result<()> {
        if self.stopped.load(Ordering::Relaxed) { Err(Error::stopped()) } else { Ok(()) }
    }
}
