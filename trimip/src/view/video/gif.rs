//! Animated GIF: 256 colours per picture, repeated for ever. The `image` crate chooses the colours.

use super::encoder::{Encoder, time_of};
use image::codecs::gif::{GifEncoder, Repeat};
use image::{Delay, Frame, RgbaImage};
use std::fs::File;
use std::io::BufWriter;
use std::time::Duration;

/// Speed of the choice of colours, 1 to 30. At 10 the choice is good and takes a tenth of the time of the best.
const SPEED: i32 = 10;

/// Durations in a GIF are hundredths of a second.
const UNIT: f64 = 0.01;

/// Shortest duration of a picture in hundredths of a second that browsers keep.
const LEAST: u64 = 2;

struct Gif {
    encoder: GifEncoder<BufWriter<File>>,
    rate: f64,
    count: usize,
}

/// Opens the encoder.
pub fn open(file: &File, _: [u32; 2], rate: f64) -> Result<Box<dyn Encoder>, String> {
    let writer = BufWriter::new(file.try_clone().map_err(|error| error.to_string())?);
    let mut encoder = GifEncoder::new_with_speed(writer, SPEED);
    encoder.set_repeat(Repeat::Infinite).map_err(|error| error.to_string())?;
    Ok(Box::new(Gif { encoder, rate, count: 0 }))
}

impl Encoder for Gif {
    fn add(&mut self, picture: RgbaImage) -> Result<(), String> {
        let time = |picture| time_of(picture, self.rate, UNIT);
        let hundredths = (time(self.count + 1) - time(self.count)).max(LEAST);
        self.count += 1;
        let delay = Delay::from_saturating_duration(Duration::from_millis(10 * hundredths));
        let frame = Frame::from_parts(picture, 0, 0, delay);
        self.encoder.encode_frame(frame).map_err(|error| error.to_string())
    }

    fn end(self: Box<Self>) -> Result<(), String> {
        // The encoder writes the end of the file when it is dropped.
        Ok(())
    }
}
