//! Image files: size from the header, pixels as 8-bit RGBA. 16-bit values are rounded to 8 bits, grey is copied to all three
//! colours, palettes are looked up, and missing alpha is 1. Floating-point pixels are refused, since no file states their range.

use crate::{
    foreign,
    orientation::{self, Turn},
    tiff, webp,
};
use image::{ColorType, DynamicImage, ImageDecoder, ImageFormat, ImageReader, Limits, metadata::Orientation};
use std::{
    fmt::Display,
    io::{BufRead, BufReader, Cursor, Seek},
    path::{Path, PathBuf},
};
use trimip_core::{Error, Place, Result, memory::available_memory, plain_file};

/// Largest number of pixels of an image (1 GiB of RGBA): more than any photograph, and addressable everywhere.
const MAX_PIXELS: u64 = 1 << 28;

/// Bytes of memory for each pixel of an image that is decoded and averaged: 4 for RGBA, 4 for a quarter of the pixels
/// in f32, and half a byte for the coarser levels. The decoder's own pixels are freed before the averages are made.
const BYTES_OF_A_PIXEL: u64 = 9;

/// Bytes of a pixel while it is decoded: four channels of 16 bits.
const MOST_BYTES_OF_A_PIXEL: u64 = 8;

/// Memory that decoding a TIFF file may take in addition to its pixels, for tiles larger than the image, bytes.
const BESIDE: u64 = 16 << 20;

/// An image file and its header.
#[derive(Debug)]
pub(crate) struct Photograph {
    pub(crate) path: PathBuf,
    /// The entry that names the image, for errors: `file: frame 17 (./train/r_17)`.
    pub(crate) place: Place,
    /// Size after `turn` is applied.
    pub(crate) width: u32,
    pub(crate) height: u32,
    /// Its EXIF orientation; `turn` says whether it is applied.
    tag: Orientation,
    pub(crate) turn: Turn,
    /// Channels and bits of its pixels.
    pub(crate) color: ColorType,
    /// True for a JPEG, whose pixels only approximate the original ones.
    pub(crate) lossy: bool,
}

impl Photograph {
    /// Reads the header of `path`. Its pixels are used as stored, unless [`fit`](Self::fit) turns them.
    pub(crate) fn open(path: PathBuf, place: Place) -> Result<Self> {
        match plain_file::open(&path) {
            Ok(file) => Self::header(path, place, BufReader::new(file)),
            Err(error) => Err(undecodable(&place, &path, &error)),
        }
    }

    /// Reads the header of the image `source`; `path` is its name.
    fn header(path: PathBuf, place: Place, source: impl BufRead + Seek) -> Result<Self> {
        let reader = reader(source).map_err(|error| undecodable(&place, &path, &error))?;
        let format = reader.format();
        if format == Some(ImageFormat::Tiff) && foreign::is_raw(&path) {
            return Err(undecodable(&place, &path, &""));
        }
        let mut decoder = reader.into_decoder().map_err(|error| undecodable(&place, &path, &error))?;
        let (width, height) = decoder.dimensions();
        if matches!(decoder.color_type(), ColorType::Rgb32F | ColorType::Rgba32F) {
            let what = format!("image {} has pixels of floating-point numbers", path.display());
            return Err(Error::input(place, what, "convert it and all similar images to 8 or 16 bits"));
        }
        let color = decoder.color_type();
        if width == 0 || height == 0 || u64::from(width) * u64::from(height) > MAX_PIXELS {
            return Err(Error::input(
                place,
                format!("image {} is {width}x{height} pixels", path.display()),
                format!("expected at least one and at most {MAX_PIXELS} pixels"),
            ));
        }
        let tag = decoder.orientation().unwrap_or(Orientation::NoTransforms);
        let turn = orientation::decide((width, height), tag, None, None);
        let lossy = format == Some(ImageFormat::Jpeg);
        Ok(Self { path, place, width, height, tag, turn, color, lossy })
    }

    /// Returns true if the file has an alpha channel.
    pub(crate) fn has_alpha(&self) -> bool {
        self.color.has_alpha()
    }

    /// Applies the EXIF orientation if the photograph has the stated size only after it is turned. A side that is `None` fits any length.
    pub(crate) fn fit(mut self, width: Option<u32>, height: Option<u32>) -> Self {
        self.turn = orientation::decide((self.width, self.height), self.tag, width, height);
        if let Turn::Applied(tag) = self.turn {
            (self.width, self.height) = orientation::turned((self.width, self.height), tag);
        }
        self
    }

    /// Returns the memory that decoding and averaging take, bytes.
    pub(crate) fn bytes_to_decode(&self) -> u64 {
        u64::from(self.width) * u64::from(self.height) * BYTES_OF_A_PIXEL
    }

    /// Refuses an image that does not fit into memory.
    pub(crate) fn expect_memory(&self) -> Result<()> {
        let (needed, available) = (self.bytes_to_decode(), available_memory());
        match available.filter(|available| *available < needed) {
            None => Ok(()),
            Some(available) => Err(Error::input(
                &self.place,
                format!(
                    "image {} of {}x{} pixels takes {:.0} MB to read, but only {:.0} MB are available",
                    self.path.display(),
                    self.width,
                    self.height,
                    (1e-6 * needed as f64).ceil(),
                    (1e-6 * available as f64).floor()
                ),
                "reduce its size",
            )),
        }
    }

