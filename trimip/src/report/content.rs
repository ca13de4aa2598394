//! The content of a report, collected from the run folder and the event history.

use super::{correlation::rank_correlation, verdict::Verdict};
use crate::{
    machine::Machine,
    run::{
        folder::RunFolder,
        history::{Evaluation, History},
        store::{FileStore, ViewRecord},
    },
};
use trimip_core::{Config, Settings};

/// State of the run, shown at the head of the report.
#[derive(Clone, Debug, PartialEq)]
pub enum Status {
    /// Trained and evaluated.
    Finished,
    /// Stopped by the user; it can resume.
    Stopped,
    /// Failed, or missed its quality floor; one line.
    Failed(String),
}

/// How the PSNR of test views depends on their distance to the nearest training camera.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PsnrByDistance {
    /// Number of views.
    pub views: usize,
    /// Spearman's rank correlation of distance and PSNR, -1 to 1: -1 if every view that is farther away is worse.
    pub rank_correlation: f64,
    /// Least and greatest distance, as multiples of the median distance between a training camera and its nearest neighbour; `None` if that
    /// median is 0.
    pub spacings: Option<(f64, f64)>,
}

/// The content of a report.
pub struct Report<'a> {
    /// State of the run.
    pub status: Status,
    /// Name of the run: the name of its folder.
    pub run: String,
    /// Name of the scene.
    pub scene: String,
    /// The effective configuration.
    pub config: &'a Config,
    /// The effective configuration with the origin of each value.
    pub settings: &'a Settings,
    /// The run's event history.
    pub history: &'a History,
    /// The machine that the report was made on.
    pub machine: Machine,
    /// Size of the model file, bytes.
    pub model_bytes: Option<u64>,
    /// Every view of the final evaluation.
    pub views: Vec<ViewRecord>,
}

impl<'a> Report<'a> {
    /// Collects the content from the run folder and the history.
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
            run: folder_name(folder),
            scene: scene.to_string(),
            config,
            settings,
            history,
            machine: Machine::detect(),
            model_bytes: std::fs::metadata(folder.model()).ok().map(|metadata| metadata.len()),
            views: if ended { FileStore::read(folder) } else { Vec::new() },
        }
    }

    /// Returns the verdict on the run.
    pub fn verdict(&self) -> Verdict {
        Verdict::judge(self.config, self.history, &self.views)
    }

    /// Relates the PSNR of the finest scale's views to their distance from the nearest training camera. `None` with fewer than four views
    /// that have both values, or if all distances or all PSNRs are equal.
    pub fn psnr_by_distance(&self) -> Option<PsnrByDistance> {
        let finest = self.views.iter().map(|view| view.scale).min()?;
        let views = || self.views.iter().filter(|view| view.scale == finest);
        let pairs: Vec<(f64, f64)> =
            views().filter_map(|view| Some((view.nearest_distance?, view.psnr?))).collect();
        let spacings: Vec<f64> = views().filter_map(|view| view.nearest_spacings).collect();
        let least = spacings.iter().copied().reduce(f64::min);
        let greatest = spacings.iter().copied().reduce(f64::max);
        let rank_correlation = rank_correlation(&pairs)?;
        Some(PsnrByDistance { views: pairs.len(), rank_correlation, spacings: least.zip(greatest) })
    }

    /// Names the views that the headline figures are measured on: `8 of 200 test views`.
    pub fn views_measured(&self) -> String {
        let Some(e) = self.headline() else { return "not evaluated".into() };
        let of = self.history.test_views().map_or(String::new(), |all| format!(" of {all}"));
        let which = if e.last { "" } else { ", during training" };
        format!("{}{of} test views{which}", e.views())
    }

    /// Returns the headline figures: those of the final evaluation, or else of the latest one.
    pub fn headline(&self) -> Option<&Evaluation> {
        self.history.best_known()
    }

    /// Returns the evaluations that form the curve of error against time, in step order.
    pub fn curve(&self) -> Vec<&Evaluation> {
        self.history.curve()
    }

    /// Returns the number of kept samples per second of training.
    pub fn samples_per_second(&self) -> Option<f64> {
        let totals = &self.history.totals;
        (totals.seconds > 0.0).then(|| totals.samples as f64 / totals.seconds)
    }
}

/// Returns the name of the folder; for the path `.`, that of the folder that it stands for.
fn folder_name(folder: &RunFolder) -> String {
    let root = std::fs::canonicalize(folder.root()).unwrap_or_else(|_| folder.root().to_path_buf());
    root.file_name().map_or_else(|| "run".into(), |name| name.to_string_lossy().into_owned())
}

/// Returns the name of a scale: `full`, `1/2`, ..
pub fn scale_name(scale: u32) -> String {
    if scale == 1 { "full".into() } else { format!("1/{scale}") }
}
