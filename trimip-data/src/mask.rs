//! A mask: a picture of the size of its photograph that marks the pixels to keep. The value of a pixel is its brightest
//! colour channel, or its alpha if all pixels have one colour. Kept shares have 8 bits: 255 is kept whole.

use crate::photograph::Photograph;
use image::{DynamicImage, ImageBuffer, Luma, Rgb};
use std::path::PathBuf;
use trimip_core::{Error, Result};

/// Greatest deviation from black or white that the compression of a JPEG causes, in steps of 1/255.
const TRACES: u8 = 24;

/// Meaning of the pixels that a mask does not keep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// Empty space: the mask is the photograph's alpha.
    Object,
    /// Unknown: the pixel is neither trained nor evaluated.
    Ignore,
}

/// A mask of a photograph.
#[derive(Debug)]
pub(crate) struct Mask {
    file: Photograph,
    /// True if white marks the kept pixels, false if black does.
    white: bool,
    role: Role,
}

impl Mask {
    /// Opens the mask in a file.
    ///
    /// # Errors
    /// If the file is no image, or does not have the size of `photograph`.
    pub(crate) fn open(path: PathBuf, photograph: &Photograph, white: bool, role: Role) -> Result<Self> {
        let file = Photograph::open(path, photograph.place.clone())?;
        if (file.width, file.height) != (photograph.width, photograph.height) {
            return Err(Error::input(
                &photograph.place,
                format!(
                    "mask {} is {}x{} pixels, but image {} is {}x{}",
                    file.path.display(),
                    file.width,
                    file.height,
                    photograph.path.display(),
                    photograph.width,
                    photograph.height
                ),
                "make masks of the photographs' size, or set data.masks = \"none\"",
            ));
        }
        Ok(Self { file, white, role })
    }

    pub(crate) fn path(&self) -> &std::path::Path {
        &self.file.path
    }

    pub(crate) fn role(&self) -> Role {
        self.role
    }

    /// Returns true if white marks the kept pixels.
    pub(crate) fn keeps_white(&self) -> bool {
        self.white
    }

    /// Multiplies the alpha of straight pixels by the mask, row by row. Pixels of which nothing is kept become black:
    /// their colour is that of the background, and would enter the means of straight colours.
    ///
    /// # Errors
    /// If the mask cannot be decoded.
    pub(crate) fn apply(&self, pixels: &mut [[u8; 4]]) -> Result<()> {
        let mut image = self.file.image()?;
        if self.file.lossy {
            image = sharpened(image, self.role);
        }
        let fractions = fractions(image, self.white, self.role);
        for (pixel, fraction) in pixels.iter_mut().zip(fractions) {
            let alpha = (u32::from(pixel[3]) * u32::from(fraction) + 127) / 255;
            *pixel = if fraction == 0 { [0; 4] } else { [pixel[0], pixel[1], pixel[2], alpha as u8] };
        }
        Ok(())
    }
}

/// Returns the kept share of each pixel of an object's mask whose white is kept.
pub(crate) fn kept(image: DynamicImage) -> Vec<u8> {
    fractions(image, true, Role::Object)
}

/// Sharpens a mask that was stored as a JPEG: values near black and white are traces of the compression and become black
/// and white. For [`Role::Ignore`], where grey has no meaning, values below half become black and all others white.
fn sharpened(image: DynamicImage, role: Role) -> DynamicImage {
    let (black, white) = if role == Role::Ignore { (127, 128) } else { (TRACES, 255 - TRACES) };
    let image = image.into_rgb8();
    let sharp = |x, y| {
        let Rgb([r, g, b]) = *image.get_pixel(x, y);
        Luma([match r.max(g).max(b) {
            dark if dark <= black => 0,
            bright if bright >= white => 255,
            grey => grey,
        }])
    };
    ImageBuffer::from_fn(image.width(), image.height(), sharp).into()
}

