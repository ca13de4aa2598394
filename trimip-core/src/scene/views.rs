//! Photographs for training and evaluation: 8-bit RGBA pixels in one flat array, divided into views, grouped by scale. Scale j
//! holds images reduced by 2^j; the area weight of its pixels is 4^j (the paper's area loss).

use super::depths::KnownDepth;
use crate::{Camera, Pixels, Result, config::Convention};
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
    /// Reduction factor 2^level: 1, 2, 4 or 8.
    pub factor: u32,
    /// Loss weight of a pixel: its area, 4^level.
    pub weight: f32,
    /// Indices into [`ViewSet::views`].
    pub views: Range<usize>,
    /// Indices into [`ViewSet::pixels`].
    pub pixels: Range<usize>,
}

/// Meaning of alpha in stored pixels, and how colour relates to it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Alpha {
    /// Alpha is opacity; colour is that of the surface alone (PNG's own convention).
    Straight,
    /// Alpha is opacity; colour is already multiplied by it.
    Premultiplied,
    /// Alpha is the share of the pixel that counts; the rest was masked as unknown. Colour is the mean of that share, on no
    /// background.
    Kept,
}

/// Least alpha of a pixel that is compared, for [`Alpha::Kept`]: half of the pixel.
const COMPARED: u8 = 128;

impl Alpha {
    /// Returns true if alpha separates the object from the background.
    pub fn is_opacity(self) -> bool {
        self != Self::Kept
    }

    /// Returns the opacity of a pixel, in [0, 1].
    #[inline]
    pub fn opacity(self, pixel: [u8; 4]) -> f32 {
        if self.is_opacity() { f32::from(pixel[3]) / 255.0 } else { 1.0 }
    }

    /// Returns the share of a pixel that counts in the loss, in [0, 1].
    #[inline]
    pub fn fraction(self, pixel: [u8; 4]) -> f32 {
        if self.is_opacity() { 1.0 } else { f32::from(pixel[3]) / 255.0 }
    }

    /// Returns true for a pixel that image metrics leave out: less than half of it counts.
    #[inline]
    pub fn leaves_out(self, pixel: [u8; 4]) -> bool {
        !self.is_opacity() && pixel[3] < COMPARED
    }
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
    pub pixels: Pixels,
    /// Meaning of the pixels' alpha and colour.
    pub alpha: Alpha,
    /// Scales from fine to coarse.
    pub scales: Vec<Scale>,
    /// Pixels whose distance is known, sorted by pixel; empty without tracked points or depth images.
    pub depths: Vec<KnownDepth>,
}

impl ViewSet {
    /// Returns the number of photographs: the views of the finest scale.
    pub fn photographs(&self) -> usize {
        self.scales.first().map_or(0, |finest| finest.views.len())
    }

    /// Returns the RGBA pixels of view `index`, [height, width], row by row.
    pub fn pixels_of(&self, index: usize) -> &[[u8; 4]] {
        let view = &self.views[index];
        let k = &view.camera.intrinsics;
        &self.pixels[view.offset..view.offset + k.width as usize * k.height as usize]
    }

    /// Composites view `index` on a background. Returns RGB in [0, 1], row by row.
    pub fn composited(&self, index: usize, background: [f32; 3]) -> Vec<[f32; 3]> {
        self.pixels_of(index).iter().map(|&pixel| composite_pixel(pixel, self.alpha, background)).collect()
    }

    /// Returns the means over blocks of `factor` × `factor` pixels of view `index`, row by row: premultiplied colour and
    /// opacity, not rounded. For [`Alpha::Kept`], a mean is the mean colour of the kept part, with opacity 1. Rows and
    /// columns that do not fill a block are cropped.
    pub fn means(&self, index: usize, factor: u32) -> Vec<[f64; 4]> {
        let k = &self.views[index].camera.intrinsics;
        let (width, factor) = (k.width as usize, factor as usize);
        let (columns, rows) = (width / factor, k.height as usize / factor);
        let (pixels, fraction) = (self.pixels_of(index), ((factor * factor) as f64).recip());
        let mean = |i: usize| {
            let (x, y) = (i % columns * factor, i / columns * factor);
            let mut sum = [0.0; 4];
            for row in y..y + factor {
                for &pixel in &pixels[row * width + x..][..factor] {
                    let [r, g, b, a] = pixel.map(|byte| f64::from(byte) / 255.0);
                    let coverage = if self.alpha == Alpha::Premultiplied { 1.0 } else { a };
                    for (sum, value) in sum.iter_mut().zip([r * coverage, g * coverage, b * coverage, a]) {
                        *sum += fraction * value;
                    }
                }
            }
            if self.alpha.is_opacity() {
                return sum;
            }
            let [r, g, b, kept] = sum;
            let colour = |sum: f64| if kept > 0.0 { sum / kept } else { 0.0 };
            [colour(r), colour(g), colour(b), 1.0]
        };
        (0..columns * rows).map(mean).collect()
    }

