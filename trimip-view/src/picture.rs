//! Turns a rendered frame into a picture, and a picture into JPEG.

use crate::protocol::Show;
use glam::DVec3;
use image::codecs::jpeg::JpegEncoder;
use image::{Rgb, RgbImage};
use trimip::view::pictures::{depth, difference, rgb_image};
use trimip::view::{depth_range, flip_colors, flip_of_pictures};
use trimip_core::config::EncoderKind;
use trimip_core::field::encoders::tri_mip::Pyramid;
use trimip_core::scene::cones::Division;
use trimip_core::{Aabb, Camera, Config, Error, Frame, Result, Space};

/// Minimum opacity of a pixel that has a surface.
const SURFACE: f32 = 0.5;

/// Maximum size of a JPEG, bytes per pixel: 60,000 for 400×400 pixels. JPEGs of up to [`LEAST_BYTES`] may exceed it.
const BYTES_PER_PIXEL: f64 = 0.375;

/// JPEGs of at most this many bytes are not compressed further.
const LEAST_BYTES: usize = 8000;

/// JPEG qualities, tried in order until a picture is small enough.
const QUALITIES: [u8; 4] = [90, 80, 65, 50];

/// A rendered view, with the data that its pictures need.
pub struct RenderedView<'a> {
    /// The rendered frame.
    pub frame: &'a Frame,
    /// Camera of the frame.
    pub camera: &'a Camera,
    /// Settings of the model.
    pub config: &'a Config,
    /// Samples per pixel; empty unless the picture shows them.
    pub samples: &'a [u32],
    /// The photograph of this view, resampled to the size of the frame.
    pub photograph: Option<&'a RgbImage>,
}

/// A picture, and the values at the ends of its colour scale.
pub struct Shown {
    /// The picture.
    pub picture: RgbImage,
    /// The values of the darkest and the brightest colour; `None` if the picture has no such scale.
    pub range: Option<[f32; 2]>,
}

impl From<RgbImage> for Shown {
    fn from(picture: RgbImage) -> Self {
        Self { picture, range: None }
    }
}

impl RenderedView<'_> {
    /// Returns the picture of a view. A comparison without a photograph shows the rendered colours, and so does the mip level of an encoder
    /// that has no mip levels.
    pub fn picture(&self, show: Show) -> Shown {
        let Self { frame, camera, .. } = *self;
        let (width, height) = (frame.width, frame.height);
        let own = || rgb_image(width, height, &frame.rgb());
        let grey = |values: Vec<f32>| {
            let rgb: Vec<[f32; 3]> = values.into_iter().map(|value| [value; 3]).collect();
            rgb_image(width, height, &rgb)
        };
        match (show, self.photograph) {
            (Show::Opacity, _) => grey(frame.pixels.iter().map(|pixel| pixel.opacity).collect()).into(),
            (Show::Depth, _) => {
                let range = depth_range(&self.config.scene, camera);
                let span = (range.far - range.near).max(f32::MIN_POSITIVE);
                let near = |depth| 1.0 - (depth - range.near) / span;
                let picture = grey(depth(frame, range.far).into_iter().map(near).collect());
                Shown { picture, range: Some([range.far, range.near]) }
            }
            (Show::Normals, _) => normals(frame, camera).into(),
            (Show::Level, _) => match self.levels() {
                Some((levels, top)) => self.scaled(&levels, top),
                None => own().into(),
            },
            (Show::Samples, _) => {
                let counts: Vec<f32> = self.samples.iter().map(|&count| count as f32).collect();
                let most = counts.iter().copied().fold(1.0, f32::max);
                self.scaled(&counts, most)
            }
            (Show::Difference, Some(photograph)) => {
                let target: Vec<[f32; 3]> =
                    photograph.pixels().map(|pixel| pixel.0.map(|value| f32::from(value) / 255.0)).collect();
                rgb_image(width, height, &difference(&frame.rgb(), &target)).into()
            }
            (Show::Flip, Some(photograph)) => {
                let own = own();
                let errors = flip_of_pictures(&own, photograph);
                errors.and_then(|errors| flip_colors(width, height, &errors)).unwrap_or(own).into()
            }
            _ => own().into(),
        }
    }

    /// Maps values from 0 to `most` to the colour scale; NaN becomes black.
    fn scaled(&self, values: &[f32], most: f32) -> Shown {
        let color =
            |value: &f32| if value.is_nan() { [0.0; 3] } else { scale(value / most.max(f32::MIN_POSITIVE)) };
        let rgb: Vec<[f32; 3]> = values.iter().map(color).collect();
        Shown { picture: rgb_image(self.frame.width, self.frame.height, &rgb), range: Some([0.0, most]) }
    }

    /// Returns the mip level (Eq. 5) of the sphere at the surface of each pixel, NaN where there is no surface; and the coarsest level. If
    /// a pixel is divided into several cones, its level is that of the first cone.
    fn levels(&self) -> Option<(Vec<f32>, f32)> {
        let Self { frame, camera, config, .. } = *self;
        if config.encoder.kind != EncoderKind::TriMip {
            return None;
        }
        let (space, aabb) = (Space::<f64>::new(&config.scene), Aabb::<f64>::new(&config.scene));
        let pyramid = Pyramid::new(&config.encoder, &aabb);
        let (pattern, depths) = (Division::new(config).pattern(camera), depth(frame, f32::NAN));
        let level = |index: usize| {
            if frame.pixels[index].opacity < SURFACE {
                return f32::NAN;
            }
            let (x, y) = (index as u32 % frame.width, index as u32 / frame.width);
            let cone = camera.cone_in::<f64>(x, y, 0, pattern);
            let t = f64::from(depths[index]) / cone.cosine;
            let point = std::array::from_fn(|axis| cone.origin[axis] + t * cone.direction[axis]);
            let radius = cone.radius_at(t) * space.scale(point);
            let of = |plane| {
                let blend = pyramid.blend(plane, radius.log2());
                blend.lower as f64 + blend.fraction
            };
            ((of(0) + of(1) + of(2)) / 3.0) as f32
        };
        let top = (pyramid.levels - 1) as f32;
        Some(((0..frame.pixels.len()).map(level).collect(), top))
    }
}

