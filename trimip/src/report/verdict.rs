//! The verdict on a run in words: a pure function of its final evaluation, its last training figures and the spread of
//! its test views. PSNR in dB, shares from 0 to 1.

use crate::{
    formatting,
    run::{
        history::{Evaluation, History, Training},
        store::ViewRecord,
    },
};
use trimip_core::{
    Config,
    measures::quality::{MOST_PSNR, Measures, Remedy, mean_quality},
};

/// Minimum mean PSNR of a good model: an error of 5.6 % of the range. Below it, edges are visibly blurred.
const GOOD: f64 = 25.0;
/// Minimum gain of a good model over the PSNR of each photograph's mean colour: a sixteenth of that colour's squared error.
const GOOD_ABOVE: f64 = 12.0;
/// Minimum mean PSNR of a fair model: an error of a tenth of the range.
const FAIR: f64 = 20.0;
/// Minimum gain of a fair model over the mean colour's PSNR: a quarter of that colour's squared error.
const FAIR_ABOVE: f64 = 6.0;
/// Minimum gain over the mean colour's PSNR for a model that learned anything; the default of `eval.min_gain`.
const GAIN: f64 = 1.0;
/// From this PSNR on, the error is at most 1 % of the range, and the model is good whatever its gain: a scene may be
/// almost blank, so that its mean colour is almost right.
const BEYOND_DOUBT: f64 = 40.0;
/// PSNR of a grey picture against pixels spread evenly over the range (variance 1/12): the bound for a model that
/// learned nothing if the mean colour's PSNR is unknown.
const GREY: f64 = 10.8;
/// Minimum share of occupied cells in fog. Surfaces and the cells just behind them fill at most an eighth of a box, and
/// a box is full when training begins.
const FOG_OCCUPIED: f64 = 0.25;
/// Minimum share of marched samples that fog keeps. In a solid model, rays end behind a surface and drop their
/// remaining samples, so it keeps 0.8 to 0.94.
const FOG_KEPT: f64 = 0.95;
/// A view suggests floaters if its PSNR is this many dB below the median of its scale: six times the squared error. A
/// floater hides the scene from few cameras. Reflections that no training view shows cost up to 6 dB.
const FLOATER: f64 = 8.0;
/// Minimum number of views for a median.
const VIEWS: usize = 4;

/// Quality grade of a model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Grade {
    /// There is no final evaluation.
    NotEvaluated,
    /// Barely better than each photograph's mean colour.
    FailedToLearn,
    /// Density everywhere and no surfaces.
    Fog,
    /// Below fair for another reason.
    Poor,
    /// Recognisable but not sharp.
    Fair,
    /// Good quality.
    Good,
}

/// The views and scales behind a mean.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Extent {
    /// The finest and the coarsest scale, as reductions.
    pub scales: [u32; 2],
    /// Test views of the finest scale that were measured.
    pub measured: usize,
    /// Test views; 0 if unknown.
    pub views: usize,
}

impl Extent {
    /// Returns the extent of an evaluation; `None` if it has no scale.
    fn of(evaluation: &Evaluation) -> Option<Self> {
        let scales = &evaluation.scales;
        let finest = scales.iter().min_by_key(|scale| scale.scale)?;
        let coarsest = scales.iter().map(|scale| scale.scale).max()?;
        let (scales, measured) = ([finest.scale, coarsest], finest.images);
        Some(Self { scales, measured, views: evaluation.frames })
    }
}

impl std::fmt::Display for Extent {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self.scales {
            [1, 1] => f.write_str("at full size")?,
            [1, coarsest] => write!(f, "at full size to 1/{coarsest}")?,
            [finest, coarsest] if finest == coarsest => write!(f, "at 1/{finest} of the size")?,
            [finest, coarsest] => write!(f, "at 1/{finest} to 1/{coarsest} of the size")?,
        }
        let all = formatting::count(self.views as u64, "test view");
        match self.views {
            0 => Ok(()),
            views if views == self.measured => write!(f, " over {all}"),
            _ => write!(f, " over {} of {all}", self.measured),
        }
    }
}

