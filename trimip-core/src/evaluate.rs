//! Evaluation: test frames rendered at every scale and compared with their photographs.

use crate::{
    Error, Frame, Frames, Result, ViewSet, Viewer,
    config::{DataConfig, EvalConfig},
    events::ScaleQuality,
    metrics::{psnr, psnr_8bit, psnr_of_constant, psnr_of_error, ssim},
};
use serde::Serialize;

/// Loss of PSNR on the opposite background above which a warning is given, dB.
const SHINES_THROUGH: f64 = 1.0;

/// Upper limit for the PSNR of a view, dB: a view that equals its photograph must not make the mean infinite.
pub const MOST_PSNR: f64 = 100.0;

/// One rendered test view and its measures.
pub struct ViewResult<'a> {
    /// Index of the frame in the test split.
    pub index: usize,
    /// Name of the photograph.
    pub name: &'a str,
    /// Reduction of the view: 1, 2, 4, 8.
    pub scale: u32,
    /// What was rendered, as the set's photographs show silhouettes.
    pub rendered: &'a Frame,
    /// The photograph on the same background.
    pub target: &'a [[f32; 3]],
    /// dB.
    pub psnr: f64,
    /// Structural similarity.
    pub ssim: f64,
}

/// Measures of one view, kept after its pixels are gone.
#[derive(Clone, Debug, PartialEq)]
pub struct ViewQuality {
    /// Index of the frame in the test split.
    pub index: usize,
    /// Reduction of the view: 1, 2, 4, 8.
    pub scale: u32,
    /// dB, as the photographs of the set show silhouettes ([`edges`](crate::edges)).
    pub psnr: f64,
    /// dB, of colours rounded to 8 bits.
    pub psnr_8bit: f64,
    /// dB, on the opposite background, see [`opposite`].
    pub psnr_opposite: f64,
    /// dB, without the edge exponent of the set (`data.edge_exponents`).
    pub psnr_plain: f64,
    /// dB, against a true box filter of the finest photograph.
    pub psnr_box: f64,
    /// dB, of the photograph's mean colour instead of the rendering.
    pub psnr_constant: f64,
    /// Structural similarity.
    pub ssim: f64,
}

/// Means over the scales: the headline.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeanQuality {
    /// dB, as the photographs of the set show silhouettes ([`edges`](crate::edges)).
    pub psnr: f64,
    /// dB, of colours rounded to 8 bits.
    pub psnr_8bit: f64,
    /// dB, on the opposite background.
    pub psnr_opposite: f64,
    /// dB, without the edge exponent of the set (`data.edge_exponents`).
    pub psnr_plain: f64,
    /// dB, against a true box filter of the finest photograph.
    pub psnr_box: f64,
    /// dB, of each photograph's mean colour.
    pub psnr_constant: f64,
    /// Structural similarity.
    pub ssim: f64,
}

impl MeanQuality {
    /// False for a model that failed to learn: its PSNR is NaN, or less than `gain` dB above that of the mean colours.
    pub fn learned(&self, gain: f64) -> bool {
        self.psnr >= MOST_PSNR || (self.psnr.is_finite() && !(self.psnr < self.psnr_constant + gain))
    }

    /// Fails if the model learned nothing or misses the configured quality floor.
    ///
    /// # Errors
    /// Of kind `Run`, with the measured value and the limit.
    pub fn judge(&self, eval: &EvalConfig) -> Result<()> {
        if eval.min_gain != 0.0 && !self.learned(eval.min_gain) {
            return Err(Error::run(format!(
                "failed to learn: mean PSNR {:.2} dB, where each photograph's mean colour alone has {:.2} dB; look at the \
                 pictures, and at the cameras and the box (trimip-cli plan)",
                self.psnr, self.psnr_constant
            )));
        }
        // NaN is below every floor.
        if eval.min_psnr > 0.0 && (self.psnr.is_nan() || self.psnr < eval.min_psnr) {
            return Err(Error::run(format!(
                "mean PSNR {:.2} dB is below the floor eval.min_psnr = {}",
                self.psnr, eval.min_psnr
            )));
        }
        Ok(())
    }

