//! Measures the quality of a model per scale on a set of test photographs.

use crate::ranks;
use std::cell::RefCell;
use std::time::Instant;
use trimip_core::{
    Frames, Result, Viewer,
    config::PhotographsConfig,
    engine::exchange::Ranks,
    field::model::Model,
    measures::{
        perception::{Pair, Perception, PerceptualScores},
        quality::{Measures, ScaleQuality, ViewQuality, mean_quality, per_scale},
    },
    run::evaluate::{TestFrames, ViewResult, Watch, evaluate_frame},
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
    /// Called while rendering: `done` of `total` test views are rendered, and the fraction `part` (0 to 1) of the next one.
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

/// Ranks that measure a model together.
#[derive(Clone, Copy)]
pub struct RankGroup<'a> {
    /// The ranks.
    pub ranks: &'a dyn Ranks,
    /// The model, which has to be the same on all ranks.
    pub model: &'a Model,
}

/// The test views that a model is compared with.
#[derive(Clone, Copy)]
pub struct TestViews<'a> {
    /// All test views.
    pub frames: &'a dyn Frames,
    /// Settings of the background and of the photographs' convention.
    pub data: &'a PhotographsConfig,
    /// Stride: every n-th view is compared.
    pub stride: usize,
}

impl<'a> TestViews<'a> {
    /// Returns the number of views that are compared.
    fn count(&self) -> usize {
        self.frames.len().div_ceil(self.stride.max(1))
    }

    /// Returns the index of the frame of compared view number `job`.
    fn index(&self, job: usize) -> usize {
        job * self.stride.max(1)
    }

    /// Returns the frames at all of their scales.
    fn at_every_scale(&self) -> TestFrames<'a> {
        TestFrames { frames: self.frames, data: self.data, finest: 1 }
    }
}

/// Renders test views at every scale and compares them with their photographs; `perception` computes the slower measures
/// ([`PerceptualMetrics`](super::PerceptualMetrics), or `&mut ()` for none). Returns `None` if `watch` cancelled the evaluation. With
/// `group`, all ranks measure: this process is rank 0, and the others call [`evaluate_on_worker`] with the same model and frames.
///
/// # Errors
/// When a photograph cannot be read, the device fails, or another rank is gone.
pub fn evaluate(
    viewer: &mut dyn Viewer,
    test: TestViews<'_>,
    perception: &mut dyn Perception,
    watch: &mut dyn Watching,
    group: Option<RankGroup<'_>>,
) -> Result<Option<Measured>> {
    let (started, frames, total) = (Instant::now(), test.at_every_scale(), test.count());
    let mut progress = Progress { perception, watch, done: 0, total };
    let mut views = Vec::new();
    match group {
        None => {
            for job in 0..total {
                if !evaluate_frame(viewer, frames, test.index(job), &mut progress, &mut views)? {
                    return Ok(None);
                }
                progress.done += 1;
            }
        }
        Some(group) => {
            let progress = RefCell::new(progress);
            let own = |job| {
                let (mut views, progress) = (Vec::new(), &mut *progress.borrow_mut());
                let whole = evaluate_frame(viewer, frames, test.index(job), progress, &mut views)?;
                Ok(whole.then_some(views))
            };
            let mut is_whole = true;
            ranks::scatter_jobs(
                group.ranks,
                &description(test, group.model)?,
                &(0..total).collect::<Vec<_>>(),
                &|| true,
                own,
                |_, measured: Option<Vec<ViewQuality>>| {
                    let progress = &mut *progress.borrow_mut();
                    progress.done += 1;
                    is_whole = measured.is_some() && progress.watch.rendering(progress.done, total, 0.0);
                    views.extend(measured.unwrap_or_default());
                    Ok(is_whole)
                },
            )?;
            if !is_whole {
                return Ok(None);
            }
        }
    }
    let scales = per_scale(&views, 1);
    let mean = mean_quality(&scales);
    Ok(Some(Measured { views, scales, mean, seconds: started.elapsed().as_secs_f64() }))
}

/// Returns the description of the jobs of [`evaluate`], which ranks compare.
fn description(test: TestViews<'_>, model: &Model) -> Result<String> {
    let TestViews { frames, data, stride } = test;
    // The last bits of f64 may differ between machines.
    let cameras: Vec<f32> =
        frames.cameras().iter().flat_map(|camera| camera.numbers()).map(|number| number as f32).collect();
    Ok(ranks::digest([
        frames.len().to_string(),
        stride.max(1).to_string(),
        format!("{data:?} {cameras:?}"),
        model.hash()?.to_string(),
    ]))
}

/// Measures the test views that rank 0 hands out in [`evaluate`]. `watch` can cancel a view.
///
/// # Errors
/// When rank 0 is gone, or measures other views.
pub fn evaluate_on_worker(
    viewer: &mut dyn Viewer,
    test: TestViews<'_>,
    perception: &mut dyn Perception,
    watch: &mut dyn Watching,
    group: RankGroup<'_>,
) -> Result<()> {
    let mut progress = Progress { perception, watch, done: 0, total: 0 };
    ranks::work_on_jobs(group.ranks, &description(test, group.model)?, |job| {
        let mut views = Vec::new();
        let whole =
            evaluate_frame(viewer, test.at_every_scale(), test.index(job), &mut progress, &mut views)?;
        Ok(whole.then_some(views))
    })
}

/// Forwards progress to the observer, with the number of views done.
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

    fn measure_perception(&mut self, _: usize, pair: &Pair<'_>) -> Result<PerceptualScores> {
        self.perception.measure_perception(pair)
    }

    fn view(&mut self, view: &ViewResult<'_>) -> Result<bool> {
        Ok(self.watch.view(view, self.done, self.total))
    }
}
