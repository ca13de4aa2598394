//! The runs of a comparison: a system on a scene with a seed, at the scales of a table.

use super::figures::Figures;
use serde::Serialize;
use std::path::PathBuf;

/// The scales of a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Scales {
    /// Trained and tested at 1/1, 1/2, 1/4 and 1/8.
    Four,
    /// Trained and tested only at 1/1.
    One,
}

impl Scales {
    /// Returns the number of scales: `data.scales`.
    pub fn count(self) -> u32 {
        if self == Self::Four { 4 } else { 1 }
    }

    /// Returns the title of the table.
    pub fn title(self) -> &'static str {
        if self == Self::Four { "Multi-scale" } else { "Single-scale" }
    }
}

/// State of a run.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "lowercase", tag = "status", content = "reason")]
#[non_exhaustive]
pub enum Status {
    /// Not begun by this command yet.
    Waiting,
    /// Stopped by the user; the same command resumes it.
    Stopped,
    /// Trained and evaluated.
    Finished,
    /// Failed, with the reason in one line.
    Failed(String),
}

/// One run: a system on a scene with a seed.
#[derive(Clone, Debug, Serialize)]
pub struct Run {
    /// The scales that the run is trained and tested at.
    pub scales: Scales,
    /// Name of the scene.
    pub scene: String,
    /// Name of the system.
    pub system: &'static str,
    /// Seed of its random numbers.
    pub seed: u64,
    /// Run folder.
    pub folder: PathBuf,
    /// State.
    #[serde(flatten)]
    pub status: Status,
    /// Figures of the run, once it is trained and evaluated.
    pub figures: Option<Figures>,
}
