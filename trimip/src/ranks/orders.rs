//! The orders of rank 0, in the form in which they are sent.

use crate::backends;
use serde::{Deserialize, Serialize};
use trimip_core::engine::exchange::{Rank, Ranks};
use trimip_core::{Config, Error, Result, scene::fingerprint::Fingerprint};

/// An order of rank 0 to the other ranks.
#[derive(Serialize, Deserialize)]
pub enum Order {
    /// Open the data of this configuration (TOML) and train on it. The views must match the fingerprint `data`; `computes` is the
    /// device or instruction set of rank 0.
    Train { version: String, config: String, data: Fingerprint, computes: String },
    /// One step of the training.
    Step(f64),
    /// Take part in collecting a checkpoint.
    Checkpoint,
    /// Continue from the checkpoint whose bytes follow.
    Restore,
    /// The training is over.
    Close,
    /// Work on the jobs that are sent one by one.
    Jobs { version: String },
    /// The program ends.
    Quit,
}

/// Answer of a rank to the order to train: nothing, or the error that prevents it.
pub type Opened = Result<()>;

impl Order {
    /// Gives the order to every other rank.
    ///
    /// # Errors
    /// When another rank is gone.
    pub fn give(&self, ranks: &dyn Ranks) -> Result<()> {
        ranks.broadcast(&mut serde_json::to_vec(self).map_err(Error::run)?)
    }

    /// Waits for the next order of rank 0.
    ///
    /// # Errors
    /// When rank 0 is gone, or its order is not understood.
    pub fn await_from(ranks: &dyn Ranks) -> Result<Self> {
        let mut bytes = Vec::new();
        ranks.broadcast(&mut bytes)?;
        serde_json::from_slice(&bytes)
            .map_err(|error| Error::run(format!("cannot read an order of rank 0: {error}")))
    }
}

/// Returns the device of a rank, or the instruction set of its processor. `near` is the rank of the process on its machine.
///
/// # Errors
/// When there is no such device.
pub fn computes_with(config: &Config, near: Rank) -> Result<String> {
    Ok(match config.backend.as_str() {
        // The list begins with the widest instruction set, which is the one in use.
        "cpu" => trimip_cpu::features().split(',').next().unwrap_or_default().into(),
        _ => backends::compute(config, near)?.name,
    })
}