    /// Filters view `index` with a true box filter of `factor` × `factor` pixels and composites it on a background. Returns
    /// RGB in [0, 1], row by row as [`means`](Self::means) does.
    pub fn box_filtered(&self, index: usize, factor: u32, background: [f32; 3]) -> Vec<[f32; 3]> {
        let on = |[r, g, b, a]: [f64; 4]| {
            let channel = |c: usize| [r, g, b][c] + (1.0 - a) * f64::from(background[c]);
            std::array::from_fn(|c| channel(c) as f32)
        };
        self.means(index, factor).into_iter().map(on).collect()
    }

    /// Returns the bytes that pixels, views and known depths take in memory.
    pub fn bytes(&self) -> usize {
        self.pixels.bytes_in_memory()
            + self.views.len() * size_of::<View>()
            + self.depths.len() * size_of::<KnownDepth>()
    }
}

/// Composites an 8-bit RGBA pixel on a background: colour·α + (1 − α)·background for straight alpha, colour + (1 −
/// α)·background for premultiplied alpha, and the colour itself if alpha is not opacity.
#[inline]
pub fn composite_pixel(pixel: [u8; 4], alpha: Alpha, background: [f32; 3]) -> [f32; 3] {
    let [r, g, b, _] = pixel.map(|byte| f32::from(byte) / 255.0);
    let a = alpha.opacity(pixel);
    let coverage = match alpha {
        Alpha::Straight => a,
        Alpha::Premultiplied | Alpha::Kept => 1.0,
    };
    std::array::from_fn(|c| [r, g, b][c] * coverage + (1.0 - a) * background[c])
}

/// Photographs for evaluation, decoded one frame at a time, so that a large test set needs little memory.
pub trait Frames: Send + Sync {
    /// Returns the number of frames.
    fn len(&self) -> usize;
    /// Returns true if there are no frames.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }
    /// Returns the names of the frames, which are also those of their views. Decodes no photograph.
    fn names(&self) -> Vec<String>;
    /// Returns the cameras of all frames at every scale. Decodes no photograph.
    fn cameras(&self) -> Vec<Camera>;
    /// Loads frame `index` at every scale: a set of one view per scale, fine to coarse.
    ///
    /// # Errors
    /// When the photograph or its mask cannot be read.
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

    #[test]
    fn a_share_that_counts_weighs_pixels_and_shows_no_background() {
        for fraction in [0, 51, 255] {
            let pixel = [255, 0, 51, fraction];
            assert_eq!(composite_pixel(pixel, Alpha::Kept, [0.5; 3]), [1.0, 0.0, 0.2]);
            assert_eq!((Alpha::Kept.opacity(pixel), Alpha::Straight.fraction(pixel)), (1.0, 1.0));
            assert_eq!(Alpha::Kept.fraction(pixel), Alpha::Straight.opacity(pixel));
        }
        assert!(Alpha::Kept.leaves_out([9, 9, 9, 127]) && !Alpha::Kept.leaves_out([9, 9, 9, 128]));
        assert!(!Alpha::Straight.leaves_out([0; 4]));
    }

    #[test]
    fn means_are_of_the_part_that_counts() {
        let k = crate::Intrinsics::from_angle(4, 2, 0.7);
        let camera = Camera { intrinsics: k, rotation: glam::DMat3::IDENTITY, origin: glam::DVec3::ZERO };
        let (red, grey, garbage) = ([255, 0, 0, 255], [51, 51, 51, 255], [7, 77, 177, 0]);
        let set = ViewSet {
            views: vec![View { name: String::new(), camera, offset: 0 }],
            pixels: vec![red, garbage, garbage, garbage, grey, grey, garbage, garbage].into(),
            alpha: Alpha::Kept,
            scales: Vec::new(),
            depths: Vec::new(),
        };
        let third = 1.0 / 3.0;
        let expected = [[third + 0.4 * third, 0.4 * third, 0.4 * third, 1.0], [0.0, 0.0, 0.0, 1.0]];
        let found = set.means(0, 2);
        let near = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-12;
        assert!(found.as_flattened().iter().zip(expected.as_flattened()).all(near), "{found:?}");
        assert_eq!(set.box_filtered(0, 2, [1.0; 3])[1], [0.0; 3]);
    }
}
