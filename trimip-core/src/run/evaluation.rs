//! The evaluations of a run: which test views, at which scales, within which time.

use super::{Outcome, Run, Store};
use crate::{
    Error, Result,
    engine::events::{Event, EventSink, Totals},
    measures::{
        perception::{Pair, Perception, PerceptualScores},
        quality::{Measures, ViewQuality, mean_quality, per_scale},
    },
    run::{
        evaluate::{TestFrames, ViewResult, Watch, evaluate_frame},
        timekeeper::{Timekeeper, strides},
    },
};
use std::sync::atomic::{AtomicBool, Ordering};
use web_time::{Duration, Instant};

/// Interval between two progress events of an evaluation.
const TELL_EVERY: Duration = Duration::from_millis(500);

/// An evaluation ends after this multiple of its allowed time, because predictions may be wrong. The result then has
/// the views of the strides that were completed.
const AT_MOST: f64 = 4.0;

/// The final evaluation spends up to this multiple of its allowed time on one whole view before it leaves out full
/// size.
const FULL_SIZE: f64 = 2.0;

/// Up to this progress, an evaluation covers at least half of the views of the evaluation curve, or is skipped.
const EARLY: f64 = 0.3;

/// The extent of an evaluation.
struct Coverage {
    views: Vec<ViewQuality>,
    /// Stride: every `stride`-th test view was measured.
    stride: usize,
    /// True if finer scales were left out.
    coarse: bool,
}

/// The moment of an evaluation.
#[derive(Clone, Copy)]
struct Moment<'a> {
    /// The totals of the run.
    totals: &'a Totals,
    /// True for the evaluation at the end of the run.
    last: bool,
    /// Start of the evaluation.
    started: Instant,
}

/// The outcome of an evaluation.
enum Attempt {
    /// Views were measured.
    Measured(Coverage),
    /// There was no time for a single view, even without the scales finer than this factor.
    NoTime(u32),
    /// The run was asked to stop.
    Stopped,
}

