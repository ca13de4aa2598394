//! Positional encodings on the GPU. They have no parameters, so nothing flows back.

use super::{Encoding, GAUSSIANS, Left, Places, whole};
use crate::buffer::Buffer;
use crate::device::{GROUP, Gpu};
use crate::kernel::Access::{Parameters, Read, Write};
use crate::kernel::{Addition, GRID, Kernel, RAY};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;
use trimip_core::encoders::frequencies::{self, RADIUS};
use trimip_core::{Aabb, Config, encoders};

/// Computes the features of samples.
static WRITE: Kernel = Kernel::new(
    "frequencies",
    &[GRID, RAY, GAUSSIANS, include_str!("shaders/frequencies.wgsl")],
    &[(0, Read), (1, Read), (2, Parameters), (3, Read), (4, Write), (5, Read), (6, Read)],
);

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    extent: [f32; 3],
    count: u32,
    integrated: u32,
    identity: u32,
    stride: u32,
    counter: u32,
    radius: f32,
    /// A uniform structure ends at a multiple of 16 bytes.
    padding: [u32; 3],
}

/// The encoding.
pub(crate) struct Frequencies {
    gpu: Arc<Gpu>,
    encoding: frequencies::Encoding<f32>,
    stride: u32,
}

impl Encoding for Frequencies {
    fn new(gpu: &Arc<Gpu>, config: &Config, _: bool, _: Addition, _: &Buffer<u32>) -> Self {
        Self {
            gpu: Arc::clone(gpu),
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
            padding: [0; 3],
        };
        self.gpu.dispatch(&WRITE, &binds, &params, rows.dispatch(1, GROUP));
    }

    fn flush(&mut self, _: impl Iterator<Item = Left>, _: &Buffer<f32>, _: &Buffer<f32>) {}

    #[cfg(test)]
    fn kernels() -> Vec<Kernel> {
        vec![WRITE.clone()]
    }
}
