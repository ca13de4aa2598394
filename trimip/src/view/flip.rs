//! LDR-FLIP (Andersson et al. 2020) by NVIDIA's library.

use super::perceiver::PIXELS_PER_DEGREE;
use nv_flip::{FlipImageFloat, FlipImageRgb8, flip, magma_lut};

/// Error of each pixel, 0 (equal) to 1, of two sRGB pictures of 8 bits: three bytes a pixel, row by row.
pub fn map(width: u32, height: u32, rendered: &[u8], target: &[u8]) -> Vec<f32> {
    let picture = |bytes: &[u8]| FlipImageRgb8::with_data(width, height, bytes);
    flip(picture(target), picture(rendered), PIXELS_PER_DEGREE).to_vec()
}

/// Errors as colours of magma: black at 0, pale yellow at 1; three bytes a pixel.
pub fn colors(width: u32, height: u32, errors: &[f32]) -> Vec<u8> {
    FlipImageFloat::with_data(width, height, errors).apply_color_lut(&magma_lut()).to_vec()
}
