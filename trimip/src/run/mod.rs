//! A run in a folder: its files, its event history, and the training that writes both.

mod begin;
pub mod cameras;
mod crop;
pub mod csv;
pub mod curve;
#[cfg(any(test, feature = "fixtures"))]
pub mod fixtures;
pub mod folder;
pub mod history;
mod lock;
pub(crate) mod memory;
pub mod nearest;
pub mod overview;
pub mod provenance;
mod recorded;
mod recorder;
pub mod store;
pub mod train;

pub use begin::expect_same;
pub use crop::keep_crop;
pub use lock::{Lock, lock_for_writing};
pub use recorded::Recorded;