    /// Decodes to width·height RGBA pixels, row by row.
    pub(crate) fn decode(&self) -> Result<Vec<u8>> {
        Ok(self.image()?.into_rgba8().into_raw())
    }

    /// Decodes to width·height pixels of the file's own kind.
    pub(crate) fn image(&self) -> Result<DynamicImage> {
        let bytes =
            plain_file::read(&self.path).map_err(|error| undecodable(&self.place, &self.path, &error))?;
        self.decoded(&bytes)
    }

    fn decoded(&self, bytes: &[u8]) -> Result<DynamicImage> {
        let wrong = |error: &dyn Display| undecodable(&self.place, &self.path, error);
        // The decoder fills the missing part of a JPEG with grey.
        if is_truncated_jpeg(bytes) {
            return Err(wrong(&"the file ends before the image does"));
        }
        let mut reader = reader(Cursor::new(bytes)).map_err(|error| wrong(&error))?;
        if reader.format() == Some(ImageFormat::Tiff) {
            let mut limits = Limits::default();
            // The pixels are counted twice: by the reader and by its decoder.
            let pixels = 2 * MOST_BYTES_OF_A_PIXEL * u64::from(self.width) * u64::from(self.height);
            limits.max_alloc = Some(pixels + bytes.len() as u64 + BESIDE);
            reader.limits(limits);
        }
        let mut image = reader.decode().map_err(|error| wrong(&error))?;
        if let Turn::Applied(tag) = self.turn {
            image.apply_orientation(tag);
        }
        if (image.width(), image.height()) != (self.width, self.height) {
            return Err(wrong(&"it changed while it was read"));
        }
        Ok(image)
    }
}

/// Decodes the image in the bytes of a file; `path` is its name.
pub(crate) fn of_bytes(path: &Path, bytes: &[u8]) -> Result<DynamicImage> {
    Photograph::header(path.into(), path.into(), Cursor::new(bytes))?.decoded(bytes)
}

/// Returns true for a truncated JPEG. The search skips segments by their length; within coded data a byte FF is
/// followed by 00 or a restart marker, otherwise it starts the next segment (ITU T.81, B.1.1). Data after the end of
/// the image, such as the video of a motion photo, are ignored.
fn is_truncated_jpeg(bytes: &[u8]) -> bool {
    let Some(mut rest) = bytes.strip_prefix(&[0xff, 0xd8]) else { return false };
    let is_marker = |pair: &[u8]| pair[0] == 0xff && !matches!(pair[1], 0x00 | 0x01 | 0xff | 0xd0..=0xd8);
    while let Some(at) = rest.windows(2).position(is_marker) {
        if rest[at + 1] == 0xd9 {
            return false;
        }
        let segment = &rest[at + 2..];
        let Some((&length, _)) = segment.split_first_chunk() else { break };
        let Some(after) = segment.get(usize::from(u16::from_be_bytes(length))..) else { break };
        rest = after;
    }
    true
}

fn reader<S: BufRead + Seek>(mut source: S) -> image::ImageResult<ImageReader<S>> {
    webp::check(&mut source)?;
    tiff::check(&mut source)?;
    // The content determines the format, not the name: JPEGs named .png are common.
    Ok(ImageReader::new(source).with_guessed_format()?)
}

