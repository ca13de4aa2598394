//! Animated WebP: every picture without loss and with its opacity, repeated for ever. The `image` crate compresses the pictures;
//! this file puts them into the container (RFC 9649, Section 2.7).

use super::encoder::{Encoder, time_of};
use image::RgbaImage;
use image::codecs::webp::WebPEncoder;
use std::fs::File;
use std::io::{Seek, SeekFrom, Write};

/// Durations in a WebP are thousandths of a second.
const UNIT: f64 = 0.001;

/// Flags of the header: the pictures have opacity, and there is an animation.
const FLAGS: u8 = 0b0001_0010;

/// Bits of a frame: it replaces the one before, instead of being blended with it.
const REPLACES: u8 = 0b0000_0010;

/// Length of the header of a RIFF file: `RIFF`, the length of the rest, `WEBP`.
const RIFF: usize = 12;

struct WebP {
    file: File,
    size: [u32; 2],
    rate: f64,
    count: usize,
    /// Number of bytes written.
    length: u64,
}

/// Opens the encoder.
pub fn open(file: &File, size: [u32; 2], rate: f64) -> Result<Box<dyn Encoder>, String> {
    let file = file.try_clone().map_err(|error| error.to_string())?;
    let mut webp = WebP { file, size, rate, count: 0, length: 0 };
    let [width, height] = size.map(|side| (side - 1).to_le_bytes());
    let canvas = [&[FLAGS, 0, 0, 0], &width[..3], &height[..3]].concat();
    // The background is transparent, and the film is repeated without end.
    let start = [&b"RIFF\0\0\0\0WEBP"[..], &chunk(*b"VP8X", &canvas), &chunk(*b"ANIM", &[0; 6])].concat();
    webp.put(&start)?;
    Ok(Box::new(webp))
}

/// Returns a chunk: its name, the length of its content, the content, and a zero if the length is odd.
fn chunk(name: [u8; 4], content: &[u8]) -> Vec<u8> {
    let length = (content.len() as u32).to_le_bytes();
    let padding = &[0][..content.len() % 2];
    [&name[..], &length, content, padding].concat()
}

impl WebP {
    fn put(&mut self, bytes: &[u8]) -> Result<(), String> {
        self.length += bytes.len() as u64;
        self.file.write_all(bytes).map_err(|error| error.to_string())
    }
}

impl Encoder for WebP {
    fn add(&mut self, picture: RgbaImage) -> Result<(), String> {
        let time = |picture| time_of(picture, self.rate, UNIT);
        let duration = (time(self.count + 1) - time(self.count)).clamp(1, (1 << 24) - 1) as u32;
        self.count += 1;
        let mut single = Vec::new();
        let [width, height] = self.size;
        WebPEncoder::new_lossless(&mut single)
            .encode(&picture, width, height, image::ExtendedColorType::Rgba8)
            .map_err(|error| error.to_string())?;
        // The chunks of a single picture follow the header of its file.
        let pixels = single.get(RIFF..).unwrap_or_default();
        let sides = self.size.map(|side| (side - 1).to_le_bytes());
        let frame =
            [&[0; 6], &sides[0][..3], &sides[1][..3], &duration.to_le_bytes()[..3], &[REPLACES], pixels]
                .concat();
        self.put(&chunk(*b"ANMF", &frame))
    }

    fn end(mut self: Box<Self>) -> Result<(), String> {
        let length =
            u32::try_from(self.length - 8).map_err(|_| "a WebP file has at most 4 GiB".to_string())?;
        let seek =
            self.file.seek(SeekFrom::Start(4)).and_then(|_| self.file.write_all(&length.to_le_bytes()));
        seek.map_err(|error| error.to_string())
    }
}
