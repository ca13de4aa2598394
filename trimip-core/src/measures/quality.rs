//! Measures of rendered pictures against photographs, and their means over views and scales.

use crate::{
    Config, Error, Result,
    config::{Contraction, EvalConfig},
    measures::metrics::psnr_of_error,
};
use serde::{Deserialize, Deserializer, Serialize};

/// PSNR lost on the opposite background, in dB, above which a warning is given.
const SHINES_THROUGH: f64 = 1.0;

/// Upper limit for the PSNR of a view, dB: a view that equals its photograph must not make the mean infinite.
pub const MOST_PSNR: f64 = 100.0;

/// Returns the PSNR, limited to [`MOST_PSNR`]; NaN stays NaN.
pub fn capped(psnr: f64) -> f64 {
    if psnr > MOST_PSNR { MOST_PSNR } else { psnr }
}

/// Reads a float from JSON, in which infinite and NaN values are written as `null`. `null` is read as NaN.
pub(crate) fn float_or_null<'de, D: Deserializer<'de>>(
    deserializer: D,
) -> std::result::Result<f64, D::Error> {
    Ok(Option::deserialize(deserializer)?.unwrap_or(f64::NAN))
}

/// Returns NaN, for a value that was not measured.
fn unknown() -> f64 {
    f64::NAN
}

/// Measures of a picture, or their means over several pictures. PSNR is −10·log10(mean squared error) in dB, on [0, 1]
/// values that were not rounded. NaN stands for a value that was not measured.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measures {
    /// PSNR in dB, with silhouettes as the photographs of the set show them
    /// ([`edge_exponents`](crate::scene::edge_exponents)).
    #[serde(deserialize_with = "float_or_null")]
    pub psnr: f64,
    /// PSNR in dB of colours rounded to 8 bits.
    #[serde(default = "unknown", deserialize_with = "float_or_null")]
    pub psnr_8bit: f64,
    /// PSNR in dB on the opposite background (see [`opposite`](crate::run::evaluate::opposite)); transparency lowers it.
    #[serde(default = "unknown", deserialize_with = "float_or_null")]
    pub psnr_opposite: f64,
    /// PSNR in dB without the edge exponent of the set (`data.edge_exponents`), which compares a physically correct picture
    /// with its photograph.
    #[serde(default = "unknown", deserialize_with = "float_or_null")]
    pub psnr_plain: f64,
    /// PSNR in dB against a true box filter of the finest photograph.
    #[serde(default = "unknown", deserialize_with = "float_or_null")]
    pub psnr_box: f64,
    /// PSNR in dB at the exposure of the photograph, which each half of the picture takes from the other half
    /// ([`exposed_by_the_other_half`](crate::engine::exposure::exposed_by_the_other_half)).
    #[serde(default = "unknown", deserialize_with = "float_or_null")]
    pub psnr_exposed: f64,
    /// PSNR in dB of the photograph's mean colour in place of the rendering: the result of a model that has learned
    /// nothing. Means over views average the squared errors, not the dB.
    #[serde(default = "unknown", deserialize_with = "float_or_null")]
    pub psnr_constant: f64,
    /// Structural similarity.
    #[serde(deserialize_with = "float_or_null")]
    pub ssim: f64,
    /// Structural similarity at five scales ([`ms_ssim`](crate::measures::metrics::ms_ssim)).
    #[serde(default = "unknown", deserialize_with = "float_or_null")]
    pub ms_ssim: f64,
    /// Mean LDR-FLIP error, 0 (equal) to 1 ([`perception`](crate::measures::perception)).
    #[serde(default = "unknown", deserialize_with = "float_or_null")]
    pub flip: f64,
    /// LPIPS distance, 0 (equal) or more ([`perception`](crate::measures::perception)).
    #[serde(default = "unknown", deserialize_with = "float_or_null")]
    pub lpips: f64,
}

impl Measures {
    /// All numbers are NaN: nothing was measured.
    pub const UNKNOWN: Self = Self {
        psnr: f64::NAN,
        psnr_8bit: f64::NAN,
        psnr_opposite: f64::NAN,
        psnr_plain: f64::NAN,
        psnr_box: f64::NAN,
        psnr_exposed: f64::NAN,
        psnr_constant: f64::NAN,
        ssim: f64::NAN,
        ms_ssim: f64::NAN,
        flip: f64::NAN,
        lpips: f64::NAN,
    };