fn undecodable(place: &Place, path: &Path, error: &dyn Display) -> Error {
    if let Some(format) = foreign::of_file(path) {
        let what = format!("image {} is {}, which is not read", path.display(), format.name);
        return Error::input(place, what, format.remedy(path));
    }
    Error::input(
        place,
        format!("image {} cannot be decoded: {error}", path.display()),
        "copy or export the image again (PNG or JPEG)",
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::{DynamicImage, ImageBuffer, Luma, LumaA, Rgb, Rgba};
    use std::fs;

    fn round_trip(image: impl Into<DynamicImage>, name: &str) -> (Vec<u8>, bool) {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        image.into().save(&path).unwrap();
        let photograph = Photograph::open(path, "test".into()).unwrap();
        (photograph.decode().unwrap(), photograph.has_alpha())
    }

    #[test]
    fn sixteen_bits_are_rounded_to_the_nearest_eight() {
        let image = ImageBuffer::from_fn(256, 256, |x, y| Luma([(y * 256 + x) as u16]));
        let (pixels, alpha) = round_trip(image, "a.png");
        assert!(!alpha);
        for (value, pixel) in pixels.chunks_exact(4).enumerate() {
            let nearest = (value as f64 / 257.0).round() as u8;
            assert_eq!(pixel, [nearest, nearest, nearest, 255], "{value}");
        }
    }

    #[test]
    fn every_kind_of_pixel_becomes_rgba() {
        let kinds: [(DynamicImage, [u8; 4], bool); 6] = [
            (ImageBuffer::from_pixel(3, 2, Luma([7_u8])).into(), [7, 7, 7, 255], false),
            (ImageBuffer::from_pixel(3, 2, LumaA([7_u8, 9])).into(), [7, 7, 7, 9], true),
            (ImageBuffer::from_pixel(3, 2, Rgb([1_u8, 2, 3])).into(), [1, 2, 3, 255], false),
            (ImageBuffer::from_pixel(3, 2, Rgba([1_u8, 2, 3, 4])).into(), [1, 2, 3, 4], true),
            (ImageBuffer::from_pixel(3, 2, Rgb([257_u16, 514, 771])).into(), [1, 2, 3, 255], false),
            (ImageBuffer::from_pixel(3, 2, Rgba([257_u16, 514, 771, 1028])).into(), [1, 2, 3, 4], true),
        ];
        for (image, expected, has_alpha) in kinds {
            let (pixels, alpha) = round_trip(image, "a.png");
            assert_eq!((pixels, alpha), (expected.repeat(6), has_alpha));
        }
    }

    #[test]
    fn palettes_are_looked_up() {
        // A 2x1 PNG of colour type 3: entries (10, 20, 30), and (40, 50, 60) with alpha 128.
        let bytes: &[u8] = &[
            0x89, 0x50, 0x4e, 0x47, 0x0d, 0x0a, 0x1a, 0x0a, 0x00, 0x00, 0x00, 0x0d, 0x49, 0x48, 0x44, 0x52,
            0x00, 0x00, 0x00, 0x02, 0x00, 0x00, 0x00, 0x01, 0x08, 0x03, 0x00, 0x00, 0x00, 0xc3, 0xfc, 0x8f,
            0xb8, 0x00, 0x00, 0x00, 0x06, 0x50, 0x4c, 0x54, 0x45, 0x0a, 0x14, 0x1e, 0x28, 0x32, 0x3c, 0xd5,
            0x1b, 0xb4, 0xe9, 0x00, 0x00, 0x00, 0x02, 0x74, 0x52, 0x4e, 0x53, 0xff, 0x80, 0x08, 0x0f, 0xb3,
            0x6a, 0x00, 0x00, 0x00, 0x0b, 0x49, 0x44, 0x41, 0x54, 0x78, 0x9c, 0x63, 0x60, 0x60, 0x04, 0x00,
            0x00, 0x04, 0x00, 0x02, 0xbf, 0x7a, 0x3f, 0x4a, 0x00, 0x00, 0x00, 0x00, 0x49, 0x45, 0x4e, 0x44,
            0xae, 0x42, 0x60, 0x82,
        ];
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        fs::write(&path, bytes).unwrap();
        let photograph = Photograph::open(path, "test".into()).unwrap();
        assert_eq!(photograph.decode().unwrap(), [10, 20, 30, 255, 40, 50, 60, 128]);
        assert!(photograph.has_alpha());
    }

    #[test]
    fn truncated_files_are_errors_wherever_they_end() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["a.png", "a.jpg"] {
            let path = folder.path().join(name);
            let image =
                ImageBuffer::from_fn(33, 17, |x, y| Rgb([(x * 7) as u8, (y * 13) as u8, (x * y) as u8]));
            DynamicImage::from(image).save(&path).unwrap();
            let whole = fs::read(&path).unwrap();
            Photograph::open(path.clone(), "here".into()).unwrap().decode().unwrap();
            // The last 12 bytes of a PNG are its empty end chunk: the pixels are complete without it.
            let end = if name.ends_with("png") { whole.len() - 12 } else { whole.len() };
            for length in (0..end).step_by(7) {
                fs::write(&path, &whole[..length]).unwrap();
                let result = Photograph::open(path.clone(), "here".into()).and_then(|image| image.decode());
                let message = result.expect_err(&format!("{name} of {length} bytes")).message();
                assert!(message.starts_with("here: image ") && !message.contains('\n'), "{message}");
            }
        }
    }

    /// Checks that data after the end of the image are ignored, such as the video of a motion photo.
    #[test]
    fn what_follows_the_end_of_the_image_is_not_looked_at() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.jpg");
        DynamicImage::from(ImageBuffer::from_pixel(9, 5, Rgb([9_u8, 99, 199]))).save(&path).unwrap();
        let whole = fs::read(&path).unwrap();
        let decoded = || Photograph::open(path.clone(), "here".into()).unwrap().decode().unwrap();
        let before = decoded();
        fs::write(&path, [&whole[..], &[0xff, 0xda, 0x00, 0x7f]].concat()).unwrap();
        assert_eq!(decoded(), before);
    }

    #[test]
    fn the_content_decides_the_format() {
        let folder = tempfile::tempdir().unwrap();
        let (jpeg, path) = (folder.path().join("a.jpg"), folder.path().join("b.png"));
        DynamicImage::from(ImageBuffer::from_pixel(8, 8, Rgb([200_u8, 200, 200]))).save(&jpeg).unwrap();
        fs::rename(jpeg, &path).unwrap();
        let pixels = Photograph::open(path, "test".into()).unwrap().decode().unwrap();
        assert!(pixels.chunks_exact(4).all(|pixel| pixel[0].abs_diff(200) <= 1));
    }
}
