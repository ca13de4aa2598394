//! Measures every frame of a film, which ffmpeg decodes to small grey pictures.

use super::motion::Follower;
use crate::{
    grey::Grey,
    process::{Call, Output},
};
use std::sync::atomic::AtomicBool;
use trimip::{Error, Result};

/// Number of motion measurements per second. The motion between two measurements is shared equally by the frames between them.
const MOTION_RATE: f64 = 15.0;

/// Measurements of a frame of a film.
#[derive(Clone, Debug, PartialEq)]
pub struct Measured {
    /// Presentation time, seconds from the first frame.
    pub seconds: f64,
    /// Variance of the frame's Laplacian, grey levels squared.
    pub sharpness: f64,
    /// Mean grey level of the frame, 0 to 255.
    pub brightness: f64,
    /// Motion of the picture from the first frame to this one, in units of the picture's longest side.
    pub motion: f64,
}

/// Measures the frames that `call` writes as grey pictures of `size`. The times of the frames are in output lines of
/// the filter `showinfo`; for frames without a time, `rate` is the mean number of frames per second. `progress`
/// receives the number of frames so far.
///
/// # Errors
/// When ffmpeg fails before the first frame.
pub fn frames(
    call: &Call<'_>,
    size: [u32; 2],
    rate: f64,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(u64),
) -> Result<Vec<Measured>> {
    let [width, height] = size.map(|side| side as usize);
    let stride = ((rate / MOTION_RATE).round() as usize).max(1);
    let mut measuring = Measuring {
        frame: Grey { width, height, pixels: Vec::with_capacity(width * height) },
        follower: Follower::default(),
        stride,
        measured: Vec::new(),
        times: Vec::new(),
        progress,
    };
    let ended = call.run_to_end(stop, &mut measuring)?;
    let Measuring { mut measured, times, .. } = measuring;
    // ffmpeg ends with an error on a truncated film, but the frames before the end are usable.
    if measured.is_empty() && !ended.is_success() {
        return Err(call.failed(&ended));
    }
    let first = times.first().copied().flatten().unwrap_or(0.0);
    for (index, frame) in measured.iter_mut().enumerate() {
        let time = times.get(index).copied().flatten().map(|time| time - first);
        frame.seconds = time.unwrap_or(index as f64 / rate.max(1.0));
    }
    divide_motion(&mut measured, stride);
    Ok(measured)
}

/// Spreads the motion between every `stride`-th frame and the next such frame equally over the frames between them.
fn divide_motion(measured: &mut [Measured], stride: usize) {
    for first in (0..measured.len().saturating_sub(stride)).step_by(stride) {
        let (before, after) = (measured[first].motion, measured[first + stride].motion);
        for between in 1..stride {
            let part = between as f64 / stride as f64;
            measured[first + between].motion = before + part * (after - before);
        }
    }
}

struct Measuring<'a> {
    /// The frame that is being read, so far incomplete.
    frame: Grey,
    follower: Follower,
    /// Motion is measured at every `stride`-th frame.
    stride: usize,
    measured: Vec<Measured>,
    /// Times in seconds, in frame order.
    times: Vec<Option<f64>>,
    progress: &'a mut dyn FnMut(u64),
}

impl Output for Measuring<'_> {
    fn line(&mut self, line: &str) -> bool {
        if !line.contains("Parsed_showinfo") {
            return true;
        }
        if let Some((_, rest)) = line.split_once("pts_time:") {
            let word = rest.split_whitespace().next().unwrap_or_default();
            self.times.push(word.parse().ok().filter(|time: &f64| time.is_finite()));
        }
        false
    }

    fn bytes(&mut self, mut bytes: &[u8]) -> Result<()> {
        let whole = self.frame.width * self.frame.height;
        if whole == 0 {
            return Err(Error::run("a film of no pixels"));
        }
        while !bytes.is_empty() {
            let part = (whole - self.frame.pixels.len()).min(bytes.len());
            self.frame.pixels.extend_from_slice(&bytes[..part]);
            bytes = &bytes[part..];
            if self.frame.pixels.len() == whole {
                let motion = match self.measured.last() {
                    Some(last) if !self.measured.len().is_multiple_of(self.stride) => last.motion,
                    _ => self.follower.follow(&self.frame),
                };
                self.measured.push(Measured {
                    seconds: 0.0,
                    sharpness: self.frame.sharpness(),
                    brightness: self.frame.brightness(),
                    motion,
                });
                self.frame.pixels.clear();
                (self.progress)(self.measured.len() as u64);
            }
        }
        Ok(())
    }

    fn takes_bytes(&self) -> bool {
        true
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn motion_is_divided_among_the_frames_between_measurements() {
        let motions = |motions: &[f64], stride| -> Vec<f64> {
            let frame = |&motion: &f64| Measured { seconds: 0.0, sharpness: 0.0, brightness: 0.0, motion };
            let mut measured: Vec<_> = motions.iter().map(frame).collect();
            divide_motion(&mut measured, stride);
            measured.iter().map(|frame| frame.motion).collect()
        };
        assert_eq!(motions(&[0.0, 0.0, 2.0, 2.0, 2.0, 2.0], 2), [0.0, 1.0, 2.0, 2.0, 2.0, 2.0]);
        assert_eq!(motions(&[0.0, 0.0, 0.0, 0.0, 8.0], 4), [0.0, 2.0, 4.0, 6.0, 8.0]);
        assert_eq!(motions(&[0.0, 1.0, 3.0], 1), [0.0, 1.0, 3.0]);
        assert!(motions(&[], 3).is_empty());
    }
}
