//! State of a worker in addition to its workspace: memory for the rays that it walks, and the recent lengths of rays.

use crate::CpuBackend;
use crate::buffer::Buffer;
use crate::cursor::Cursor;
use crate::field::Context;
use trimip_core::engine::batch::{Radiance, Samples, Segment};
use trimip_core::engine::proxy::Shaded;
use trimip_core::math::compositing::Passed;

/// Approximate maximum of samples in the rays that a worker renders at once; it bounds the worker's memory.
pub const SAMPLES_AT_ONCE: usize = 1536;

/// Assumed number of samples of a pixel before any is rendered.
const UNKNOWN_RAY: f32 = 256.0;

/// Decay of the longest ray's length from one group of rays to the next; neighbouring rays have similar lengths.
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
    /// Number of pixels to render at once: many in general, few through fog, where each ray has hundreds of samples.
    pub(crate) fn pixels_at_once(&self) -> usize {
        ((SAMPLES_AT_ONCE as f32 / self.most_samples) as usize).max(1)
    }

    /// Records the samples of the pixels just rendered. Pixels without samples are ignored, because they say nothing
    /// about their neighbours.
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
    /// Optical depths so far.
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
    /// Rows of `staged` in ray order.
    pub order: Vec<u32>,
    /// For hybrid rendering: whether the proxy is sure of each ray.
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

/// A worker's memory for groups.
#[derive(Default)]
pub struct Groups {
    /// The samples of a ray.
    pub samples: Vec<Shaded>,
    /// One per sample: its weight in its group, negative for all samples of a group but the first.
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