    /// Returns the mean of each measure; NaN without elements. Perceptual measures are averaged over the elements that have
    /// them.
    pub fn mean(all: &[Self]) -> Self {
        let mean = |measure: fn(&Self) -> f64| all.iter().map(measure).sum::<f64>() / all.len() as f64;
        let of_some = |measure: fn(&Self) -> f64| {
            let known: Vec<f64> = all.iter().map(measure).filter(|value| !value.is_nan()).collect();
            known.iter().sum::<f64>() / known.len() as f64
        };
        Self {
            psnr: mean(|m| m.psnr),
            psnr_8bit: mean(|m| m.psnr_8bit),
            psnr_opposite: mean(|m| m.psnr_opposite),
            psnr_plain: mean(|m| m.psnr_plain),
            psnr_box: mean(|m| m.psnr_box),
            psnr_exposed: mean(|m| m.psnr_exposed),
            psnr_constant: mean(|m| m.psnr_constant),
            ssim: mean(|m| m.ssim),
            ms_ssim: of_some(|m| m.ms_ssim),
            flip: of_some(|m| m.flip),
            lpips: of_some(|m| m.lpips),
        }
    }

    /// Returns true if a perceptual measure was taken.
    pub fn has_perceptual(&self) -> bool {
        [self.ms_ssim, self.flip, self.lpips].iter().any(|value| !value.is_nan())
    }

    /// Returns false for a model that failed to learn: its PSNR is NaN, or less than `gain` dB above the PSNR of the mean
    /// colours.
    pub fn learned(&self, gain: f64) -> bool {
        self.psnr >= MOST_PSNR || (self.psnr.is_finite() && !(self.psnr < self.psnr_constant + gain))
    }

    /// Fails if the model learned nothing or misses the configured quality floor.
    ///
    /// # Errors
    /// The error is of kind `Run` and holds the measured value and the limit.
    pub fn judge(&self, eval: &EvalConfig) -> Result<()> {
        if self.psnr.is_nan() {
            return Err(Error::run(
                "failed to learn: mean PSNR is not a number, because pictures of the model are not finite, or no pixel of the test \
                 views is compared; look at the pictures and the masks, or lower optimizer.learning_rate",
            ));
        }
        if eval.min_gain != 0.0 && !self.learned(eval.min_gain) {
            return Err(Error::run(format!(
                "failed to learn: mean PSNR {:.2} dB, where each photograph's mean colour alone has {:.2} dB; look at the \
                 pictures, and at the cameras and the box (trimip-cli plan)",
                self.psnr, self.psnr_constant
            )));
        }
        if eval.min_psnr > 0.0 && self.psnr < eval.min_psnr {
            return Err(Error::run(format!(
                "mean PSNR {:.2} dB is below the floor eval.min_psnr = {}",
                self.psnr, eval.min_psnr
            )));
        }
        Ok(())
    }

    /// Returns a warning, with a remedy, about a model that is transparent where the photographs are opaque.
    pub fn remark(&self, remedy: Remedy) -> Option<String> {
        let advice = match remedy {
            Remedy::Opacity => "loss.opacity = 0.1 trains solid models that hide every background".to_string(),
            Remedy::Photographs => "the plan trains opaque rays (plan.solids) from 2^20 pixels on: give more photographs, or larger \
                 ones"
                .into(),
            Remedy::Training(opacity) => {
                format!("rays become opaque as they are trained: train for longer, or raise loss.opacity (now {opacity})")
            }
        };
        (self.psnr - self.psnr_opposite > SHINES_THROUGH).then(|| {
            let opposite = self.psnr_opposite;
            format!("the background shines through the model: {opposite:.2} dB on the opposite background; {advice}")
        })
    }
}

