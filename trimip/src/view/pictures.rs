//! Picture files of rendered frames: 8-bit sRGB PNG for colour, 16-bit grey PNG for depth and opacity, 32-bit float
//! EXR, and the comparison of a view with its photograph.

use image::{DynamicImage, ImageBuffer, ImageFormat, Luma, Rgb, RgbImage, imageops};
use std::io::Cursor;
use std::path::Path;
#[cfg(not(feature = "exr"))]
use trimip_core::Advice;
use trimip_core::{Error, Frame, Result, atomic::write_atomically};

/// Gain of the absolute difference in comparisons: a difference of 1/4 of the range has full brightness.
pub const DIFFERENCE_GAIN: f32 = 4.0;

/// Converts colours in [0, 1], [height, width], row by row, to 8-bit pixels, rounded; NaN becomes black.
pub fn rgb_image(width: u32, height: u32, rgb: &[[f32; 3]]) -> RgbImage {
    let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    ImageBuffer::from_fn(width, height, |x, y| {
        Rgb(rgb.get((y * width + x) as usize).copied().unwrap_or_default().map(byte))
    })
}

/// Returns the absolute difference per channel, multiplied by [`DIFFERENCE_GAIN`], for each pixel of both pictures in
/// order.
pub fn difference(a: &[[f32; 3]], b: &[[f32; 3]]) -> Vec<[f32; 3]> {
    a.iter().zip(b).map(|(a, b)| std::array::from_fn(|c| (a[c] - b[c]).abs() * DIFFERENCE_GAIN)).collect()
}

/// Places the rendered view, the photograph and their difference side by side, 2 white pixels apart. Both are RGB in [0,
/// 1], [height, width], row by row.
pub fn side_by_side(width: u32, height: u32, rendered: &[[f32; 3]], photograph: &[[f32; 3]]) -> RgbImage {
    const GAP: u32 = 2;
    let mut sheet = RgbImage::from_pixel(3 * width + 2 * GAP, height, Rgb([255; 3]));
    for (i, rgb) in [rendered, photograph, &difference(rendered, photograph)].into_iter().enumerate() {
        imageops::replace(&mut sheet, &rgb_image(width, height, rgb), i64::from(i as u32 * (width + GAP)), 0);
    }
    sheet
}

/// Returns the three panels of a [`side_by_side`] sheet.
pub fn panels(sheet: &RgbImage) -> [RgbImage; 3] {
    let width = sheet.width().saturating_sub(4) / 3;
    std::array::from_fn(|i| {
        imageops::crop_imm(sheet, i as u32 * (width + 2), 0, width, sheet.height()).to_image()
    })
}

/// Encodes a picture as PNG and returns the bytes of the file.
///
/// # Errors
/// When the picture cannot be encoded.
pub fn png(picture: impl Into<DynamicImage>) -> Result<Vec<u8>> {
    let mut bytes = Cursor::new(Vec::new());
    picture
        .into()
        .write_to(&mut bytes, ImageFormat::Png)
        .map_err(|error| Error::run(format!("cannot encode a PNG: {error}")))?;
    Ok(bytes.into_inner())
}

/// Writes a picture as PNG.
///
/// # Errors
/// When the file cannot be written.
pub fn write_png(path: &Path, picture: impl Into<DynamicImage>) -> Result<()> {
    write_atomically(path, &png(picture)?)
}

/// Writes the colours of a rendered view as 8-bit PNG.
///
/// # Errors
/// When the file cannot be written.
pub fn write_frame(path: &Path, frame: &Frame) -> Result<()> {
    write_png(path, rgb_image(frame.width, frame.height, &frame.rgb()))
}

/// Converts values between `low` and `high`, [height, width], row by row, to 16-bit grey.
pub fn grey(
    width: u32,
    height: u32,
    values: &[f32],
    low: f32,
    high: f32,
) -> ImageBuffer<Luma<u16>, Vec<u16>> {
    let range = (high - low).max(f32::MIN_POSITIVE);
    ImageBuffer::from_fn(width, height, |x, y| {
        let value = values.get((y * width + x) as usize).copied().unwrap_or_default();
        Luma([(((value - low) / range).clamp(0.0, 1.0) * 65_535.0).round() as u16])
    })
}

