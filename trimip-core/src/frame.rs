//! A rendered image: colour, opacity and depth per pixel.

/// A rendered view, row by row from the upper left pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// `width · height` pixels.
    pub pixels: Vec<Pixel>,
}

/// One composited pixel.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Pixel {
    /// RGB on the background, in the values of the training images.
    pub rgb: [f32; 3],
    /// 1 − transmittance of the whole ray, in [0, 1].
    pub opacity: f32,
    /// Σ w·t·cosθ: distance along the optical axis weighted by the samples' weights, world units (not divided by opacity).
    pub depth: f32,
}

impl Frame {
    /// RGB of every pixel.
    pub fn rgb(&self) -> Vec<[f32; 3]> {
        self.pixels.iter().map(|pixel| pixel.rgb).collect()
    }
}
