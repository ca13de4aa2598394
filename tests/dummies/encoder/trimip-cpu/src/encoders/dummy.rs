//! The coordinate encoder on the CPU. It has no parameters, so it computes no gradient.

use super::{Encoding, GradientMemory, Places};
use crate::simd::Simd;
use crate::wire::Reader;
use trimip_core::field::encoders::dummy::{Range, WIDTH};
use trimip_core::{Config, Result};

/// The coordinate encoder.
pub(crate) struct Dummy(Range<f32>);

impl Encoding for Dummy {
    type Gradient = ();

    fn new(_: Simd, config: &Config, _: bool) -> Self {
        Self(Range::new(config))
    }

    fn gradient(&self) {}

    fn forward(&self, at: Places<'_>, _: &mut [f32], features: &mut [f32], stride: usize) {
        for (sphere, row) in at.spheres.iter().zip(features.chunks_exact_mut(stride)) {
            row[..WIDTH].copy_from_slice(&self.0.map(sphere.position));
            row[WIDTH..].fill(0.0);
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
