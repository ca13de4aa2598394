//! The figures of one run, from its folder's history.

use serde::Serialize;
use trimip::run::{
    curve::{Evaluated, Measure, curve},
    train::Trained,
};
use trimip_core::{
    Config, Layout,
    config::Convention,
    measures::quality::{Measures, ScaleQuality, mean_quality},
};

/// The results of a run.
#[derive(Clone, Debug, Serialize)]
pub struct Figures {
    /// Measures of each scale, fine to coarse.
    pub scales: Vec<ScaleQuality>,
    /// Means of the scales.
    pub mean: Measures,
    /// Number of test views that were measured.
    pub views: usize,
    /// Number of test views in the split, if known.
    pub test_views: Option<usize>,
    /// Background of training and test views, sRGB from 0 to 1.
    pub background: [f32; 3],
    /// How coarse photographs are averaged.
    pub convention: Convention,
    /// Seconds of training.
    pub seconds: f64,
    /// Seconds of evaluations.
    pub evaluation_seconds: f64,
    /// Steps.
    pub steps: u64,
    /// Samples kept.
    pub samples: u64,
    /// Numbers of trained parameters: of the encoder and of the networks.
    pub parameters: [u64; 2],
    /// Size of the model file, bytes.
    pub model_bytes: Option<u64>,
    /// Peak resident memory, bytes; the photographs are part of it.
    pub peak_memory_bytes: Option<u64>,
    /// PSNR against seconds during training, on fewer test views.
    pub curve: Vec<Measure>,
}

impl Figures {
    /// Returns the figures of a run; `None` if the run was not trained and evaluated.
    pub fn of(trained: &Trained) -> Option<Self> {
        let (history, config) = (&trained.history, &trained.config);
        let last = history.last()?;
        let points = history.curve().into_iter().map(|e| Evaluated {
            measure: Measure { seconds: e.totals.seconds, psnr: e.psnr },
            ends: e.last,
            views: Some(e.stride.to_string()),
        });
        Some(Self {
            scales: last.scales.clone(),
            mean: mean_quality(&last.scales),
            views: last.views(),
            test_views: history.test_views(),
            background: config.data.background,
            convention: config.data.convention,
            seconds: history.totals.seconds,
            evaluation_seconds: history.evaluation_seconds(),
            steps: history.totals.step,
            samples: history.totals.samples,
            parameters: parameters(config),
            model_bytes: trained.model_bytes(),
            peak_memory_bytes: history.peak_memory_bytes(),
            curve: curve(points).map_or_else(Vec::new, |(points, _)| points),
        })
    }
}

/// Returns the number of trained parameters of the encoder and of the networks.
fn parameters(config: &Config) -> [u64; 2] {
    let layout = Layout::new(config);
    [layout.encoder(), layout.networks()].map(|slots| slots.iter().map(|slot| slot.range.len() as u64).sum())
}
