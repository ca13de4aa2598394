//! The coordinate encoder on the GPU. It has no parameters, so it computes no gradient.

use super::{Encoding, FeatureGradients, Places, whole};
use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Text};
use crate::gpu::{Buffer, GRID, GROUP, Gpu, Kernel, Pipeline};
use crate::workspace::Addition;
use std::sync::Arc;
use trimip_core::field::encoders::dummy::{Range, WIDTH};
use trimip_core::{Config, field::encoders};

shared! {
    /// Parameters of the kernel.
    struct Params as Params {
        /// The feature of coordinate 0.
        lower: f32,
        /// The feature of coordinate 1.
        upper: f32,
        /// Number of features.
        width: u32,
        /// Number of floats in a row of features.
        stride: u32,
        counter: u32,
    }
}

/// Returns the kernel that computes the features of samples.
fn write() -> Kernel {
    Kernel::new(
        "dummy",
        &[GRID, Source::of::<Params>(), Text(include_str!("shaders/dummy.wgsl"))],
        &[(0, Read), (1, Write), (2, Parameters), (3, Read)],
    )
}

/// The coordinate encoder.
pub(crate) struct Dummy {
    gpu: Arc<Gpu>,
    write: Pipeline,
    range: Range<f32>,
    stride: u32,
}

impl Encoding for Dummy {
    fn new(gpu: &Arc<Gpu>, config: &Config, _: bool, _: Addition, _: &Buffer<u32>) -> Self {
        Self {
            gpu: Arc::clone(gpu),
            write: gpu.pipeline(write()),
            range: Range::new(config),
            stride: encoders::stride(config) as u32,
        }
    }

    fn forward(&self, _: &Buffer<f32>, at: &Places, _: &Buffer<f32>, features: &Buffer<f32>) {
        let (rows, Range { lower, upper }) = (&at.rows, self.range);
        let binds = [whole(&at.spheres), features.bind(), rows.bind()];
        let params = Params { lower, upper, width: WIDTH as u32, stride: self.stride, counter: rows.counter };
        self.gpu.dispatch(&self.write, &binds, &params, rows.dispatch(1, GROUP));
    }

    fn reduce(&mut self, _: impl Iterator<Item = FeatureGradients>, _: &Buffer<f32>, _: &Buffer<f32>) {}

    #[cfg(test)]
    fn kernels() -> Vec<Kernel> {
        vec![write()]
    }
}