/// The input of a verdict.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Figures {
    /// Means of the final evaluation.
    pub mean: Option<Measures>,
    /// The views and scales of these means.
    pub extent: Option<Extent>,
    /// The last training figures.
    pub training: Training,
    /// Distance in dB from the median of the finest scale down to its worst view; `None` with fewer than four views.
    pub below_median: Option<f64>,
    /// The advice to give if the background shines through.
    pub remedy: Remedy,
}

/// The verdict and the figures that it is based on.
///
/// The rules in order; the constants above give each threshold and its reason:
///
/// 1. *not evaluated*: there is no final evaluation.
/// 2. *failed to learn*: PSNR is not [`Measures::learned`], 1 dB above the PSNR of each photograph's mean colour; if
///    the latter is unknown, PSNR is below 10.8 dB, that of grey.
/// 3. *good*: PSNR is at least 25 dB and 12 dB above the mean colour's, or at least 40 dB.
/// 4. *fog*: not good, at least 25 % of the cells are occupied and at least 95 % of the marched samples are kept.
/// 5. *fair*: PSNR is at least 20 dB and 6 dB above the mean colour's.
/// 6. *poor*: the rest.
///
/// A model that learned and is not fog can have two more faults: *floaters suspected* if a test view is 8 dB below the
/// median of its scale, and *the background shines through* if [`Measures::remark`] reports it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Verdict {
    /// Quality grade.
    pub grade: Grade,
    /// Some views are far worse than most.
    pub floaters: bool,
    /// PSNR is lower on another background.
    pub shines_through: bool,
    figures: Figures,
}

impl Verdict {
    /// Judges a run; `views` are those of its final evaluation.
    pub fn judge(config: &Config, history: &History, views: &[ViewRecord]) -> Self {
        Self::of(Figures {
            mean: history.last().map(|evaluation| mean_quality(&evaluation.scales)),
            extent: history.last().and_then(Extent::of),
            training: history.training,
            below_median: below_median(views),
            remedy: Remedy::of(config),
        })
    }

    /// Judges the given figures.
    pub fn of(figures: Figures) -> Self {
        let grade = figures.mean.map_or(Grade::NotEvaluated, |mean| grade(&mean, &figures.training));
        let shows = matches!(grade, Grade::Poor | Grade::Fair | Grade::Good);
        Self {
            grade,
            floaters: shows && figures.below_median.is_some_and(|below| below >= FLOATER),
            shines_through: shows && figures.mean.is_some_and(|mean| mean.remark(figures.remedy).is_some()),
            figures,
        }
    }

    /// Returns the verdict in a few words: the grade and the faults.
    pub fn label(&self) -> String {
        let mut label = match self.grade {
            Grade::NotEvaluated => "not evaluated",
            Grade::FailedToLearn => "failed to learn",
            Grade::Fog => "fog",
            Grade::Poor => "poor",
            Grade::Fair => "fair",
            Grade::Good => "good",
        }
        .to_string();
        if self.floaters {
            label += ", floaters suspected";
        }
        if self.shines_through {
            label += ", the background shines through";
        }
        label
    }

    /// Returns the CSS class of the badge: `good` only for a good model without faults.
    pub fn class(&self) -> &'static str {
        match self.grade {
            Grade::NotEvaluated => "plain",
            Grade::FailedToLearn | Grade::Fog | Grade::Poor => "bad",
            Grade::Good if !self.floaters && !self.shines_through => "good",
            Grade::Fair | Grade::Good => "doubtful",
        }
    }

    /// Reasons for the verdict and possible remedies, one line each.
    pub fn reasons(&self) -> Vec<String> {
        let Some(mean) = self.figures.mean else {
            return vec!["there is no final evaluation yet; eval.final selects its test views".into()];
        };
        let extent = self.figures.extent.map_or(String::new(), |extent| format!(" {extent}"));
        let mut reasons = vec![match mean.psnr_constant {
            constant if constant.is_nan() => format!("{:.2} dB{extent}", mean.psnr),
            constant => {
                format!("{:.2} dB{extent} ({constant:.2} dB for each photograph's mean colour)", mean.psnr)
            }
        }];
        let training = &self.figures.training;
        match self.grade {
            Grade::FailedToLearn => reasons.push(
                "look at the pictures, the cameras (data inspect) and the box (scene.aabb), or lower \
                 optimizer.learning_rate"
                    .into(),
            ),
            Grade::Fog => reasons.push(format!(
                "{:.0} % of the cells are occupied and rays keep {:.1} of {:.1} marched samples: surfaces have not \
                 formed; train for longer",
                100.0 * training.occupied,
                training.kept_per_ray,
                training.marched_per_ray
            )),
            _ => {}
        }
        if let Some(below) = self.figures.below_median.filter(|_| self.floaters) {
            reasons.push(format!(
                "the worst view is {below:.1} dB below the median: look for floaters near its camera"
            ));
        }
        reasons.extend(mean.remark(self.figures.remedy).filter(|_| self.shines_through));
        reasons
    }

    /// Returns the verdict as one line for a terminal.
    pub fn words(&self) -> String {
        format!("{}: {}", self.label(), self.reasons().join("; "))
    }
}

