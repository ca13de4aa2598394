//! Positional encodings on the GPU. They have no parameters, so their backward pass is empty.

use super::{Encoding, FeatureGradients, GAUSSIANS, Places, whole};
use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Text};
use crate::gpu::{Buffer, GRID, GROUP, Gpu, Kernel, Pipeline};
use crate::workspace::Addition;
use std::sync::Arc;
use trimip_core::field::encoders::frequencies::{self, RADIUS};
use trimip_core::{Aabb, Config, field::encoders};

shared! {
    /// Parameters of positional encodings.
    struct Params as Params {
        /// Size of the box, in world units.
        extent: [f32; 3],
        /// Number of frequencies.
        count: u32,
        /// 1 if sines and cosines are averaged over the sample's Gaussian, 0 if they are taken at its centre.
        integrated: u32,
        /// 1 if the coordinates themselves are features too.
        identity: u32,
        /// Number of floats in a row of features.
        stride: u32,
        counter: u32,
        /// Ratio of mip-NeRF's radius of a cone to the radius of a disc of the pixel's area.
        radius: f32,
    }
}

/// Returns the kernel that computes the features of samples.
fn write() -> Kernel {
    Kernel::new(
        "frequencies",
        &[GRID, GAUSSIANS, Source::of::<Params>(), Text(include_str!("shaders/frequencies.wgsl"))],
        &[(0, Read), (1, Read), (2, Parameters), (3, Read), (4, Write), (5, Read), (6, Read)],
    )
}

/// The configured positional encoding, with its kernel.
pub(crate) struct Frequencies {
    gpu: Arc<Gpu>,
    write: Pipeline,
    encoding: frequencies::Encoding<f32>,
    stride: u32,
}

impl Encoding for Frequencies {
    fn new(gpu: &Arc<Gpu>, config: &Config, _: bool, _: Addition, _: &Buffer<u32>) -> Self {
        Self {
            gpu: Arc::clone(gpu),
            write: gpu.pipeline(write()),
            encoding: frequencies::Encoding::new(&config.frequencies, &Aabb::new(&config.scene)),
            stride: encoders::stride(config) as u32,
        }
    }

    fn forward(&self, _: &Buffer<f32>, at: &Places, _: &Buffer<f32>, features: &Buffer<f32>) {
        let rows = &at.rows;
        let binds = [
            whole(&at.rays),
            whole(&at.owners),
            whole(&at.intervals),
            features.bind(),
            rows.bind(),
            whole(&at.spheres),
        ];
        let params = Params {
            extent: self.encoding.extent,
            count: self.encoding.count as u32,
            integrated: self.encoding.integrated.into(),
            identity: self.encoding.identity.into(),
            stride: self.stride,
            counter: rows.counter,
            radius: RADIUS as f32,
        };
        self.gpu.dispatch(&self.write, &binds, &params, rows.dispatch(1, GROUP));
    }

    fn reduce(&mut self, _: impl Iterator<Item = FeatureGradients>, _: &Buffer<f32>, _: &Buffer<f32>) {}

    #[cfg(test)]
    fn kernels() -> Vec<Kernel> {
        vec![write()]
    }
}