/// Remedy for a model through which the background shines.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Remedy {
    /// The term `loss.opacity`, which compares opacity with the alpha of the photographs.
    #[default]
    Opacity,
    /// More or larger photographs of a place: with few pixels, opaque rays would end in front of the cameras, so the plan
    /// leaves `loss.opacity` out.
    Photographs,
    /// Longer training, or a weight of `loss.opacity` above this one.
    Training(f32),
}

impl Remedy {
    /// Returns the remedy for a model of this configuration.
    pub fn of(config: &Config) -> Self {
        match (config.scene.contraction, config.loss.opacity) {
            (_, weight) if weight > 0.0 => Self::Training(weight),
            (Contraction::Ball, _) => Self::Photographs,
            (Contraction::None, _) => Self::Opacity,
        }
    }
}

/// Measures of one view, kept after its pixels are gone.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ViewQuality {
    /// Index of the frame in the test split.
    pub index: usize,
    /// Reduction factor of the view: 1, 2, 4 or 8.
    pub scale: u32,
    /// Its measures.
    #[serde(flatten)]
    pub measures: Measures,
}

/// Measures of one scale, means over its images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ScaleQuality {
    /// Reduction factor of the images: 1, 2, 4 or 8.
    pub scale: u32,
    /// Number of images.
    pub images: usize,
    /// Number of images over which `ms_ssim`, `flip` and `lpips` are averaged; 0 in files of earlier versions.
    #[serde(default, alias = "perceived")]
    pub perceptual_images: usize,
    /// Means over the images.
    #[serde(flatten)]
    pub measures: Measures,
}

/// Returns the means per scale, fine to coarse, over the frames whose index is a multiple of `stride`.
pub fn per_scale(qualities: &[ViewQuality], stride: usize) -> Vec<ScaleQuality> {
    let mut scales: Vec<u32> = qualities.iter().map(|quality| quality.scale).collect();
    scales.sort_unstable();
    scales.dedup();
    scales
        .into_iter()
        .map(|scale| {
            let here = |q: &&ViewQuality| q.scale == scale && q.index.is_multiple_of(stride.max(1));
            let views: Vec<Measures> = qualities.iter().filter(here).map(|q| q.measures).collect();
            let error = |m: &Measures| 10_f64.powf(-0.1 * m.psnr_constant);
            // Errors are averaged, not PSNRs: a blank view, which a constant image matches, must not dominate the mean.
            let constant = views.iter().map(error).sum::<f64>() / views.len() as f64;
            let measures =
                Measures { psnr_constant: capped(psnr_of_error(constant)), ..Measures::mean(&views) };
            let perceptual_images = views.iter().filter(|view| view.has_perceptual()).count();
            ScaleQuality { scale, images: views.len(), perceptual_images, measures }
        })
        .collect()
}