fn grade(mean: &Measures, training: &Training) -> Grade {
    let known = mean.psnr_constant.is_finite();
    if !mean.learned(GAIN) || (!known && mean.psnr < GREY) {
        return Grade::FailedToLearn;
    }
    let above = if known { mean.psnr - mean.psnr_constant } else { MOST_PSNR };
    if (mean.psnr >= GOOD && above >= GOOD_ABOVE) || mean.psnr >= BEYOND_DOUBT {
        return Grade::Good;
    }
    // Without marched samples `kept` is NaN; the comparison is then false, and the model does not count as fog.
    let kept = training.kept_per_ray / training.marched_per_ray;
    if training.occupied >= FOG_OCCUPIED && kept >= FOG_KEPT {
        return Grade::Fog;
    }
    if mean.psnr >= FAIR && above >= FAIR_ABOVE { Grade::Fair } else { Grade::Poor }
}

/// Returns the distance in dB from the median of the finest scale down to its worst view.
fn below_median(views: &[ViewRecord]) -> Option<f64> {
    let finest = views.iter().map(|view| view.scale).min()?;
    let mut psnr: Vec<f64> = views.iter().filter(|v| v.scale == finest).filter_map(|v| v.psnr).collect();
    psnr.sort_by(f64::total_cmp);
    (psnr.len() >= VIEWS).then(|| psnr[psnr.len() / 2] - psnr[0])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn mean(psnr: f64, psnr_opposite: f64, psnr_constant: f64) -> Option<Measures> {
        Some(Measures { psnr, psnr_opposite, psnr_constant, ssim: 0.9, ..Measures::UNKNOWN })
    }

    /// Returns figures of a solid model with `psnr`; the mean colour has 11 dB.
    fn solid(psnr: f64) -> Figures {
        let training = Training { loss: 0.1, occupied: 0.1, marched_per_ray: 30.0, kept_per_ray: 27.0 };
        let mean = mean(psnr, psnr, 11.0);
        Figures { mean, extent: None, training, below_median: Some(3.0), remedy: Remedy::Opacity }
    }

    fn foggy(psnr: f64) -> Figures {
        let training = Training { loss: 0.1, occupied: 0.4, marched_per_ray: 80.0, kept_per_ray: 79.0 };
        Figures { training, ..solid(psnr) }
    }

    fn label(figures: Figures) -> String {
        Verdict::of(figures).label()
    }

    #[test]
    fn solid_models_are_graded_by_their_error() {
        assert_eq!(
            [31.0, 25.0, 24.9, 20.0, 15.0, 11.5].map(|psnr| label(solid(psnr))),
            ["good", "good", "fair", "fair", "poor", "failed to learn"]
        );
    }

    #[test]
    fn the_mean_is_told_with_its_scales_and_views() {
        let of = |scales, measured, views| Extent { scales, measured, views }.to_string();
        assert_eq!(of([1, 1], 7, 7), "at full size over 7 test views");
        assert_eq!(of([1, 8], 1, 1), "at full size to 1/8 over 1 test view");
        assert_eq!(of([2, 8], 2, 7), "at 1/2 to 1/8 of the size over 2 of 7 test views");
        assert_eq!(of([8, 8], 2, 7), "at 1/8 of the size over 2 of 7 test views");
        let extent = Some(Extent { scales: [1, 1], measured: 7, views: 7 });
        let words = Verdict::of(Figures { extent, ..solid(27.2) }).words();
        assert!(
            words.starts_with("good: 27.20 dB at full size over 7 test views (11.00 dB for each"),
            "{words}"
        );
    }

    #[test]
    fn nothing_is_good_that_a_constant_picture_almost_has() {
        let dull = |psnr| label(Figures { mean: mean(psnr, psnr, 22.0), ..solid(psnr) });
        assert_eq!(
            [22.5, 26.0, 30.0, 35.0, 41.0].map(dull),
            ["failed to learn", "poor", "fair", "good", "good"]
        );
        assert_eq!(label(Figures { mean: mean(MOST_PSNR, MOST_PSNR, MOST_PSNR), ..solid(0.0) }), "good");
    }

    #[test]
    fn seven_decibels_are_never_green() {
        for constant in [f64::NAN, 4.0, 11.0] {
            let verdict = Verdict::of(Figures { mean: mean(7.0, 7.0, constant), ..solid(0.0) });
            assert_eq!(verdict.class(), "bad", "{}", verdict.words());
        }
        assert_eq!(label(Figures { mean: mean(f64::NAN, 7.0, 11.0), ..solid(0.0) }), "failed to learn");
    }

    #[test]
    fn a_fog_fills_its_box_and_keeps_what_it_marches() {
        assert_eq!(label(foggy(18.0)), "fog");
        assert_eq!(label(foggy(28.0)), "good", "a good picture is no fog");
        assert_eq!(label(foggy(11.5)), "failed to learn", "a fog of the right colour");
        let unknown = Figures { training: Training { occupied: 1.0, ..Training::default() }, ..solid(21.0) };
        assert_eq!(label(unknown), "fair", "nothing was marched");
        let words = Verdict::of(foggy(18.0)).words();
        assert!(words.starts_with("fog: 18.00 dB") && words.contains("40 %"), "{words}");
    }

    #[test]
    fn faults_stand_beside_the_grade_and_take_its_green() {
        let floaters = Verdict::of(Figures { below_median: Some(9.0), ..solid(30.0) });
        assert_eq!((floaters.label().as_str(), floaters.class()), ("good, floaters suspected", "doubtful"));
        let shines = Verdict::of(Figures { mean: mean(30.0, 25.0, 11.0), ..solid(30.0) });
        assert_eq!(shines.label(), "good, the background shines through");
        assert!(shines.class() == "doubtful" && shines.words().contains("25.00 dB on the opposite"));
        let place = Figures { mean: mean(30.0, 25.0, 11.0), remedy: Remedy::Training(0.1), ..solid(30.0) };
        assert!(Verdict::of(place).words().contains("train for longer"));
        assert_eq!(Verdict::of(solid(30.0)).class(), "good");
        let failed = Figures { below_median: Some(9.0), ..solid(11.2) };
        assert_eq!(label(failed), "failed to learn", "the spread of what shows nothing says nothing");
    }

    #[test]
    fn what_was_not_evaluated_is_not_judged() {
        let verdict = Verdict::judge(&Config::default(), &History::default(), &[]);
        assert_eq!((verdict.label().as_str(), verdict.class()), ("not evaluated", "plain"));
        assert!(verdict.words().contains("eval.final"));
    }

    #[test]
    fn the_worst_view_is_told_from_the_median_of_the_finest_scale() {
        let view = |scale, psnr| ViewRecord {
            index: 0,
            name: String::new(),
            scale,
            psnr: Some(psnr),
            ssim: None,
            ms_ssim: None,
            flip: None,
            lpips: None,
            nearest_distance: None,
            nearest_spacings: None,
            comparison: None,
            flip_map: None,
        };
        let mut views = vec![view(1, 20.0), view(1, 31.0), view(1, 30.0), view(2, 5.0)];
        assert_eq!(below_median(&views), None, "three views have no median worth the name");
        views.push(view(1, 32.0));
        assert_eq!(below_median(&views), Some(11.0));
    }
}
