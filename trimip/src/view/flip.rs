//! LDR-FLIP (Andersson et al. 2020) by NVIDIA's library, in builds with the feature `flip`.

use image::RgbImage;
#[cfg(feature = "flip")]
use nv_flip::{FlipImageFloat, FlipImageRgb8, flip, magma_lut};

/// Pixels per degree of the visual field, the default of FLIP: a screen 0.7 m wide with 3840 pixels, seen from 0.7 m.
pub const PIXELS_PER_DEGREE: f32 = 67.0;

/// Returns the FLIP error of each pixel of two equally large pictures, row by row, 0 (equal) to 1; `None` if this build has no FLIP.
pub fn flip_of_pictures(rendered: &RgbImage, target: &RgbImage) -> Option<Vec<f32>> {
    #[cfg(feature = "flip")]
    {
        let (width, height) = rendered.dimensions();
        let picture = |bytes: &[u8]| FlipImageRgb8::with_data(width, height, bytes);
        Some(flip(picture(target), picture(rendered), PIXELS_PER_DEGREE).to_vec())
    }
    #[cfg(not(feature = "flip"))]
    {
        let _ = (rendered, target);
        None
    }
}

/// Returns a map of FLIP errors, one per pixel, row by row, as a picture in the colours of magma: black where no difference is
/// visible, pale yellow at 1; `None` if this build has no FLIP.
pub fn flip_colors(width: u32, height: u32, errors: &[f32]) -> Option<RgbImage> {
    #[cfg(feature = "flip")]
    {
        let colors = FlipImageFloat::with_data(width, height, errors).apply_color_lut(&magma_lut()).to_vec();
        RgbImage::from_raw(width, height, colors)
    }
    #[cfg(not(feature = "flip"))]
    {
        let _ = (width, height, errors);
        None
    }
}
