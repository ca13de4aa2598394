//! A rendered frame as a picture, and a picture as JPEG.

use crate::protocol::Show;
use glam::DVec3;
use image::codecs::jpeg::JpegEncoder;
use image::{Rgb, RgbImage};
use trimip::view::pictures::{depth, difference, rgb_image};
use trimip::view::{depth_range, flip_colors, flip_of_pictures};
use trimip_core::config::SceneConfig;
use trimip_core::{Camera, Error, Frame, Result};

/// Opacity below which a pixel has no surface.
const SURFACE: f32 = 0.5;

/// Bytes of a picture at most, for each pixel; a picture of 400×400 pixels has 60,000. Below [`LEAST_BYTES`] it may have more.
const BYTES_PER_PIXEL: f64 = 0.375;

/// Pictures of fewer bytes are never made smaller.
const LEAST_BYTES: usize = 8000;

/// JPEG qualities, tried in order until a picture is small enough.
const QUALITIES: [u8; 4] = [90, 80, 65, 50];

/// The picture of a frame. `photograph` has its size; a comparison without one shows the colours.
pub fn picture(
    frame: &Frame,
    camera: &Camera,
    scene: &SceneConfig,
    show: Show,
    photograph: Option<&RgbImage>,
) -> RgbImage {
    let (width, height) = (frame.width, frame.height);
    let grey = |values: Vec<f32>| {
        let rgb: Vec<[f32; 3]> = values.into_iter().map(|value| [value; 3]).collect();
        rgb_image(width, height, &rgb)
    };
    match (show, photograph) {
        (Show::Opacity, _) => grey(frame.pixels.iter().map(|pixel| pixel.opacity).collect()),
        (Show::Depth, _) => {
            let range = depth_range(scene, camera);
            let span = (range.far - range.near).max(f32::MIN_POSITIVE);
            grey(depth(frame, range.far).into_iter().map(|depth| 1.0 - (depth - range.near) / span).collect())
        }
        (Show::Normals, _) => normals(frame, camera),
        (Show::Difference, Some(photograph)) => {
            let target: Vec<[f32; 3]> =
                photograph.pixels().map(|pixel| pixel.0.map(|value| f32::from(value) / 255.0)).collect();
            rgb_image(width, height, &difference(&frame.rgb(), &target))
        }
        (Show::Flip, Some(photograph)) => {
            let own = rgb_image(width, height, &frame.rgb());
            let errors = flip_of_pictures(&own, photograph);
            errors.and_then(|errors| flip_colors(width, height, &errors)).unwrap_or(own)
        }
        _ => rgb_image(width, height, &frame.rgb()),
    }
}

/// Directions of the surface from the points that neighbouring pixels see; grey where there is none.
fn normals(frame: &Frame, camera: &Camera) -> RgbImage {
    let (k, depths) = (camera.intrinsics, depth(frame, 0.0));
    let point = |x: u32, y: u32| {
        let at = (y * frame.width + x) as usize;
        let distance = f64::from(depths[at]);
        let own = DVec3::new(
            (f64::from(x) + 0.5 - k.cx) / k.fx * distance,
            -(f64::from(y) + 0.5 - k.cy) / k.fy * distance,
            -distance,
        );
        (frame.pixels[at].opacity >= SURFACE).then_some(own)
    };
    let direction = |x: u32, y: u32| -> Option<DVec3> {
        let here = point(x, y)?;
        let right = point((x + 1).min(frame.width - 1), y)? - point(x.saturating_sub(1), y)?;
        let down = point(x, (y + 1).min(frame.height - 1))? - point(x, y.saturating_sub(1))?;
        let normal = (camera.rotation * down.cross(right)).try_normalize()?;
        // It points to the camera.
        Some(if (camera.rotation * here).dot(normal) > 0.0 { -normal } else { normal })
    };
    RgbImage::from_fn(frame.width, frame.height, |x, y| {
        let Some(normal) = direction(x, y) else { return Rgb([128; 3]) };
        Rgb(normal.to_array().map(|n| (127.5 + 127.5 * n).round() as u8))
    })
}