impl Run<'_> {
    /// Evaluates during training. Emits no result if the run was asked to stop or there is no time for a view.
    pub(super) fn evaluate_on_the_way(&mut self, totals: &Totals, keeper: &mut Timekeeper) -> Result<()> {
        let started = Instant::now();
        let frames = self.frames.len();
        let stride = self.config.eval.stride_of(frames);
        let allowed = keeper.on_the_way(totals.seconds / self.progress(totals).max(f64::MIN_POSITIVE));
        let mut chain = strides(frames, stride, stride);
        if self.progress(totals) < EARLY {
            // Early in a run the scene is fog, which renders slowly. A missing point of the curve is better than a
            // point measured on other views than the later points.
            let few = chain.len().saturating_sub(2);
            chain.drain(..few);
        }
        let attempt = self.measure_views(&chain, allowed, keeper, false);
        keeper.spend(started.elapsed().as_secs_f64());
        if let Attempt::Measured(coverage) = attempt? {
            keeper.covered(coverage.stride);
            self.report(&coverage, [coverage.stride, stride], Moment { totals, last: false, started });
        }
        Ok(())
    }

    pub(super) fn evaluate_at_the_end(
        &mut self,
        totals: &Totals,
        keeper: &mut Timekeeper,
    ) -> Result<Outcome> {
        if 2 * totals.empty_batches > totals.step {
            return Err(Error::run(format!(
                "{} of {} steps kept no sample: nothing was learned from them; look at the cameras and at the box \
                 (trimip-cli plan), or lower occupancy.threshold",
                totals.empty_batches, totals.step
            )));
        }
        let frames = self.frames.len();
        let Some(wanted) = self.config.eval.final_stride(frames).filter(|_| frames > 0) else {
            return Ok(Outcome::Finished);
        };
        let started = Instant::now();
        let curve = self.config.eval.stride_of(frames);
        let allowed = keeper.at_the_end(totals.seconds / self.progress(totals).max(f64::MIN_POSITIVE));
        let coverage = loop {
            match self.measure_views(&strides(frames, curve, wanted), allowed, keeper, true)? {
                Attempt::Measured(coverage) => break coverage,
                Attempt::Stopped => {
                    self.events.emit(&Event::Stopped { totals: *totals });
                    return Ok(Outcome::Stopped);
                }
                // The keeper has recorded how slow a pixel is, so the next attempt is coarser.
                Attempt::NoTime(finest) if finest < self.coarsest() => {}
                Attempt::NoTime(_) => {
                    return Err(Error::run(format!(
                        "no test view could be rendered within {allowed:.0} s; the model is written: measure it with trimip-cli \
                         eval, which has no time limit, or set eval.time_fraction = 0"
                    )));
                }
            }
        };
        self.store.evaluated()?;
        // The last point of the curve uses the same views as most other points.
        let usual = keeper.usual_stride(curve);
        if self.config.eval.points > 0 && usual != coverage.stride && usual.is_multiple_of(coverage.stride) {
            self.report(&coverage, [usual, curve], Moment { totals, last: false, started });
        }
        let mean = self.report(&coverage, [coverage.stride, wanted], Moment { totals, last: true, started });
        mean.judge(&self.config.eval)?;
        Ok(Outcome::Finished)
    }

    /// Returns the mean number of pixels of a test frame, all of its scales together.
    pub(super) fn pixels_of_a_view(&self) -> f64 {
        let area = |k: &crate::Intrinsics| f64::from(k.width) * f64::from(k.height);
        let pixels: f64 = self.frames.cameras().iter().map(|camera| area(&camera.intrinsics)).sum();
        pixels / self.frames.len().max(1) as f64
    }

    /// Returns the largest factor by which test views are reduced.
    fn coarsest(&self) -> u32 {
        1 << (self.config.data.scales - 1)
    }

    /// Measures every n-th view, where n is the finest of `strides` that fits into `allowed` seconds. If the time is
    /// too short for one whole view, measures only coarse scales; the final evaluation accepts a longer time before it
    /// leaves out full size.
    fn measure_views(
        &mut self,
        strides: &[usize],
        allowed: f64,
        keeper: &mut Timekeeper,
        last: bool,
    ) -> Result<Attempt> {
        let (frames, started) = (self.frames.len(), Instant::now());
        let whole = self.pixels_of_a_view();
        let patience = if last { FULL_SIZE } else { 1.0 };
        let least = strides.first().map_or(0, |&stride| frames.div_ceil(stride)) as f64;
        // Finer scales are left out only if a single view is too slow. If several views are too slow, fewer are
        // measured.
        let finest = match least <= 1.0 {
            true => keeper.finest(whole, patience * allowed, self.coarsest()),
            false => 1,
        };
        let of_a_view = whole / f64::from(finest * finest);
        if !last && keeper.pixel() * of_a_view * least > allowed {
            return Ok(Attempt::NoTime(finest));
        }
        let perceptual = perceptual_stride(strides, frames, self.config.eval.perceptual_views as usize);
        let Self { session, perception, store, events, stop, .. } = self;
        let mut watch = Watcher {
            perception: match perceptual {
                Some(stride) if last => Some((&mut **perception, stride)),
                _ => None,
            },
            store: last.then_some(&mut **store),
            events: &mut **events,
            stop,
            deadline: Duration::try_from_secs_f64(AT_MOST * allowed.max(5.0))
                .ok()
                .and_then(|most| started.checked_add(most)),
            told: None,
            done: 0,
            total: 1,
        };
        let test = TestFrames { frames: self.frames, data: &self.config.data, finest };
        let mut coverage = None;
        let mut views = Vec::new();
        let mut measured = 0_usize;
        for (i, &stride) in strides.iter().enumerate() {
            let before = i.checked_sub(1).map(|before| strides[before]);
            let is_new = |index: &usize| before.is_none_or(|before| !index.is_multiple_of(before));
            let indices: Vec<usize> = (0..frames).step_by(stride).filter(is_new).collect();
            let each = started.elapsed().as_secs_f64() / measured.max(1) as f64;
            if measured > 0 && each * (measured + indices.len()) as f64 > allowed {
                break;
            }
            watch.total = measured + indices.len();
            for index in indices {
                if !evaluate_frame(*session, test, index, &mut watch, &mut views)? {
                    if watch.stop.load(Ordering::Relaxed) {
                        return Ok(Attempt::Stopped);
                    }
                    keeper.rendered(started.elapsed().as_secs_f64(), (measured + 1) as f64 * of_a_view);
                    return Ok(coverage.map_or(Attempt::NoTime(finest), Attempt::Measured));
                }
                (measured, watch.done) = (measured + 1, measured + 1);
            }
            coverage = Some(Coverage { views: views.clone(), stride, coarse: finest > 1 });
        }
        keeper.rendered(started.elapsed().as_secs_f64(), measured as f64 * of_a_view);
        Ok(coverage.map_or(Attempt::NoTime(finest), Attempt::Measured))
    }

    /// Emits the results of an evaluation over every `stride`-th view; `wanted` is the requested stride.
    fn report(&mut self, coverage: &Coverage, [stride, wanted]: [usize; 2], moment: Moment<'_>) -> Measures {
        let Moment { totals, last, started } = moment;
        let scales = per_scale(&coverage.views, stride);
        let mean = mean_quality(&scales);
        self.events.emit(&Event::Evaluation {
            totals: *totals,
            stride,
            frames: self.frames.len(),
            bounded: coverage.coarse || stride > wanted,
            last,
            psnr: mean.psnr,
            ssim: mean.ssim,
            scales,
            seconds: started.elapsed().as_secs_f64(),
        });
        mean
    }
}

