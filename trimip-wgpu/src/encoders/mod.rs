//! The encoders on the GPU: each is a file here with an [`Encoding`] and its WGSL in `shaders`, registered in
//! `encoder.rs`.

pub mod frequencies;
pub mod hash_grid;
pub mod rip_map;
pub mod scatter;
pub mod tensor;
pub mod tri_mip;
pub mod voxels;

#[cfg(test)]
use crate::gpu::Kernel;
use crate::gpu::Source::{self, Parts, Text};
use crate::gpu::{Bind, Buffer, Gpu, Rows};
use crate::shaders::RAY;
use crate::workspace::Addition;
use std::sync::Arc;
use trimip_core::Config;

/// Shader source: computes the Gaussians of samples.
const GAUSSIANS: Source = Parts(&[RAY, Text(include_str!("shaders/rip_gaussians.wgsl"))]);

/// Shader source: computes the mip levels and texels of bilinear reads.
pub const TEXELS: Source = Text(include_str!("shaders/texels.wgsl"));

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

    /// Encodes every sample. A row of features has `stride` floats; those beyond the encoder's width become zero. A row
    /// of the context has the length that the encoder's definition states.
    fn forward(&self, parameters: &Buffer<f32>, at: &Places, context: &Buffer<f32>, features: &Buffer<f32>);

    /// Sums the partial gradients and overwrites the encoder's part of `parameter_gradient` with the sums.
    fn reduce(
        &mut self,
        partials: impl Iterator<Item = FeatureGradients>,
        parameters: &Buffer<f32>,
        parameter_gradient: &Buffer<f32>,
    );

    /// Returns the encoder's kernels in every variant, for validation.
    #[cfg(test)]
    fn kernels() -> Vec<Kernel>;
}

/// The geometry of a tile's samples: the workspace's own arrays, which stay unchanged until the step is over.
pub(crate) struct Places {
    /// Rays of the tile.
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

/// Feature gradients of a step, with the samples that they belong to.
pub(crate) struct FeatureGradients {
    pub at: Places,
    pub context: wgpu::Buffer,
    pub gradients: wgpu::Buffer,
}

/// Binds a whole array.
pub(crate) fn whole(buffer: &wgpu::Buffer) -> Bind<'_> {
    Bind::whole(buffer)
}
