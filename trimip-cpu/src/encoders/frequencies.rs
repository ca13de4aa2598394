//! Positional encodings on the CPU. They have no parameters, so their backward pass is empty.

use super::{Encoding, GradientMemory, Places};
use crate::simd::Simd;
use crate::wire::Reader;
use trimip_core::field::encoders::frequencies;
use trimip_core::{Aabb, Config, Result};

/// The configured positional encoding.
pub(crate) struct Frequencies(frequencies::Encoding<f32>);

impl Encoding for Frequencies {
    type Gradient = ();

    fn new(_: Simd, config: &Config, _: bool) -> Self {
        Self(frequencies::Encoding::new(&config.frequencies, &Aabb::new(&config.scene)))
    }

    fn gradient(&self) {}

    fn forward(&self, at: Places<'_>, _: &mut [f32], features: &mut [f32], stride: usize) {
        let width = self.0.width();
        let samples = at.owners.iter().zip(at.intervals).zip(at.spheres);
        for (((owner, interval), sphere), row) in samples.zip(features.chunks_exact_mut(stride)) {
            let ray = &at.rays[*owner as usize];
            let t = ray.apex_distance(interval.t);
            let moments = self.0.moments(sphere.position, sphere.radius, ray.direction, t, interval.length);
            self.0.write(moments, row);
            row[width..].fill(0.0);
        }
    }

    fn backward(&self, _: Places<'_>, _: &[f32], _: &[f32], _: usize, (): &mut ()) {}

    fn reduce(&mut self, _: &mut [&mut ()], _: &mut [f32]) {}

    fn put(&self, (): &(), _: &mut Vec<u8>) {}

    fn take(&self, _: &mut Reader<'_>, (): &mut ()) -> Result<()> {
        Ok(())
    }

    fn gradient_memory(_: &Config) -> GradientMemory {
        GradientMemory { by_sample: 0, by_partial: 0 }
    }
}
