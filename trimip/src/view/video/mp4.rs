//! MP4 with H.264: `openh264` encodes, `muxide` writes the container. Pixels are BT.709 with the limited range and colours at half
//! the resolution, which all players read.

use super::encoder::Encoder;
use image::RgbaImage;
use muxide::api::{Muxer, MuxerBuilder, VideoCodec};
use openh264::OpenH264API;
use openh264::encoder::{
    BitRate, Complexity, Encoder as H264, EncoderConfig, FrameRate, FrameType, IntraFramePeriod, QpRange,
    RateControlMode, UsageType, VuiConfig,
};
use openh264::formats::YUVSource;
use std::fs::File;
use std::io::BufWriter;

/// Largest sides of a picture, the longer one first (`openh264`).
pub const LARGEST: [u32; 2] = [3840, 2160];

/// Smallest side of a picture (`openh264`).
pub const LEAST: u32 = 16;

/// Quantisation of H.264, 0 to 51. At this value no difference is visible in motion.
const QUANTISATION: u8 = 18;

/// Number of pictures from one that stands alone to the next, to which players can jump.
const PERIOD: u32 = 60;

/// Bits per pixel and second that the quantisation never needs: no picture is coarser to save space.
const BITS: f64 = 24.0;

/// Most bits per second that the encoder accepts (level 5.2 of H.264).
const MOST_BITS: f64 = 288e6;

struct Mp4 {
    encoder: H264,
    muxer: Muxer<BufWriter<File>>,
    rate: f64,
    count: usize,
}

/// Opens the encoder.
pub fn open(file: &File, size: [u32; 2], rate: f64) -> Result<Box<dyn Encoder>, String> {
    let writer = BufWriter::new(file.try_clone().map_err(|error| error.to_string())?);
    let [width, height] = size.map(even);
    let encoder = H264::with_api_config(OpenH264API::from_source(), configuration([width, height], rate));
    let encoder = encoder.map_err(|error| error.to_string())?;
    let muxer = MuxerBuilder::new(writer).video(VideoCodec::H264, width, height, rate).build();
    Ok(Box::new(Mp4 { encoder, muxer: muxer.map_err(|error| error.to_string())?, rate, count: 0 }))
}

/// Returns the settings of the encoder.
fn configuration([width, height]: [u32; 2], rate: f64) -> EncoderConfig {
    let bits = (BITS * f64::from(width) * f64::from(height) * rate).min(MOST_BITS) as u32;
    EncoderConfig::new()
        .usage_type(UsageType::CameraVideoRealTime)
        .complexity(Complexity::High)
        // The only mode that keeps to the quantisation and does not demand to skip pictures.
        .rate_control_mode(RateControlMode::Bufferbased)
        .bitrate(BitRate::from_bps(bits))
        .max_frame_rate(FrameRate::from_hz(rate as f32))
        .qp(QpRange::new(QUANTISATION, QUANTISATION))
        .skip_frames(false)
        .adaptive_quantization(false)
        .background_detection(false)
        .intra_frame_period(IntraFramePeriod::from_num_frames(PERIOD))
        // The pictures, and so the file, do not depend on the number of threads.
        .num_threads(1)
        .vui(VuiConfig::bt709())
}

/// Returns the side with one more pixel if it is odd: colours have half the resolution.
fn even(side: u32) -> u32 {
    side.next_multiple_of(2)
}

impl Encoder for Mp4 {
    fn add(&mut self, picture: RgbaImage) -> Result<(), String> {
        let encoded = self.encoder.encode(&Yuv::of(&picture)).map_err(|error| error.to_string())?;
        let stands_alone = matches!(encoded.frame_type(), FrameType::IDR | FrameType::I);
        let time = self.count as f64 / self.rate;
        self.count += 1;
        self.muxer.write_video(time, &encoded.to_vec(), stands_alone).map_err(|error| error.to_string())
    }

    fn end(self: Box<Self>) -> Result<(), String> {
        self.muxer.finish().map_err(|error| error.to_string())
    }
}

/// A picture as luma and colour differences (BT.709, limited range, 4:2:0).
struct Yuv {
    width: usize,
    height: usize,
    planes: [Vec<u8>; 3],
}