/// Returns the expected distance along the optical axis of each pixel, row by row, in world units: composited depth /
/// opacity; `empty` where the ray hits nothing.
pub fn depth(frame: &Frame, empty: f32) -> Vec<f32> {
    let seen = |opacity: f32| opacity > 1e-3;
    frame.pixels.iter().map(|p| if seen(p.opacity) { p.depth / p.opacity } else { empty }).collect()
}

/// Returns the opacity of every pixel, row by row.
pub fn opacity(frame: &Frame) -> Vec<f32> {
    frame.pixels.iter().map(|pixel| pixel.opacity).collect()
}

/// Depths in world units that map to black and white in a grey picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DepthRange {
    /// Depth that maps to black.
    pub near: f32,
    /// Depth that maps to white; rays that hit nothing are white too.
    pub far: f32,
}

impl DepthRange {
    /// Returns the keys and values that a picture file stores.
    fn stated(self) -> [(&'static str, String); 3] {
        [
            ("depth_near", self.near.to_string()),
            ("depth_far", self.far.to_string()),
            ("unit", "world units along the optical axis".into()),
        ]
    }
}

/// Writes depths, [height, width], row by row, in world units, as 16-bit grey PNG. Text chunks store the range and the
/// decoding formula.
///
/// # Errors
/// When the file cannot be written.
pub fn write_depth_png(path: &Path, width: u32, height: u32, depth: &[f32], range: DepthRange) -> Result<()> {
    let values = grey(width, height, depth, range.near, range.far);
    let mut bytes = Vec::new();
    let encode = |bytes: &mut Vec<u8>| {
        let mut encoder = png::Encoder::new(bytes, width, height);
        encoder.set_color(png::ColorType::Grayscale);
        encoder.set_depth(png::BitDepth::Sixteen);
        for (key, value) in range.stated() {
            encoder.add_text_chunk(key.into(), value)?;
        }
        let formula =
            "depth = depth_near + value / 65535 * (depth_far - depth_near); depth_far or nothing is white";
        encoder.add_text_chunk("Description".into(), formula.into())?;
        let mut writer = encoder.write_header()?;
        // PNG stores 16-bit values big-endian.
        let samples: Vec<u8> = values.as_raw().iter().flat_map(|value| value.to_be_bytes()).collect();
        writer.write_image_data(&samples)?;
        writer.finish()
    };
    encode(&mut bytes).map_err(|error| Error::run(format!("cannot encode a PNG: {error}")))?;
    write_atomically(path, &bytes)
}

/// Writes named 32-bit float channels, [height, width] each, row by row, as one EXR file. Attributes store the depth range, if
/// any.
///
/// # Errors
/// When the file cannot be written, or the build has no EXR.
#[cfg(feature = "exr")]
pub fn write_exr(
    path: &Path,
    width: u32,
    height: u32,
    channels: Vec<(&str, Vec<f32>)>,
    range: Option<DepthRange>,
) -> Result<()> {
    use exr::prelude::*;
    let channels = channels.into_iter().map(|(name, values)| AnyChannel::new(name, FlatSamples::F32(values)));
    let mut picture =
        Image::from_channels((width as usize, height as usize), AnyChannels::sort(channels.collect()));
    for (key, value) in range.iter().flat_map(|range| range.stated()) {
        let value = match value.parse() {
            Ok(number) => AttributeValue::F32(number),
            Err(_) => AttributeValue::Text(value.as_str().into()),
        };
        picture.layer_data.attributes.other.insert(key.into(), value);
    }
    let mut bytes = Cursor::new(Vec::new());
    picture
        .write()
        .to_buffered(&mut bytes)
        .map_err(|error| trimip_core::Error::run(format!("cannot encode an EXR: {error}")))?;
    write_atomically(path, &bytes.into_inner())
}

/// Always fails: this build has no EXR support.
///
/// # Errors
/// Always.
#[cfg(not(feature = "exr"))]
pub fn write_exr(
    path: &Path,
    _width: u32,
    _height: u32,
    _channels: Vec<(&str, Vec<f32>)>,
    _range: Option<DepthRange>,
) -> Result<()> {
    Err(Error::input(
        path.display(),
        "this build has no EXR",
        Advice::Argument("use {format} png, or build with feature `exr`".into()),
    ))
}

/// Converts an sRGB value to linear light (IEC 61966-2-1), which EXR stores by convention.
pub fn linear(value: f32) -> f32 {
    if value <= 0.040_45 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// Converts linear light to an sRGB value; the inverse of [`linear`].
pub fn srgb(light: f32) -> f32 {
    if light <= 0.040_45 / 12.92 { 12.92 * light } else { 1.055 * light.powf(2.4_f32.recip()) - 0.055 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_rounded_and_clamped() {
        let image = rgb_image(1, 1, &[[0.499 / 255.0, 1.5, f32::NAN]]);
        assert_eq!(image.get_pixel(0, 0).0, [0, 255, 0]);
    }

    #[test]
    fn a_sheet_comes_apart_into_its_panels() {
        let (rendered, photograph) = (vec![[1.0; 3]; 6], vec![[0.9; 3]; 6]);
        let [a, b, c] = panels(&side_by_side(3, 2, &rendered, &photograph));
        assert_eq!(a, rgb_image(3, 2, &rendered));
        assert_eq!(b, rgb_image(3, 2, &photograph));
        assert_eq!(c.get_pixel(2, 1).0, [102; 3]);
    }

    #[test]
    fn linear_light_keeps_black_and_white() {
        assert!(linear(0.0) == 0.0 && (linear(1.0) - 1.0).abs() < 1e-6);
        assert!((linear(0.5) - 0.214_041).abs() < 1e-5);
        assert!((0..=100).map(|i| i as f32 / 100.0).all(|value| (srgb(linear(value)) - value).abs() < 1e-5));
    }

    #[test]
    fn a_depth_png_says_how_its_depths_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        let (range, depth) = (DepthRange { near: 0.1, far: 3.7 }, [0.1, 1.9, 2.345_678, 3.7, 9.0, 0.0]);
        write_depth_png(&path, 3, 2, &depth, range).unwrap();
        let reader = png::Decoder::new(Cursor::new(std::fs::read(&path).unwrap())).read_info().unwrap();
        let texts = &reader.info().uncompressed_latin1_text;
        let stated = |key: &str| &texts.iter().find(|text| text.keyword == key).unwrap().text;
        let [near, far] = ["depth_near", "depth_far"].map(|key| stated(key).parse::<f32>().unwrap());
        assert_eq!((near, far), (range.near, range.far));
        assert!(stated("unit").starts_with("world units"));
        let picture = image::open(&path).unwrap().into_luma16();
        for (value, depth) in picture.as_raw().iter().zip(depth) {
            let read = near + f32::from(*value) / 65_535.0 * (far - near);
            assert!((read - depth.clamp(near, far)).abs() < 0.6 * (far - near) / 65_535.0, "{read} {depth}");
        }
    }

    #[cfg(feature = "exr")]
    #[test]
    fn an_exr_holds_its_channels() {
        use exr::prelude::*;
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.exr");
        let range = DepthRange { near: 1.25, far: 3.1 };
        write_exr(&path, 2, 1, vec![("Z", vec![1.5, 2.5]), ("R", vec![0.0, 1.0])], Some(range)).unwrap();
        let image = read_first_flat_layer_from_file(&path).unwrap();
        let channels = &image.layer_data.channel_data.list;
        assert_eq!(channels[1].name.to_string(), "Z");
        assert_eq!(channels[1].sample_data.values_as_f32().collect::<Vec<_>>(), [1.5, 2.5]);
        let stated = |key: &str| image.layer_data.attributes.other.get(&Text::from(key)).cloned();
        assert_eq!(stated("depth_near"), Some(AttributeValue::F32(1.25)));
        assert_eq!(stated("depth_far"), Some(AttributeValue::F32(3.1)));
        assert!(matches!(stated("unit"), Some(AttributeValue::Text(_))));
    }
}
