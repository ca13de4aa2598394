//! The loss on the GPU: of pixels, and of the samples' weights. Sums stay on the device until the step is over.

use crate::backend::{Lane, WgpuBackend};
use crate::buffer::Buffer;
use crate::device::{GROUP, Gpu, Size};
use crate::kernel::{ADD_DISTORTION, ADD_UP, DISTORT, EVALUATE};
use crate::space::GpuSpace;
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;
use trimip_core::backend::Loss;
use trimip_core::batch::{Radiance, Rays, Samples};
use trimip_core::config::{LossConfig, LossRays};
use trimip_core::{Config, Pixel, Space};

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    count: u32,
    blocks: u32,
    beta: f32,
    live: u32,
    opacity: f32,
    padding: [u32; 3],
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct DistortionParams {
    space: GpuSpace,
    count: u32,
    blocks: u32,
    distortion: f32,
    padding: u32,
}

/// A step's sums on the device: loss, weight, squared error, number of non-finite pixels, then counts of samples.
#[derive(Default)]
pub struct Sums(pub Option<DeviceSums>);

/// The buffer that holds the sums.
pub struct DeviceSums {
    /// Eight words: four floats as bits, and four counts.
    pub buffer: wgpu::Buffer,
    /// Number of pixels of the step.
    pub rays: u32,
}

/// Area-weighted smooth-L1 of pixels, and the distortion of cones.
pub struct WgpuLoss {
    gpu: Arc<Gpu>,
    config: LossConfig,
    space: GpuSpace,
    sums: Buffer<u32>,
}

impl WgpuLoss {
    /// Creates the configured loss.
    pub fn new(gpu: &Arc<Gpu>, config: &Config) -> Self {
        // The loss needs no cells.
        let space = GpuSpace::new(&Space::new(&config.scene), 1);
        Self { gpu: Arc::clone(gpu), config: config.loss.clone(), space, sums: Buffer::zeros(gpu, 8) }
    }
}

impl Loss<WgpuBackend> for WgpuLoss {
    fn evaluate(
        &self,
        lane: &mut Lane,
        rays: &Rays<WgpuBackend>,
        samples: &Samples<WgpuBackend>,
        pixels: &Buffer<Pixel>,
        pixel_gradients: &mut Buffer<[f32; 4]>,
        sums: &mut Sums,
    ) {
        let count = pixels.known_len().unwrap_or(0) as u32;
        let blocks = count.div_ceil(GROUP);
        pixel_gradients.resize(count as usize);
        lane.sums.resize(4 * blocks as usize);
        let live = u32::from(self.config.rays == LossRays::Live);
        let params = Params {
            count,
            blocks,
            beta: self.config.beta,
            live,
            opacity: self.config.opacity,
            padding: [0; 3],
        };
        let binds = [
            pixels.bind(),
            pixel_gradients.bind(),
            rays.targets.bind(),
            lane.sums.bind(),
            samples.segments.bind(),
            rays.groups.bind(),
        ];
        self.gpu.dispatch(&EVALUATE, &binds, &params, Size::Items(count.into()));
        let binds = [lane.sums.bind(), self.sums.bind(), samples.counts.bind()];
        self.gpu.dispatch(&ADD_UP, &binds, &params, Size::Groups(1));
        sums.0 = Some(DeviceSums { buffer: self.sums.raw().clone(), rays: count });
    }

    fn distort(
        &self,
        lane: &mut Lane,
        rays: &Rays<WgpuBackend>,
        samples: &Samples<WgpuBackend>,
        radiance: &Buffer<Radiance>,
        radiance_gradients: &mut Buffer<Radiance>,
        _: &mut Sums,
    ) {
        if self.config.distortion == 0.0 {
            return;
        }
        let count = rays.groups.known_len().unwrap_or(0) as u32;
        let blocks = count.div_ceil(GROUP);
        let params = DistortionParams {
            space: self.space,
            count,
            blocks,
            distortion: self.config.distortion,
            padding: 0,
        };
        // The sums of `evaluate` are added up already.
        lane.sums.resize(4 * blocks as usize);
        let binds = [
            samples.segments.bind(),
            radiance_gradients.bind(),
            radiance.bind(),
            samples.intervals.bind(),
            rays.rays.bind(),
            rays.targets.bind(),
            rays.groups.bind(),
            lane.sums.bind(),
        ];
        self.gpu.dispatch(&DISTORT, &binds, &params, Size::Items(count.into()));
        let binds = [lane.sums.bind(), self.sums.bind()];
        self.gpu.dispatch(&ADD_DISTORTION, &binds, &params, Size::Groups(1));
    }
}
