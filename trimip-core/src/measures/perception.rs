//! Perceptual metrics: MS-SSIM, LDR-FLIP (Andersson et al. 2020) and LPIPS (Zhang et al. 2018). They take longer than PSNR and
//! SSIM, so evaluations during training leave them out. External libraries compute LDR-FLIP and LPIPS; this module is the
//! interface to them.

use crate::Result;

/// A rendering and the photograph it is compared with, colours in [0, 1], row by row.
#[derive(Clone, Copy, Debug)]
pub struct Pair<'a> {
    /// The rendering. Excluded pixels have the photograph's colour.
    pub rendered: &'a [[f32; 3]],
    /// The photograph.
    pub target: &'a [[f32; 3]],
    /// Width in pixels.
    pub width: usize,
    /// Height in pixels.
    pub height: usize,
    /// True for each pixel that is left out of the comparison; empty if none is.
    pub excluded: &'a [bool],
}

/// Measures of a pair; NaN stands for a measure that was not taken.
#[derive(Clone, Debug, PartialEq)]
pub struct PerceptualScores {
    /// Structural similarity at five scales ([`ms_ssim`](crate::measures::metrics::ms_ssim)).
    pub ms_ssim: f64,
    /// Mean LDR-FLIP error over the pixels that are compared, 0 (equal) to 1.
    pub flip: f64,
    /// LPIPS distance, 0 (equal) or more.
    pub lpips: f64,
    /// LDR-FLIP error of each pixel, row by row; 0 where nothing is compared.
    pub flip_map: Option<Vec<f32>>,
}

impl PerceptualScores {
    /// All numbers are NaN: nothing was measured.
    pub const NOTHING: Self = Self { ms_ssim: f64::NAN, flip: f64::NAN, lpips: f64::NAN, flip_map: None };
}

/// Computation of the perceptual measures.
pub trait Perception {
    /// Measures a pair.
    ///
    /// # Errors
    /// When a measure cannot be computed.
    fn measure_perception(&mut self, pair: &Pair<'_>) -> Result<PerceptualScores>;
}

/// Measures nothing.
impl Perception for () {
    fn measure_perception(&mut self, _: &Pair<'_>) -> Result<PerceptualScores> {
        Ok(PerceptualScores::NOTHING)
    }
}
