//! Measures of a model per scale on a set of test photographs.

use std::time::Instant;
use trimip_core::{
    Frames, Result, Viewer,
    config::DataConfig,
    evaluate::{ViewResult, Watch, evaluate_frame},
    perception::{Pair, Perceived, Perception},
    quality::{Measures, ScaleQuality, ViewQuality, mean_quality, per_scale},
};

/// Result of an evaluation.
#[derive(Clone, Debug)]
pub struct Measured {
    /// Every view, each at all of its scales.
    pub views: Vec<ViewQuality>,
    /// Means per scale, fine to coarse.
    pub scales: Vec<ScaleQuality>,
    /// Means over the scales.
    pub mean: Measures,
    /// Time for rendering and measuring, seconds.
    pub seconds: f64,
}

/// Observes an evaluation. Each method returns false to cancel it.
pub trait Watching {
    /// Called while rendering: `done` of `total` test views are rendered, and `part` (0 to 1) of the next one.
    fn rendering(&mut self, done: usize, total: usize, part: f64) -> bool {
        let _ = (done, total, part);
        true
    }

    /// Called after a view is rendered and measured; `done` of `total` views came before it.
    fn view(&mut self, view: &ViewResult<'_>, done: usize, total: usize) -> bool {
        let _ = (view, done, total);
        true
    }
}

/// No observer.
impl Watching for () {}

/// Renders every `stride`-th test view at every scale, on the background and by the convention of
/// `data`, and compares it with its photograph; `perception` takes the slower measures ([`Perceiver`](super::Perceiver), or
/// `&mut ()` for none). Returns `None` if `watch` cancelled it.
///
/// # Errors
/// When a photograph cannot be read, or the device fails.
pub fn evaluate(
    viewer: &mut dyn Viewer,
    frames: &dyn Frames,
    data: &DataConfig,
    stride: usize,
    perception: &mut dyn Perception,
    watch: &mut dyn Watching,
) -> Result<Option<Measured>> {
    let (started, stride) = (Instant::now(), stride.max(1));
    let mut progress = Progress { perception, watch, done: 0, total: frames.len().div_ceil(stride) };
    let mut views = Vec::new();
    for index in (0..frames.len()).step_by(stride) {
        if !evaluate_frame(viewer, frames, index, 1, data, &mut progress, &mut views)? {
            return Ok(None);
        }
        progress.done += 1;
    }
    let scales = per_scale(&views, 1);
    let mean = mean_quality(&scales);
    Ok(Some(Measured { views, scales, mean, seconds: started.elapsed().as_secs_f64() }))
}

/// Counts views.
struct Progress<'a> {
    perception: &'a mut dyn Perception,
    watch: &'a mut dyn Watching,
    done: usize,
    total: usize,
}

impl Watch for Progress<'_> {
    fn rows(&mut self, rows: u32, of: u32) -> bool {
        self.watch.rendering(self.done, self.total, f64::from(rows) / f64::from(of.max(1)))
    }

    fn perceive(&mut self, _: usize, pair: &Pair<'_>) -> Result<Perceived> {
        self.perception.perceive(pair)
    }

    fn view(&mut self, view: &ViewResult<'_>) -> Result<bool> {
        Ok(self.watch.view(view, self.done, self.total))
    }
}