/// Returns the kept share of each pixel of a mask.
fn fractions(image: DynamicImage, white: bool, role: Role) -> Vec<u8> {
    let transparent = image.color().has_alpha();
    let rgba = image.into_rgba16().into_raw();
    let pixels = rgba.as_chunks::<4>().0;
    let same = |values: &dyn Fn(&[u16; 4]) -> [u16; 3]| {
        pixels.first().is_none_or(|first| pixels.iter().all(|pixel| values(pixel) == values(first)))
    };
    let shape_in_alpha =
        transparent && same(&|&[r, g, b, _]| [r, g, b]) && !same(&|&[.., alpha]| [alpha, 0, 0]);
    let grey = |&[r, g, b, alpha]: &[u16; 4]| if shape_in_alpha { alpha } else { r.max(g).max(b) };
    // Masks of two values may have any number for white, such as 1, 128 or 255.
    let most = pixels.iter().map(grey).max().unwrap_or(0);
    let two_values = pixels.iter().map(grey).all(|value| value == 0 || value == most);
    let fraction = |value: u16| match value {
        0 => 0,
        _ if two_values || role == Role::Ignore => 255,
        _ => ((u32::from(value) + 128) / 257) as u8,
    };
    pixels
        .iter()
        .map(|pixel| if white { fraction(grey(pixel)) } else { 255 - fraction(grey(pixel)) })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{LumaA, Rgba};

    fn of<P: image::Pixel + 'static>(pixels: [P; 4], white: bool, role: Role) -> Vec<u8>
    where
        DynamicImage: From<ImageBuffer<P, Vec<P::Subpixel>>>,
    {
        fractions(ImageBuffer::from_fn(4, 1, |x, _| pixels[x as usize]).into(), white, role)
    }

    #[test]
    fn traces_of_compression_are_no_soft_edges() {
        let of = |values: [u8; 4], role| {
            let image = ImageBuffer::from_fn(4, 1, |x, _| Luma([values[x as usize]]));
            fractions(sharpened(image.into(), role), true, role)
        };
        assert_eq!(of([3, 250, 24, 231], Role::Object), [0, 255, 0, 255]);
        assert_eq!(of([3, 250, 100, 40], Role::Object), [0, 255, 100, 40], "soft edges stay");
        assert_eq!(of([3, 250, 100, 140], Role::Ignore), [0, 255, 0, 255]);
    }

    #[test]
    fn every_kind_of_picture_is_a_mask() {
        let grey = [0_u8, 255, 0, 255];
        let expected = [0, 255, 0, 255];
        let both = [Role::Object, Role::Ignore];
        for role in both {
            assert_eq!(of(grey.map(|v| Luma([v])), true, role), expected);
            assert_eq!(of(grey.map(|v| Luma([u16::from(v) * 257])), true, role), expected);
            assert_eq!(of(grey.map(|v| Rgb([v, 0, 0])), true, role), expected);
            assert_eq!(of(grey.map(|v| Rgba([v, v, v, 9])), true, role), expected);
            assert_eq!(
                of(grey.map(|v| LumaA([255, v])), true, role),
                expected,
                "one colour: alpha is the shape"
            );
            assert_eq!(of([0_u8, 1, 0, 1].map(|v| Luma([v])), true, role), expected, "labels 0 and 1");
            assert_eq!(of([0_u16, 1, 0, 1].map(|v| Luma([v])), true, role), expected, "labels of 16 bits");
            assert_eq!(of(grey.map(|v| Luma([v])), false, role), [255, 0, 255, 0], "black keeps");
            // An opaque picture of one colour keeps all or nothing, depending on its colour.
            assert_eq!(of([Rgba([0_u8, 0, 0, 255]); 4], true, role), [0; 4]);
            assert_eq!(of([Rgba([255_u8, 255, 255, 255]); 4], true, role), [255; 4]);
        }
    }

    #[test]
    fn soft_edges_are_opacity_of_objects_and_a_part_of_what_is_marked() {
        let soft = [0_u8, 1, 128, 255].map(|v| Luma([v]));
        assert_eq!(of(soft, true, Role::Object), [0, 1, 128, 255]);
        assert_eq!(of(soft, false, Role::Object), [255, 254, 127, 0]);
        // In nerfstudio's and Instant-NGP's masks, every value other than black is white.
        assert_eq!(of(soft, true, Role::Ignore), [0, 255, 255, 255]);
        assert_eq!(of(soft, false, Role::Ignore), [255, 0, 0, 0]);
    }
}