/// Returns the means over `scales`, one element per scale, with equal weights: the headline figures.
pub fn mean_quality(scales: &[ScaleQuality]) -> Measures {
    Measures::mean(&scales.iter().map(|scale| scale.measures).collect::<Vec<_>>())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_headline_is_the_mean_of_the_scales_not_of_the_views() {
        let view = |index, scale, psnr| {
            let measures = Measures {
                psnr,
                psnr_8bit: psnr,
                psnr_opposite: psnr - 2.0,
                psnr_plain: psnr - 1.0,
                psnr_box: psnr + 1.0,
                psnr_exposed: psnr + 3.0,
                psnr_constant: 12.0,
                ssim: 0.5,
                // Two of three views of the finest scale have perceptual measures; the other scale is too small for MS-SSIM.
                ms_ssim: if scale == 1 && index < 2 { 0.01 * psnr } else { f64::NAN },
                flip: if index < 2 { 0.1 * f64::from(scale) } else { f64::NAN },
                lpips: f64::NAN,
            };
            ViewQuality { index, scale, measures }
        };
        let qualities = [view(0, 1, 20.0), view(1, 1, 30.0), view(2, 1, 40.0), view(0, 2, 10.0)];
        let scales = per_scale(&qualities, 1);
        let psnr = [&scales[0], &scales[1]].map(|scale| scale.measures.psnr);
        assert_eq!((psnr, scales[0].images), ([30.0, 10.0], 3));
        let mean = mean_quality(&scales);
        assert_eq!((mean.psnr, mean.psnr_opposite, mean.ssim), (20.0, 18.0, 0.5));
        assert_eq!((mean.psnr_plain, mean.psnr_box, mean.psnr_exposed), (19.0, 21.0, 23.0));
        assert_eq!((scales[0].perceptual_images, scales[1].perceptual_images), (2, 1));
        assert_eq!((scales[0].measures.flip, scales[1].measures.flip), (0.1, 0.2));
        assert!((mean.flip - 0.15).abs() < 1e-12 && (mean.ms_ssim - 0.25).abs() < 1e-12);
        assert!(scales[1].measures.ms_ssim.is_nan() && mean.lpips.is_nan());
        assert!(mean.remark(Remedy::Opacity).is_some_and(|remark| remark.contains("18.00 dB")));
        let eval = |min_psnr, min_gain| EvalConfig { min_psnr, min_gain, ..Config::default().eval };
        assert!(mean.judge(&eval(0.0, 1.0)).is_ok() && mean.judge(&eval(20.0, 0.0)).is_ok());
        assert_eq!(mean.judge(&eval(20.1, 1.0)).unwrap_err().kind(), crate::ErrorKind::Run);
        let blind = Measures { psnr: f64::NAN, ..mean };
        assert!(
            blind.judge(&eval(0.0, 0.0)).unwrap_err().message().contains("not a number"),
            "it is nobody's floor"
        );
        assert!(blind.judge(&eval(0.0, 1.0)).unwrap_err().message().contains("failed to learn"));
        assert_eq!(Measures { psnr_opposite: 19.5, ..mean }.remark(Remedy::Opacity), None);
        assert_eq!(Measures { psnr_opposite: f64::NAN, ..mean }.remark(Remedy::Opacity), None);
        assert!(mean.learned(1.0) && !Measures { psnr: 12.9, ..mean }.learned(1.0));
        assert!(!Measures { psnr: f64::NAN, ..mean }.learned(1.0));
        assert_eq!(per_scale(&qualities, 2)[0].images, 2);
        assert_eq!([capped(f64::INFINITY), capped(120.0), capped(30.0)], [MOST_PSNR, MOST_PSNR, 30.0]);
        assert!(capped(f64::NAN).is_nan(), "a picture of no numbers is not the best of all");
    }

    #[test]
    fn a_place_is_not_told_to_set_what_its_plan_decides() {
        let mean = Measures { psnr: 25.0, psnr_opposite: 20.0, ..Measures::UNKNOWN };
        let mut config = Config::default();
        let advice = |config: &Config| mean.remark(Remedy::of(config)).unwrap();
        assert!(advice(&config).contains("loss.opacity = 0.1 trains"));
        config.scene.contraction = Contraction::Ball;
        assert!(advice(&config).contains("more photographs") && !advice(&config).contains("loss.opacity"));
        config.loss.opacity = 0.25;
        assert!(advice(&config).contains("train for longer, or raise loss.opacity (now 0.25)"));
        config.scene.contraction = Contraction::None;
        assert!(advice(&config).contains("(now 0.25)"), "an object that has the term is not told to add it");
    }

    #[test]
    fn measures_stand_beside_the_scale_in_json_and_old_files_lack_some() {
        let scale = ScaleQuality {
            scale: 2,
            images: 3,
            perceptual_images: 0,
            measures: Measures { psnr: 30.5, ssim: 0.25, ..Measures::UNKNOWN },
        };
        let text = serde_json::to_string(&scale).unwrap();
        assert!(
            text.starts_with(r#"{"scale":2,"images":3,"perceptual_images":0,"psnr":30.5,"psnr_8bit":null,"#),
            "{text}"
        );
        for text in [&text, r#"{"scale":2,"images":3,"psnr":30.5,"ssim":0.25}"#] {
            let read: ScaleQuality = serde_json::from_str(text).unwrap();
            assert_eq!((read.scale, read.images), (2, 3));
            assert_eq!((read.measures.psnr, read.measures.ssim), (30.5, 0.25));
            assert!(read.measures.psnr_exposed.is_nan() && read.perceptual_images == 0);
            assert!(!read.measures.has_perceptual());
        }
    }
}