/// A picture as JPEG, of the best quality that keeps it small.
///
/// # Errors
/// When it cannot be encoded.
pub fn jpeg(picture: &RgbImage) -> Result<Vec<u8>> {
    let pixels = f64::from(picture.width()) * f64::from(picture.height());
    let most = ((pixels * BYTES_PER_PIXEL) as usize).max(LEAST_BYTES);
    let mut bytes = Vec::new();
    for quality in QUALITIES {
        bytes.clear();
        JpegEncoder::new_with_quality(&mut bytes, quality)
            .encode_image(picture)
            .map_err(|error| Error::run(format!("cannot encode a JPEG: {error}")))?;
        if bytes.len() <= most {
            break;
        }
    }
    Ok(bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::{Config, Intrinsics, Pixel};

    /// A frame that shows the plane z = `slope`·x, seen from z = 4.
    fn plane(slope: f64) -> (Frame, Camera) {
        let intrinsics = Intrinsics::from_angle(9, 9, 0.6);
        let camera = Camera::look_at(intrinsics, 4.0 * DVec3::Z, DVec3::ZERO, DVec3::Y);
        let mut pixels = Vec::new();
        for y in 0..9 {
            for x in 0..9 {
                let cone = camera.cone::<f64>(x, y);
                let [dx, _, dz] = cone.direction;
                // 4 + t·dz = slope·t·dx, and the depth along the axis is −t·dz.
                let t = 4.0 / (slope * dx - dz);
                let depth = (-t * dz) as f32;
                pixels.push(Pixel { rgb: [0.5; 3], opacity: 1.0, depth });
            }
        }
        (Frame { width: 9, height: 9, pixels }, camera)
    }

    #[test]
    fn normals_are_those_of_the_plane() {
        for slope in [0.0, 0.5, -1.0] {
            let (frame, camera) = plane(slope);
            let expected = DVec3::new(-slope, 0.0, 1.0).normalize().to_array();
            let found = normals(&frame, &camera).get_pixel(4, 4).0;
            for c in 0..3 {
                assert!(
                    (f64::from(found[c]) - (127.5 + 127.5 * expected[c])).abs() < 2.0,
                    "{slope}: {found:?}"
                );
            }
        }
    }

    #[test]
    fn near_is_bright_and_nothing_is_black() {
        let (mut frame, camera) = plane(0.0);
        frame.pixels[0] = Pixel::default();
        let scene = Config::default().scene;
        let shown = picture(&frame, &camera, &scene, Show::Depth, None);
        assert_eq!(shown.get_pixel(0, 0).0, [0; 3]);
        assert!(shown.get_pixel(4, 4).0[0] > 60);
        let opacity = picture(&frame, &camera, &scene, Show::Opacity, None);
        assert_eq!((opacity.get_pixel(0, 0).0, opacity.get_pixel(4, 4).0), ([0; 3], [255; 3]));
        let same = rgb_image(9, 9, &frame.rgb());
        let none = picture(&frame, &camera, &scene, Show::Difference, Some(&same));
        assert!(none.pixels().all(|pixel| pixel.0.iter().all(|value| *value < 5)));
    }

    #[test]
    fn noise_is_encoded_coarser_than_a_plain_picture() {
        let mut state = 1_u32;
        let noise = RgbImage::from_fn(200, 200, |_, _| {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            Rgb([(state >> 24) as u8, (state >> 16) as u8, (state >> 8) as u8])
        });
        let plain = RgbImage::from_pixel(200, 200, Rgb([9, 99, 199]));
        let (noise, plain) = (jpeg(&noise).unwrap(), jpeg(&plain).unwrap());
        assert!(plain.len() < LEAST_BYTES && plain.len() < noise.len());
        let read = image::load_from_memory(&plain).unwrap().to_rgb8();
        assert!(read.get_pixel(77, 5).0.iter().zip([9, 99, 199]).all(|(a, b)| a.abs_diff(b) < 4));
    }
}
