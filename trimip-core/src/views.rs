//! Photographs for training and evaluation: 8-bit RGBA pixels in one flat array, divided into views, grouped by scale. Scale j holds images reduced by 2^j; the area weight of its pixels is 4^j (the paper's area loss).

use crate::{Camera, Result, config::Convention};
use std::ops::Range;

/// One image at one scale.
#[derive(Clone, Debug)]
pub struct View {
    /// Name of the photograph, for pictures and messages.
    pub name: String,
    /// Camera of this scale's pixels.
    pub camera: Camera,
    /// Index of the first pixel in [`ViewSet::pixels`]; rows are contiguous.
    pub offset: usize,
}

/// All views of one scale, contiguous in [`ViewSet::views`] and [`ViewSet::pixels`].
#[derive(Clone, Debug, PartialEq)]
pub struct Scale {
    /// Reduction 2^level: 1, 2, 4, 8.
    pub factor: u32,
    /// Loss weight of a pixel: its area, 4^level.
    pub weight: f32,
    /// Indices into [`ViewSet::views`].
    pub views: Range<usize>,
    /// Indices into [`ViewSet::pixels`].
    pub pixels: Range<usize>,
}

/// How alpha relates to colour in stored pixels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Alpha {
    /// Colour of the surface alone (PNG's own convention).
    Straight,
    /// Colour already multiplied by alpha.
    Premultiplied,
}

impl From<Convention> for Alpha {
    fn from(convention: Convention) -> Self {
        match convention {
            Convention::Public => Self::Straight,
            Convention::Premultiplied => Self::Premultiplied,
        }
    }
}

/// Views at several scales.
#[derive(Clone, Debug)]
pub struct ViewSet {
    /// Views, sorted by scale.
    pub views: Vec<View>,
    /// RGBA, 8 bits each.
    pub pixels: Vec<[u8; 4]>,
    /// Meaning of the pixels' colour.
    pub alpha: Alpha,
    /// Scales from fine to coarse.
    pub scales: Vec<Scale>,
}

impl ViewSet {
    /// Pixels of view `index`, row by row.
    pub fn pixels_of(&self, index: usize) -> &[[u8; 4]] {
        let view = &self.views[index];
        let k = &view.camera.intrinsics;
        &self.pixels[view.offset..view.offset + k.width as usize * k.height as usize]
    }

    /// View `index` on a background: RGB in [0, 1], row by row.
    pub fn composited(&self, index: usize, background: [f32; 3]) -> Vec<[f32; 3]> {
        self.pixels_of(index).iter().map(|&pixel| composite_pixel(pixel, self.alpha, background)).collect()
    }

    /// Means over blocks of `factor` × `factor` pixels of view `index`: premultiplied colour and opacity, not rounded.
    /// Rows and columns that do not fill a block are cropped.
    pub fn means(&self, index: usize, factor: u32) -> Vec<[f64; 4]> {
        let k = &self.views[index].camera.intrinsics;
        let (width, factor) = (k.width as usize, factor as usize);
        let (columns, rows) = (width / factor, k.height as usize / factor);
        let (pixels, share) = (self.pixels_of(index), ((factor * factor) as f64).recip());
        let mean = |i: usize| {
            let (x, y) = (i % columns * factor, i / columns * factor);
            let mut sum = [0.0; 4];
            for row in y..y + factor {
                for &pixel in &pixels[row * width + x..][..factor] {
                    let [r, g, b, a] = pixel.map(|byte| f64::from(byte) / 255.0);
                    let coverage = if self.alpha == Alpha::Straight { a } else { 1.0 };
                    for (sum, value) in sum.iter_mut().zip([r * coverage, g * coverage, b * coverage, a]) {
                        *sum += share * value;
                    }
                }
            }
            sum
        };
        (0..columns * rows).map(mean).collect()
    }

    /// View `index` through a true box filter over `factor` × `factor` pixels, on a background: RGB in [0, 1].
    pub fn box_filtered(&self, index: usize, factor: u32, background: [f32; 3]) -> Vec<[f32; 3]> {
        let on = |[r, g, b, a]: [f64; 4]| {
            let channel = |c: usize| [r, g, b][c] + (1.0 - a) * f64::from(background[c]);
            std::array::from_fn(|c| channel(c) as f32)
        };
        self.means(index, factor).into_iter().map(on).collect()
    }

    /// Bytes of pixels and views.
    pub fn bytes(&self) -> usize {
        self.pixels.len() * 4 + self.views.len() * size_of::<View>()
    }
}

/// An 8-bit RGBA pixel on a background: straight colour·α + (1 − α)·background, premultiplied colour + (1 − α)·background.
#[inline]
pub fn composite_pixel(pixel: [u8; 4], alpha: Alpha, background: [f32; 3]) -> [f32; 3] {
    let [r, g, b, a] = pixel.map(|byte| f32::from(byte) / 255.0);
    let coverage = match alpha {
        Alpha::Straight => a,
        Alpha::Premultiplied => 1.0,
    };
    std::array::from_fn(|c| [r, g, b][c] * coverage + (1.0 - a) * background[c])
}

/// Photographs for evaluation, decoded one frame at a time, so that a large test set needs little memory.
pub trait Frames: Send + Sync {
    /// Number of frames.
    fn len(&self) -> usize;
    /// True when there is none.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Cameras of all frames at every scale; no photograph is decoded.
    fn cameras(&self) -> Vec<Camera>;
    /// Frame `index` at every scale: a set of one view per scale, fine to coarse.
    fn load(&self, index: usize) -> Result<ViewSet>;
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn opaque_pixels_hide_the_background_and_clear_ones_show_it() {
        let background = [0.25, 0.5, 1.0];
        for alpha in [Alpha::Straight, Alpha::Premultiplied] {
            assert_eq!(composite_pixel([255, 0, 51, 255], alpha, background), [1.0, 0.0, 0.2]);
            assert_eq!(composite_pixel([0, 0, 0, 0], alpha, background), background);
        }
        let half = composite_pixel([255, 255, 255, 102], Alpha::Straight, [0.0; 3]);
        assert!(half.iter().all(|c| (c - 0.4).abs() < 1e-6));
    }
}
