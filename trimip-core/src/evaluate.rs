//! Evaluation: test frames rendered at every scale and compared with their photographs.

use crate::{
    Frame, Frames, Result, Session,
    events::ScaleQuality,
    metrics::{psnr, psnr_8bit, psnr_of_constant, psnr_of_error, ssim},
};
use serde::Serialize;

/// PSNR that a model may lose on the opposite background before it is said, dB.
const SHINES_THROUGH: f64 = 1.0;

/// PSNR of a view that equals its photograph, dB: one blank view must not make a mean infinite.
pub const MOST_PSNR: f64 = 100.0;

/// One rendered test view and its measures.
pub struct ViewResult<'a> {
    /// Index of the frame in the test split.
    pub index: usize,
    /// Name of the photograph.
    pub name: &'a str,
    /// Reduction of the view: 1, 2, 4, 8.
    pub scale: u32,
    /// What was rendered.
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
    /// dB.
    pub psnr: f64,
    /// dB, of colours rounded to 8 bits.
    pub psnr_8bit: f64,
    /// dB, on the opposite background, see [`opposite`].
    pub psnr_opposite: f64,
    /// dB, of the photograph's mean colour instead of the rendering.
    pub psnr_constant: f64,
    /// Structural similarity.
    pub ssim: f64,
}

/// Means over the scales: the headline.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeanQuality {
    /// dB.
    pub psnr: f64,
    /// dB, of colours rounded to 8 bits.
    pub psnr_8bit: f64,
    /// dB, on the opposite background.
    pub psnr_opposite: f64,
    /// dB, of each photograph's mean colour.
    pub psnr_constant: f64,
    /// Structural similarity.
    pub ssim: f64,
}

/// PSNR that a model must have above that of constant pictures, dB; less is a fog of the right colour.
const LEARNED: f64 = 1.0;

impl MeanQuality {
    /// False for a model that shows nothing: hardly better than each photograph's mean colour, or no number at all.
    pub fn learned(&self) -> bool {
        self.psnr.is_finite()
            && (self.psnr_constant.is_nan()
                || self.psnr >= self.psnr_constant + LEARNED
                || self.psnr >= MOST_PSNR)
    }

    /// What to say of a model that lets its background shine through where the photographs do not.
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

/// The background that shows best what shines through: black for what is bright, white for what is dark, per channel.
pub fn opposite(background: [f32; 3]) -> [f32; 3] {
    background.map(|channel| if channel < 0.5 { 1.0 } else { 0.0 })
}

/// A PSNR of at most [`MOST_PSNR`]; what is no number stays none.
fn capped(psnr: f64) -> f64 {
    if psnr > MOST_PSNR { MOST_PSNR } else { psnr }
}

/// Renders every `stride`-th frame at every scale; `on_view` sees each result and returns false to stop early.
pub fn evaluate(
    session: &mut dyn Session,
    frames: &dyn Frames,
    stride: usize,
    background: [f32; 3],
    mut on_view: impl FnMut(&ViewResult<'_>) -> Result<bool>,
) -> Result<Vec<ViewQuality>> {
    let mut qualities = Vec::new();
    for index in (0..frames.len()).step_by(stride.max(1)) {
        let set = frames.load(index)?;
        for scale in &set.scales {
            for view in scale.views.clone() {
                let target = set.composited(view, background);
                let rendered = session.render(&set.views[view].camera)?;
                let rgb = rendered.rgb();
                let other = opposite(background);
                let quality = ViewQuality {
                    index,
                    scale: scale.factor,
                    psnr: capped(psnr(&rgb, &target)),
                    psnr_8bit: capped(psnr_8bit(&rgb, &target)),
                    psnr_opposite: capped(psnr(
                        &rendered.moved(background, other),
                        &set.composited(view, other),
                    )),
                    psnr_constant: capped(psnr_of_constant(&target)),
                    ssim: ssim(&rgb, &target, rendered.width as usize, rendered.height as usize),
                };
                let result = ViewResult {
                    index,
                    name: &set.views[view].name,
                    scale: scale.factor,
                    rendered: &rendered,
                    target: &target,
                    psnr: quality.psnr,
                    ssim: quality.ssim,
                };
                qualities.push(quality);
                if !on_view(&result)? {
                    return Ok(qualities);
                }
            }
        }
    }
    Ok(qualities)
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
                // Errors are averaged here: a blank view, which a constant equals, must not stand for all others.
                psnr_constant: capped(psnr_of_error(mean(&|q| 10_f64.powf(-0.1 * q.psnr_constant)))),
                ssim: mean(&|q| q.ssim),
            }
        })
        .collect()
}

/// Means over the scales, each counting once.
pub fn mean_quality(scales: &[ScaleQuality]) -> MeanQuality {
    let mean =
        |f: &dyn Fn(&ScaleQuality) -> f64| scales.iter().map(f).sum::<f64>() / scales.len().max(1) as f64;
    MeanQuality {
        psnr: mean(&|scale| scale.psnr),
        psnr_8bit: mean(&|scale| scale.psnr_8bit),
        psnr_opposite: mean(&|scale| scale.psnr_opposite),
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
            psnr_constant: 12.0,
            ssim: 0.5,
        };
        let qualities = [view(0, 1, 20.0), view(1, 1, 30.0), view(2, 1, 40.0), view(0, 2, 10.0)];
        let scales = per_scale(&qualities, 1);
        assert_eq!((scales[0].psnr, scales[0].images, scales[1].psnr), (30.0, 3, 10.0));
        let mean = mean_quality(&scales);
        assert_eq!((mean.psnr, mean.psnr_opposite, mean.ssim), (20.0, 18.0, 0.5));
        assert!(mean.remark().is_some_and(|remark| remark.contains("18.00 dB")));
        assert_eq!(MeanQuality { psnr_opposite: 19.5, ..mean }.remark(), None);
        assert_eq!(MeanQuality { psnr_opposite: f64::NAN, ..mean }.remark(), None);
        assert!(mean.learned() && !MeanQuality { psnr: 12.9, ..mean }.learned());
        assert!(!MeanQuality { psnr: f64::NAN, ..mean }.learned());
        assert_eq!(per_scale(&qualities, 2)[0].images, 2);
        assert_eq!([capped(f64::INFINITY), capped(120.0), capped(30.0)], [MOST_PSNR, MOST_PSNR, 30.0]);
        assert!(capped(f64::NAN).is_nan(), "a picture of no numbers is not the best of all");
    }
}