/// Stops of the colour scale, evenly spaced from 0 to 1: viridis by S. van der Walt and N. Smith, whose lightness increases evenly.
const STOPS: [[f32; 3]; 6] = [
    [0.267, 0.005, 0.329],
    [0.254, 0.265, 0.530],
    [0.164, 0.471, 0.558],
    [0.134, 0.659, 0.518],
    [0.478, 0.821, 0.319],
    [0.993, 0.906, 0.144],
];

/// Returns the colour at `fraction` of the scale.
fn scale(fraction: f32) -> [f32; 3] {
    let at = fraction.clamp(0.0, 1.0) * (STOPS.len() - 1) as f32;
    let lower = (at as usize).min(STOPS.len() - 2);
    let part = at - lower as f32;
    std::array::from_fn(|c| STOPS[lower][c] + part * (STOPS[lower + 1][c] - STOPS[lower][c]))
}

/// Computes surface normals from the surface points that neighbouring pixels see; grey where there is no surface.
fn normals(frame: &Frame, camera: &Camera) -> RgbImage {
    let (k, depths) = (camera.intrinsics, depth(frame, 0.0));
    let point = |x: u32, y: u32| {
        let at = (y * frame.width + x) as usize;
        let cone = k.cone([f64::from(x) + 0.5, f64::from(y) + 0.5], 1.0);
        let distance = f64::from(depths[at]) / cone.cosine;
        let own = DVec3::from(cone.origin) + distance * cone.inverse_length * DVec3::from(cone.axis);
        (frame.pixels[at].opacity >= SURFACE).then_some(own)
    };
    let direction = |x: u32, y: u32| -> Option<DVec3> {
        point(x, y)?;
        let right = point((x + 1).min(frame.width - 1), y)? - point(x.saturating_sub(1), y)?;
        let down = point(x, (y + 1).min(frame.height - 1))? - point(x, y.saturating_sub(1))?;
        let ahead = DVec3::from(k.cone([f64::from(x) + 0.5, f64::from(y) + 0.5], 1.0).axis);
        let normal = (camera.rotation * down.cross(right)).try_normalize()?;
        // Normals point towards the camera.
        Some(if (camera.rotation * ahead).dot(normal) > 0.0 { -normal } else { normal })
    };
    RgbImage::from_fn(frame.width, frame.height, |x, y| {
        let Some(normal) = direction(x, y) else { return Rgb([128; 3]) };
        Rgb(normal.to_array().map(|n| (127.5 + 127.5 * n).round() as u8))
    })
}