/// Reports the progress of an evaluation, and ends the evaluation on request or when it takes too long.
struct Watcher<'a> {
    /// The measures of perception, and the stride of the views that get them: views whose index is a multiple of this
    /// stride.
    perception: Option<(&'a mut dyn Perception, usize)>,
    store: Option<&'a mut dyn Store>,
    events: &'a mut dyn EventSink,
    stop: &'a AtomicBool,
    deadline: Option<Instant>,
    told: Option<Instant>,
    done: usize,
    total: usize,
}

impl Watcher<'_> {
    fn goes_on(&self) -> bool {
        !self.stop.load(Ordering::Relaxed) && self.deadline.is_none_or(|deadline| Instant::now() < deadline)
    }
}

impl Watch for Watcher<'_> {
    fn rows(&mut self, rows: u32, of: u32) -> bool {
        if self.told.is_none_or(|told| told.elapsed() >= TELL_EVERY) {
            self.told = Some(Instant::now());
            let part = f64::from(rows) / f64::from(of.max(1));
            self.events.emit(&Event::EvaluationProgress { done: self.done, total: self.total, part });
        }
        self.goes_on()
    }

    fn measure_perception(&mut self, index: usize, pair: &Pair<'_>) -> Result<PerceptualScores> {
        match &mut self.perception {
            Some((perception, stride)) if index.is_multiple_of(*stride) => {
                perception.measure_perception(pair)
            }
            _ => Ok(PerceptualScores::NOTHING),
        }
    }

    fn view(&mut self, view: &ViewResult<'_>) -> Result<bool> {
        if let Some(store) = &mut self.store {
            store.view(view)?;
        }
        Ok(self.goes_on())
    }
}

/// Returns the finest of `strides` that selects at most `most` of `frames` views for the measures of perception, or
/// `None` if no stride is so coarse. The strides are multiples of each other, so an evaluation without time for finer
/// strides has these measures for all of its views or for an evenly spread part of them.
fn perceptual_stride(strides: &[usize], frames: usize, most: usize) -> Option<usize> {
    strides.iter().copied().filter(|stride| frames.div_ceil(*stride) <= most).min()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn perceived_views_are_evenly_spread_among_those_that_are_measured() {
        let chain = strides(200, 50, 1);
        assert_eq!(perceptual_stride(&chain, 200, 40), Some(5));
        assert_eq!(perceptual_stride(&chain, 200, 200), Some(1));
        assert_eq!(perceptual_stride(&strides(7, 1, 1), 7, 40), Some(1));
        assert_eq!(perceptual_stride(&chain, 200, 0), None);
        for most in 1..=200 {
            let stride = perceptual_stride(&chain, 200, most).unwrap();
            assert!(200_usize.div_ceil(stride) <= most);
            assert!(chain.iter().all(|other| other.is_multiple_of(stride) || stride.is_multiple_of(*other)));
        }
    }
}