    /// A warning about a model that is transparent where the photographs are opaque.
    pub fn remark(&self) -> Option<String> {
        (self.psnr - self.psnr_opposite > SHINES_THROUGH).then(|| {
            format!(
                "the background shines through the model: {:.2} dB on the opposite one; loss.opacity = 0.1 trains \
                 solids that hide any",
                self.psnr_opposite
            )
        })
    }
}

/// The background that makes transparency most visible: per channel, black if the colour is bright and white if it is dark.
pub fn opposite(background: [f32; 3]) -> [f32; 3] {
    background.map(|channel| if channel < 0.5 { 1.0 } else { 0.0 })
}

/// The PSNR, limited to [`MOST_PSNR`]; NaN stays NaN.
fn capped(psnr: f64) -> f64 {
    if psnr > MOST_PSNR { MOST_PSNR } else { psnr }
}

/// Callbacks of an evaluation; each returns false to stop it.
pub trait Watch {
    /// `rows` of the `of` rows of a frame, over all its scales, are rendered.
    fn rows(&mut self, rows: u32, of: u32) -> bool {
        let _ = (rows, of);
        true
    }
    /// A view was rendered and measured.
    fn view(&mut self, view: &ViewResult<'_>) -> Result<bool>;
}

/// A watch for views only.
struct OnView<F>(F);

impl<F: FnMut(&ViewResult<'_>) -> Result<bool>> Watch for OnView<F> {
    fn view(&mut self, view: &ViewResult<'_>) -> Result<bool> {
        (self.0)(view)
    }
}

/// Renders every `stride`-th frame at every scale, on the background and by the convention of `data`; `on_view` sees each
/// result and returns false to stop early.
pub fn evaluate(
    viewer: &mut dyn Viewer,
    frames: &dyn Frames,
    stride: usize,
    data: &DataConfig,
    on_view: impl FnMut(&ViewResult<'_>) -> Result<bool>,
) -> Result<Vec<ViewQuality>> {
    let (mut qualities, mut watch) = (Vec::new(), OnView(on_view));
    for index in (0..frames.len()).step_by(stride.max(1)) {
        if !evaluate_frame(viewer, frames, index, 1, data, &mut watch, &mut qualities)? {
            break;
        }
    }
    Ok(qualities)
}

/// Renders frame `index` at its scales from `finest` on (1, 2, 4, ..; where it has none so coarse, at its coarsest) and
/// adds their measures to `qualities`. Pixels that the lens has no ray for are not compared, nor those of which a mask keeps
/// less than half; a view without others is left out. False if `watch` stopped it; the current view is then not included.
///
/// # Errors
/// When a photograph cannot be read, the device fails, or `watch` fails.
pub fn evaluate_frame(
    viewer: &mut dyn Viewer,
    frames: &dyn Frames,
    index: usize,
    finest: u32,
    data: &DataConfig,
    watch: &mut dyn Watch,
    qualities: &mut Vec<ViewQuality>,
) -> Result<bool> {
    let (set, background) = (frames.load(index)?, data.background);
    let finest = set.scales.iter().map(|scale| scale.factor).filter(|&f| f <= finest).max().unwrap_or(1);
    let scales = || set.scales.iter().filter(|scale| scale.factor >= finest);
    let views = || scales().flat_map(|scale| scale.views.clone().map(move |view| (scale.factor, view)));
    let rows = |view: usize| set.views[view].camera.intrinsics.height;
    let (all, mut before) = (views().map(|(_, view)| rows(view)).sum::<u32>(), 0);
    for (factor, view) in views() {
        let target = set.composited(view, background);
        let camera = &set.views[view].camera;
        let excluded = excluded(&set, view);
        if !excluded.is_empty() && excluded.iter().all(|&excluded| excluded) {
            before += rows(view);
            continue;
        }
        let Some(rendered) = viewer.render_watched(camera, &mut |done, _| watch.rows(before + done, all))?
        else {
            return Ok(false);
        };
        before += rows(view);
        let (exponent, other) = (data.edge_exponent(factor), opposite(background));
        let seen = |rgb: Vec<[f32; 3]>| without(&excluded, rgb);
        let target_seen = seen(target.clone());
        let plain = capped(psnr(&seen(rendered.rgb()), &target_seen));
        // Each block drops its pictures: few are in memory at once.
        let psnr_box = {
            let truth =
                set.box_filtered(set.scales[0].views.start, factor / set.scales[0].factor, background);
            // The photographs of a multi-scale set may be smaller or larger than blocks of the finest ones.
            if truth.len() == target.len() {
                capped(psnr(&seen(rendered.rgb()), &seen(truth)))
            } else {
                f64::NAN
            }
        };
        let psnr_opposite = {
            let moved = rendered.moved(background, other).shown(other, exponent).rgb();
            capped(psnr(&seen(moved), &seen(set.composited(view, other))))
        };
        let rendered = rendered.shown(background, exponent);
        let (psnr, psnr_8bit, ssim) = {
            let mut rgb = rendered.rgb();
            let pairs = rgb.iter_mut().zip(&target).zip(&excluded);
            for (pixel, target) in pairs.filter_map(|(pair, excluded)| excluded.then_some(pair)) {
                *pixel = *target;
            }
            let ssim = ssim(&rgb, &target, rendered.width as usize, rendered.height as usize);
            let rgb = seen(rgb);
            (capped(psnr(&rgb, &target_seen)), capped(psnr_8bit(&rgb, &target_seen)), ssim)
        };
        let quality = ViewQuality {
            index,
            scale: factor,
            psnr,
            psnr_8bit,
            psnr_opposite,
            psnr_plain: plain,
            psnr_box,
            psnr_constant: capped(psnr_of_constant(&target_seen)),
            ssim,
        };
        let result = ViewResult {
            index,
            name: &set.views[view].name,
            scale: factor,
            rendered: &rendered,
            target: &target,
            psnr: quality.psnr,
            ssim: quality.ssim,
        };
        qualities.push(quality);
        if !watch.view(&result)? {
            return Ok(false);
        }
    }
    Ok(true)
}

/// The colours of the pixels of view `view` that are compared, of a picture of it: all but those that the lens has no ray for,
/// and those of which a mask keeps less than half.
pub fn compared(set: &ViewSet, view: usize, rgb: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
    without(&excluded(set, view), rgb)
}

/// Whether each pixel is left out of the comparison; empty if none is.
fn excluded(set: &ViewSet, view: usize) -> Vec<bool> {
    let (camera, pixels) = (&set.views[view].camera, set.pixels_of(view));
    let k = &camera.intrinsics;
    let blind = k.blind_pixels() > 0;
    if !blind && !pixels.iter().any(|&pixel| set.alpha.leaves_out(pixel)) {
        return Vec::new();
    }
    let unseen = |i: u32| blind && camera.cone::<f32>(i % k.width, i / k.width).slope == 0.0;
    (0..).zip(pixels).map(|(i, &pixel)| set.alpha.leaves_out(pixel) || unseen(i)).collect()
}

/// The pixels that are not `excluded`.
fn without(excluded: &[bool], mut rgb: Vec<[f32; 3]>) -> Vec<[f32; 3]> {
    let mut flags = excluded.iter();
    rgb.retain(|_| !flags.next().copied().unwrap_or(false));
    rgb
}

/// Means per scale, fine to coarse, over the frames whose index is a multiple of `stride`.
pub fn per_scale(qualities: &[ViewQuality], stride: usize) -> Vec<ScaleQuality> {
    let mut scales: Vec<u32> = qualities.iter().map(|quality| quality.scale).collect();
    scales.sort_unstable();
    scales.dedup();
    scales
        .into_iter()
        .map(|scale| {
            let views: Vec<_> = qualities
                .iter()
                .filter(|q| q.scale == scale && q.index.is_multiple_of(stride.max(1)))
                .collect();
            let mean = |f: &dyn Fn(&ViewQuality) -> f64| {
                views.iter().map(|q| f(q)).sum::<f64>() / views.len() as f64
            };
            ScaleQuality {
                scale,
                images: views.len(),
                psnr: mean(&|q| q.psnr),
                psnr_8bit: mean(&|q| q.psnr_8bit),
                psnr_opposite: mean(&|q| q.psnr_opposite),
                psnr_plain: mean(&|q| q.psnr_plain),
                psnr_box: mean(&|q| q.psnr_box),
                // Errors are averaged, not PSNRs: a blank view, which a constant image matches, must not dominate the mean.
                psnr_constant: capped(psnr_of_error(mean(&|q| 10_f64.powf(-0.1 * q.psnr_constant)))),
                ssim: mean(&|q| q.ssim),
            }
        })
        .collect()
}

/// Means over the scales, with equal weight.
pub fn mean_quality(scales: &[ScaleQuality]) -> MeanQuality {
    let mean =
        |f: &dyn Fn(&ScaleQuality) -> f64| scales.iter().map(f).sum::<f64>() / scales.len().max(1) as f64;
    MeanQuality {
        psnr: mean(&|scale| scale.psnr),
        psnr_8bit: mean(&|scale| scale.psnr_8bit),
        psnr_opposite: mean(&|scale| scale.psnr_opposite),
        psnr_plain: mean(&|scale| scale.psnr_plain),
        psnr_box: mean(&|scale| scale.psnr_box),
        psnr_constant: mean(&|scale| scale.psnr_constant),
        ssim: mean(&|scale| scale.ssim),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_headline_is_the_mean_of_the_scales_not_of_the_views() {
        let view = |index, scale, psnr| ViewQuality {
            index,
            scale,
            psnr,
            psnr_8bit: psnr,
            psnr_opposite: psnr - 2.0,
            psnr_plain: psnr - 1.0,
            psnr_box: psnr + 1.0,
            psnr_constant: 12.0,
            ssim: 0.5,
        };
        let qualities = [view(0, 1, 20.0), view(1, 1, 30.0), view(2, 1, 40.0), view(0, 2, 10.0)];
        let scales = per_scale(&qualities, 1);
        assert_eq!((scales[0].psnr, scales[0].images, scales[1].psnr), (30.0, 3, 10.0));
        let mean = mean_quality(&scales);
        assert_eq!((mean.psnr, mean.psnr_opposite, mean.ssim), (20.0, 18.0, 0.5));
        assert_eq!((mean.psnr_plain, mean.psnr_box), (19.0, 21.0));
        assert!(mean.remark().is_some_and(|remark| remark.contains("18.00 dB")));
        let eval = |min_psnr, min_gain| EvalConfig { min_psnr, min_gain, ..crate::Config::default().eval };
        assert!(mean.judge(&eval(0.0, 1.0)).is_ok() && mean.judge(&eval(20.0, 0.0)).is_ok());
        assert_eq!(mean.judge(&eval(20.1, 1.0)).unwrap_err().exit_code(), 1);
        let blind = MeanQuality { psnr: f64::NAN, ..mean };
        assert!(blind.judge(&eval(0.0, 0.0)).is_ok() && blind.judge(&eval(1.0, 0.0)).is_err());
        assert!(blind.judge(&eval(0.0, 1.0)).unwrap_err().message.contains("failed to learn"));
        assert_eq!(MeanQuality { psnr_opposite: 19.5, ..mean }.remark(), None);
        assert_eq!(MeanQuality { psnr_opposite: f64::NAN, ..mean }.remark(), None);
        assert!(mean.learned(1.0) && !MeanQuality { psnr: 12.9, ..mean }.learned(1.0));
        assert!(!MeanQuality { psnr: f64::NAN, ..mean }.learned(1.0));
        assert_eq!(per_scale(&qualities, 2)[0].images, 2);
        assert_eq!([capped(f64::INFINITY), capped(120.0), capped(30.0)], [MOST_PSNR, MOST_PSNR, 30.0]);
        assert!(capped(f64::NAN).is_nan(), "a picture of no numbers is not the best of all");
    }
}
