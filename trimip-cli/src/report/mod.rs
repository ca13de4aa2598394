//! The report of a run: one self-contained HTML page for people, JSON for programs, CSV for plots. All three are made
//! from the run folder and the history of events, so that they can be made again at any time.

pub mod csv;
pub mod html;
mod json;
mod pictures;
pub mod svg;

use crate::{
    history::{Evaluation, History},
    machine::Machine,
    run_folder::RunFolder,
    store::{FileStore, ViewRecord},
};
use trimip_core::{Config, Result, Settings, tensors::write_atomically};

/// How far the run came, for the head of the report.
#[derive(Clone, Debug, PartialEq)]
pub enum Status {
    /// Trained and evaluated.
    Finished,
    /// Stopped by the user; it can go on.
    Stopped,
    /// It failed, or missed its quality floor: one line.
    Failed(String),
}

/// Everything a report shows.
pub struct Report<'a> {
    /// How far the run came.
    pub status: Status,
    /// Name of the scene.
    pub scene: String,
    /// The effective configuration.
    pub config: &'a Config,
    /// The same with origins.
    pub settings: &'a Settings,
    /// The course of the run.
    pub history: &'a History,
    /// Where it ran.
    pub machine: Machine,
    /// Size of the model file.
    pub model_bytes: Option<u64>,
    /// Every view of the final evaluation.
    pub views: Vec<ViewRecord>,
}

impl<'a> Report<'a> {
    /// Gathers what the run folder and the history hold.
    pub fn gather(
        folder: &RunFolder,
        status: Status,
        scene: &str,
        config: &'a Config,
        settings: &'a Settings,
        history: &'a History,
    ) -> Self {
        let ended = history.last().is_some();
        Self {
            status,
            scene: scene.to_string(),
            config,
            settings,
            history,
            machine: Machine::detect(),
            model_bytes: std::fs::metadata(folder.model()).ok().map(|metadata| metadata.len()),
            views: if ended { FileStore::read(folder) } else { Vec::new() },
        }
    }

    /// Writes `report.html`, `report.json` and `error_vs_time.csv`.
    pub fn write(&self, folder: &RunFolder) -> Result<()> {
        csv::write(&folder.curve(), self.history)?;
        write_atomically(&folder.json(), json::text(self)?.as_bytes())?;
        write_atomically(&folder.html(), html::page(self, &folder.images())?.as_bytes())
    }

    /// The measures the report leads with: the final ones, else the latest.
    fn headline(&self) -> Option<&Evaluation> {
        self.history.best_known()
    }

    /// The evaluations of the curve.
    fn curve(&self) -> Vec<&Evaluation> {
        self.history.curve()
    }

    /// Kept samples per second of training.
    fn samples_per_second(&self) -> Option<f64> {
        let totals = &self.history.totals;
        (totals.seconds > 0.0).then(|| totals.samples as f64 / totals.seconds)
    }
}

/// A report of two evaluations on a small curve, for tests of the writers.
#[cfg(test)]
fn example(test: impl FnOnce(&Report<'_>)) {
    use crate::history::tests::evaluation;
    use trimip_core::events::Event;
    let settings = Settings::defaults();
    let config = Config::default();
    let history = History::of(&[
        Event::Warning { message: "a <dark> image".into() },
        evaluation(10, 25, false, 20.0),
        evaluation(100, 25, false, 25.0),
        evaluation(100, 1, true, 24.5),
    ]);
    test(&Report {
        status: Status::Finished,
        scene: "lego & co".into(),
        config: &config,
        settings: &settings,
        history: &history,
        machine: Machine::detect(),
        model_bytes: Some(1_000),
        views: Vec::new(),
    });
}
