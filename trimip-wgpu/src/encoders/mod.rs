//! The encoders on the GPU: each is a file here with an [`Encoding`] and its WGSL in `shaders`, registered in
//! `encoder.rs`.

pub mod frequencies;
pub mod hash_grid;
pub mod rip_map;
pub mod tensor;
pub mod tri_mip;
pub mod voxels;

use crate::buffer::Buffer;
use crate::device::{Bind, Gpu};
use crate::kernel::Access::{Parameters, Write};
use crate::kernel::{Addition, FIXED, GRID, Kernel, OWN_FIXED};
use crate::rows::Rows;
use std::sync::Arc;
use trimip_core::Config;

/// Gaussians of samples.
const GAUSSIANS: &str = include_str!("shaders/rip_gaussians.wgsl");

/// Levels and texels of bilinear reads.
const TEXELS: &str = include_str!("shaders/texels.wgsl");

/// Converts gradients of texels or entries from fixed point to f32.
static SETTLE_ENTRIES: Kernel = Kernel::new(
    "settle_entries",
    &[GRID, FIXED, OWN_FIXED, include_str!("shaders/settle_entries.wgsl")],
    &[(0, Write), (2, Parameters), (3, Write)],
);

/// The interface of an encoder on the GPU.
pub(crate) trait Encoding: Sized + Send + Sync {
    /// Creates the configured encoder; `skipped` counts the gradient terms that are left out.
    fn new(
        gpu: &Arc<Gpu>,
        config: &Config,
        training: bool,
        addition: Addition,
        skipped: &Buffer<u32>,
    ) -> Self;

    /// Switches to the parameters that are in use at growth stage `stage`.
    fn grow(&mut self, _stage: u32) {}

    /// Rebuilds data derived from the parameters.
    fn refresh(&mut self, _parameters: &Buffer<f32>) {}

    /// Encodes every sample. Features are rows of `stride` floats; those beyond the encoder's width become zero. The
    /// tape has rows of the definition's length.
    fn forward(&self, parameters: &Buffer<f32>, at: &Places, tape: &Buffer<f32>, features: &Buffer<f32>);

    /// Sums the deposits and overwrites the encoder's part of `parameter_gradient`.
    fn flush(
        &mut self,
        deposits: impl Iterator<Item = Left>,
        parameters: &Buffer<f32>,
        parameter_gradient: &Buffer<f32>,
    );

    /// Its kernels in every variant, for validation.
    #[cfg(test)]
    fn kernels() -> Vec<Kernel>;
}

/// The geometry of a span's samples: the workspace's own arrays, which stay unchanged until the step is over.
pub(crate) struct Places {
    /// Rays of the span.
    pub rays: wgpu::Buffer,
    /// Index of each sample's ray.
    pub owners: wgpu::Buffer,
    /// One per sample.
    pub intervals: wgpu::Buffer,
    /// One per sample.
    pub spheres: wgpu::Buffer,
    /// The number of samples.
    pub rows: Rows,
}

/// Feature gradients of a step, with the places they belong to.
pub(crate) struct Left {
    pub at: Places,
    pub tape: wgpu::Buffer,
    pub gradients: wgpu::Buffer,
}

/// Binds a whole array.
pub(crate) fn whole(buffer: &wgpu::Buffer) -> Bind<'_> {
    Bind { buffer, offset: 0, size: None }
}
