//! State of a worker in addition to its workspace: memory for the rays that it walks, and the number of samples of
//! recent pixels.

use crate::CpuBackend;
use crate::buffer::Buffer;
use crate::cursor::Cursor;
use crate::field::Context;
use trimip_core::engine::batch::{Radiance, Samples, Segment};
use trimip_core::engine::proxy::Shaded;
use trimip_core::math::compositing::Passed;

/// Approximate maximum number of samples that a worker renders at once; it bounds the worker's memory.
pub const SAMPLES_AT_ONCE: usize = 1536;

/// Number of samples that a pixel is assumed to have before any pixel is rendered.
const UNKNOWN_RAY: f32 = 256.0;

/// Decay of the largest number of samples per pixel from one group of pixels to the next; neighbouring pixels have
/// similar numbers of samples.
const REMEMBERED: f32 = 0.98;

/// State of a worker in addition to its workspace.
pub struct WorkerScratch {
    pub(crate) scratch: Option<Box<Scratch>>,
    /// Largest number of samples among the recently rendered pixels.
    most_samples: f32,
}

impl Default for WorkerScratch {
    fn default() -> Self {
        Self { scratch: None, most_samples: UNKNOWN_RAY }
    }
}

impl WorkerScratch {
    /// Returns the number of pixels to render at once: usually many, but few in fog, where each ray has hundreds of
    /// samples.
    pub(crate) fn pixels_at_once(&self) -> usize {
        ((SAMPLES_AT_ONCE as f32 / self.most_samples) as usize).max(1)
    }

    /// Records the numbers of samples of the pixels just rendered. A group without any samples is ignored, because it
    /// says nothing about neighbouring pixels.
    pub(crate) fn saw(&mut self, groups: &[Segment], segments: &[Segment]) {
        let samples = |group: &Segment| segments[group.range()].iter().map(|segment| segment.count).sum();
        let longest: u32 = groups.iter().map(samples).max().unwrap_or(0);
        if longest > 0 {
            self.most_samples = (longest as f32).max(REMEMBERED * self.most_samples);
        }
    }
}

/// The state of a ray that is being walked.
pub struct Walker {
    pub ray: u32,
    pub cursor: Cursor,
    /// Optical depths of the samples so far.
    pub passed: Passed<f32>,
    /// True if the ray has left the box.
    pub out: bool,
}

/// Memory for walking rays front to back.
pub struct Scratch {
    pub walkers: Vec<Walker>,
    /// One piece of every ray that is being walked.
    pub piece: Rows,
    /// Rows of the piece that are visible.
    pub seen: Buffer<u32>,
    /// Visible samples, piece by piece.
    pub staged: Rows,
    /// Indices of the rows of `staged`, ordered by ray.
    pub order: Vec<u32>,
    /// For hybrid rendering: true for each ray whose samples the proxy has chosen, false for rays that are too wide.
    pub sure: Vec<bool>,
    pub groups: Groups,
}

/// Samples with the values computed for them.
pub struct Rows {
    pub samples: Samples<CpuBackend>,
    pub encoder_context: Buffer<f32>,
    pub features: Buffer<f32>,
    pub field_context: Context,
    pub radiance: Buffer<Radiance>,
}

/// A worker's memory for groups of samples that share a colour.
#[derive(Default)]
pub struct Groups {
    /// The samples of a ray.
    pub samples: Vec<Shaded>,
    /// For each sample: its weight in its group, negated for all samples of a group except the first.
    pub fractions: Vec<f32>,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rays_through_fog_are_rendered_few_at_once() {
        let mut stream = WorkerScratch::default();
        let rays = |count| [Segment { start: 0, count: 1 }, Segment { start: 1, count }];
        let pixels = [0, 1].map(|start| Segment { start, count: 1 });
        assert_eq!(stream.pixels_at_once(), SAMPLES_AT_ONCE / 256);
        stream.saw(&pixels, &rays(1000));
        assert_eq!(stream.pixels_at_once(), SAMPLES_AT_ONCE / 1000);
        stream.saw(&pixels, &[Segment::default(); 2]);
        assert_eq!(stream.pixels_at_once(), SAMPLES_AT_ONCE / 1000, "empty space says nothing of fog");
        (0..300).for_each(|_| stream.saw(&pixels, &rays(8)));
        assert_eq!(stream.pixels_at_once(), SAMPLES_AT_ONCE / 8);
        stream.saw(&[Segment { start: 0, count: 2 }], &[Segment { start: 0, count: 16 }; 2]);
        assert_eq!(stream.pixels_at_once(), SAMPLES_AT_ONCE / 32, "a pixel has the samples of all its cones");
        stream.saw(&pixels, &rays(1 << 20));
        assert_eq!(stream.pixels_at_once(), 1);
    }
}
