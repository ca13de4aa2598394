//! Progress of reading or rendering a scene, in rows of pixels.

use crate::source::Source;
use std::sync::atomic::{AtomicU64, Ordering};

/// Receives, from any thread, how many rows of the finest views are done, and their total.
pub type Watch<'a> = &'a (dyn Fn(u64, u64) + Sync);

/// A [`Watch`] that does nothing.
pub fn unwatched(_: u64, _: u64) {}

/// Counts rows for a watch.
pub(crate) struct Meter<'a> {
    done: AtomicU64,
    total: u64,
    watch: Watch<'a>,
}

impl<'a> Meter<'a> {
    /// A meter over all rows of `sources`; reports 0 rows to the watch.
    pub(crate) fn new<'s>(sources: impl IntoIterator<Item = &'s Source>, watch: Watch<'a>) -> Self {
        let total = sources.into_iter().map(Source::rows).sum();
        watch(0, total);
        Self { done: AtomicU64::new(0), total, watch }
    }

    /// `rows` more are done.
    pub(crate) fn add(&self, rows: u64) {
        let done = self.done.fetch_add(rows, Ordering::Relaxed) + rows;
        (self.watch)(done, self.total);
    }
}