/// Encodes a picture as JPEG, with the best quality that keeps it small.
///
/// # Errors
/// When the picture cannot be encoded.
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
    use trimip_core::{Intrinsics, Pixel};

    /// Returns a frame that shows the plane z = `slope`·x, seen from z = 4.
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

    fn rendered<'a>(frame: &'a Frame, camera: &'a Camera, config: &'a Config) -> RenderedView<'a> {
        RenderedView { frame, camera, config, samples: &[], photograph: None }
    }

    #[test]
    fn near_is_bright_and_nothing_is_black() {
        let (mut frame, camera) = plane(0.0);
        frame.pixels[0] = Pixel::default();
        let config = Config::default();
        let rendered = rendered(&frame, &camera, &config);
        let Shown { picture, range } = rendered.picture(Show::Depth);
        assert_eq!(picture.get_pixel(0, 0).0, [0; 3]);
        assert!(
            picture.get_pixel(4, 4).0[0] > 60 && range.is_some_and(|[far, near]| far > 4.0 && near < 4.0)
        );
        let opacity = rendered.picture(Show::Opacity).picture;
        assert_eq!((opacity.get_pixel(0, 0).0, opacity.get_pixel(4, 4).0), ([0; 3], [255; 3]));
        let same = rgb_image(9, 9, &frame.rgb());
        let none = RenderedView { photograph: Some(&same), ..rendered }.picture(Show::Difference).picture;
        assert!(none.pixels().all(|pixel| pixel.0.iter().all(|value| *value < 5)));
    }

    #[test]
    fn levels_follow_the_equation_and_grow_by_one_with_twice_the_distance() {
        let mut config = Config::default();
        config.encoder.plane_size = 512;
        config.encoder.levels = 8;
        config.encoder.mipmap = true;
        let middle = |distance: f64| {
            let camera = Camera::look_at(
                Intrinsics::from_angle(9, 9, 0.6),
                distance * DVec3::Z,
                DVec3::ZERO,
                DVec3::Y,
            );
            let pixel = Pixel { rgb: [0.5; 3], opacity: 1.0, depth: distance as f32 };
            let frame = Frame { width: 9, height: 9, pixels: vec![pixel; 81] };
            let rendered = rendered(&frame, &camera, &config);
            let (levels, top) = rendered.levels().unwrap();
            assert_eq!((top, rendered.picture(Show::Level).range), (7.0, Some([0.0, 7.0])));
            // Radius for the middle pixel: that of the sphere within the cone of a disc with the area of the pixel (Eq. 3).
            let disc = 1.0 / camera.intrinsics.fx / std::f64::consts::PI.sqrt();
            let radius = distance * disc.atan().sin();
            let base = Pyramid::new(&config.encoder, &Aabb::new(&config.scene)).log2_base_radius;
            let expected = radius.log2() - base.iter().sum::<f64>() / 3.0;
            assert!((f64::from(levels[40]) - expected).abs() < 1e-5, "{} {expected}", levels[40]);
            levels[40]
        };
        let (near, far) = (middle(0.5), middle(1.0));
        assert!((far - near - 1.0).abs() < 1e-4, "{near} {far}");
    }

    #[test]
    fn samples_have_a_scale_from_none_to_most() {
        let (frame, camera) = plane(0.0);
        let (config, mut counts) = (Config::default(), [0; 81]);
        counts[80] = 50;
        let Shown { picture, range } =
            RenderedView { samples: &counts, ..rendered(&frame, &camera, &config) }.picture(Show::Samples);
        assert_eq!(range, Some([0.0, 50.0]));
        assert_eq!(picture.get_pixel(0, 0).0, STOPS[0].map(|c| (255.0 * c).round() as u8));
        assert_eq!(picture.get_pixel(8, 8).0, STOPS[5].map(|c| (255.0 * c).round() as u8));
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