impl Yuv {
    /// Converts a picture. An odd last row or column is repeated.
    fn of(picture: &RgbaImage) -> Self {
        let [width, height] = [picture.width(), picture.height()].map(|side| even(side) as usize);
        let at = |x: usize, y: usize| {
            let (x, y) = ((x as u32).min(picture.width() - 1), (y as u32).min(picture.height() - 1));
            let [r, g, b, _] = picture.get_pixel(x, y).0.map(f32::from);
            [r, g, b]
        };
        let luma = |[r, g, b]: [f32; 3]| 0.2126 * r + 0.7152 * g + 0.0722 * b;
        let round = |value: f32| value.round().clamp(0.0, 255.0) as u8;
        let pixels = (0..width * height).map(|i| at(i % width, i / width));
        let y = pixels.map(|rgb| round(16.0 + luma(rgb) * 219.0 / 255.0)).collect();
        let quarter = |i: usize| {
            let (x, y) = (2 * (i % (width / 2)), 2 * (i / (width / 2)));
            let four = [at(x, y), at(x + 1, y), at(x, y + 1), at(x + 1, y + 1)];
            [0, 1, 2].map(|c| four.iter().map(|rgb| rgb[c]).sum::<f32>() / 4.0)
        };
        let difference = |of: fn([f32; 3], f32) -> f32| {
            let all = (0..width * height / 4).map(quarter);
            all.map(|rgb| round(128.0 + of(rgb, luma(rgb)) * 224.0 / 255.0)).collect()
        };
        let u = difference(|[_, _, b], luma| (b - luma) / 1.8556);
        let v = difference(|[r, _, _], luma| (r - luma) / 1.5748);
        Self { width, height, planes: [y, u, v] }
    }
}

impl YUVSource for Yuv {
    fn dimensions(&self) -> (usize, usize) {
        (self.width, self.height)
    }

    fn strides(&self) -> (usize, usize, usize) {
        (self.width, self.width / 2, self.width / 2)
    }

    fn y(&self) -> &[u8] {
        &self.planes[0]
    }

    fn u(&self) -> &[u8] {
        &self.planes[1]
    }

    fn v(&self) -> &[u8] {
        &self.planes[2]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_of_every_size_and_rate_are_encoded() {
        for (size, rate) in
            [([LEAST, LEAST + 1], 1.0), ([800, 800], 30.0), ([801, 799], 1000.0), (LARGEST, 60.0)]
        {
            let file = tempfile::tempfile().unwrap();
            let mut encoder = open(&file, size, rate).unwrap();
            let checks =
                |x: u32, y: u32| image::Rgba([(x * y % 251) as u8, (x % 256) as u8, (y % 256) as u8, 255]);
            for _ in 0..2 {
                encoder.add(RgbaImage::from_fn(size[0], size[1], checks)).unwrap();
            }
            encoder.end().unwrap();
            assert!(file.metadata().unwrap().len() > 500, "{size:?}");
        }
    }

    #[test]
    fn the_range_and_the_colours_are_those_of_bt_709() {
        let one = |rgb: [u8; 3]| {
            let picture = RgbaImage::from_pixel(3, 1, image::Rgba([rgb[0], rgb[1], rgb[2], 255]));
            let Yuv { width, height, planes: [y, u, v] } = Yuv::of(&picture);
            assert_eq!((width, height, y.len(), u.len(), v.len()), (4, 2, 8, 2, 2));
            [y[7], u[1], v[1]]
        };
        // Recommendation ITU-R BT.709, Table 4.
        assert_eq!(one([255; 3]), [235, 128, 128]);
        assert_eq!(one([0; 3]), [16, 128, 128]);
        assert_eq!(one([255, 0, 0]), [63, 102, 240]);
        assert_eq!(one([0, 255, 0]), [173, 42, 26]);
        assert_eq!(one([0, 0, 255]), [32, 240, 118]);
    }

    /// Encodes a moving pattern and decodes it again: the pictures come back in order, close to the original.
    #[test]
    fn pictures_come_back() {
        let (width, height) = (64, 48);
        let picture = |t: u32| {
            RgbaImage::from_fn(width, height, |x, y| {
                let wave =
                    |k: u32, p: u32| (128.0 + 100.0 * (0.1 * f64::from(k * x + p * y + 9 * t)).sin()) as u8;
                image::Rgba([wave(1, 1), wave(2, 1), wave(1, 2), 255])
            })
        };
        let config = configuration([width, height], 30.0);
        let mut encoder = H264::with_api_config(OpenH264API::from_source(), config).unwrap();
        let mut decoder = openh264::decoder::Decoder::new().unwrap();
        for t in 0..10 {
            let sent = Yuv::of(&picture(t));
            let bytes = encoder.encode(&sent).unwrap().to_vec();
            let found = decoder.decode(&bytes).unwrap().expect("a picture each");
            let stride = found.strides().0;
            let mut squares = 0.0;
            for y in 0..height as usize {
                for x in 0..width as usize {
                    let [a, b] = [found.y()[y * stride + x], sent.planes[0][y * width as usize + x]];
                    squares += (f64::from(a) - f64::from(b)).powi(2);
                }
            }
            let psnr = 10.0 * (255.0_f64.powi(2) * f64::from(width * height) / squares).log10();
            assert!(psnr > 40.0, "picture {t}: {psnr} dB");
        }
    }
}
