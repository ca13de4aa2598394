//! Gradients with respect to camera poses on the GPU. Rays are displaced to both sides; the slope of the loss is the
//! difference between the features of the two sides, times the gradients with respect to the features. The derivatives
//! of each photograph are summed in 64-bit fixed point, so their sums are bit-identical in any order.

use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Text};
use crate::gpu::{Buffer, GRID, GROUP, Gpu, Kernel, Rows, Size};
use crate::loss::Sums;
use crate::shaders::{BASIS, FIXED, RANDOM, words};
use crate::space::{GpuSpace, SPACE};
use crate::workspace::WgpuBackend;
use std::sync::Arc;
use trimip_core::engine::backend::PoseGradients;
use trimip_core::engine::batch::{CameraSums, Displaced, Rays, Tile};
use trimip_core::engine::policy::PosePolicy;
use trimip_core::{Config, ViewSet, field::encoders};

/// Number of words of a photograph's twelve sums in fixed point.
pub const SUM_WORDS: usize = words(size_of::<CameraSums>()) as usize;

shared! {
    /// Parameters of all kernels.
    struct Params as Params {
        space: GpuSpace,
        draws: [u32; 4],
        /// Side to which rays are displaced: 1 or −1.
        side: f32,
        /// Number of rays, or of pixels.
        count: u32,
        /// Index of the tile's first ray within the step.
        first: u32,
        /// Number of floats in a row of features, with and without padding.
        stride: u32,
        width: u32,
        counter: u32,
    }
}

/// Returns the kernel of `poses.wgsl` with the entry point `entry`.
fn kernel(entry: &'static str, bindings: &[(u32, crate::gpu::Access)]) -> Kernel {
    let sources = [
        GRID,
        SPACE,
        BASIS,
        RANDOM,
        FIXED,
        Source::of::<Params>(),
        Source::whole("SUM_WORDS", SUM_WORDS as u32),
        Text(include_str!("shaders/poses.wgsl")),
    ];
    Kernel::new(entry, &sources, bindings)
}

kernels! {
    /// The kernels of pose gradients.
    pub struct Kernels {
        displace_rays: kernel("displace_rays", &[(0, Read), (1, Write), (2, Parameters)]),
        displace_spheres: kernel(
            "displace_spheres",
            &[(1, Write), (2, Parameters), (3, Read), (4, Read), (5, Read), (6, Write), (7, Read)],
        ),
        compare: kernel("compare", &[(2, Parameters), (7, Read), (8, Read), (9, Read), (10, Write)]),
        add: kernel(
            "add_poses",
            &[(0, Read), (2, Parameters), (4, Read), (10, Write), (11, Read), (12, Read), (13, Read), (14, Write)],
        ),
    }
}

/// The stage that computes pose gradients.
pub struct WgpuPoses {
    gpu: Arc<Gpu>,
    kernels: Kernels,
    policy: PosePolicy,
    /// Parameters that are the same for all tiles.
    params: Params,
    sums: Buffer<u32>,
}

impl WgpuPoses {
    /// Creates the stage for the training views. Returns `None` unless the configuration refines poses.
    pub fn new(gpu: &Arc<Gpu>, config: &Config, views: Option<&ViewSet>) -> Option<Self> {
        let policy = PosePolicy::new(config, views)?;
        let params = Params {
            // The kernels use no occupancy cells, so any resolution serves.
            space: GpuSpace::new(&policy.space, 1),
            stride: encoders::stride(config) as u32,
            width: policy.width as u32,
            ..Params::default()
        };
        let sums = Buffer::zeros(gpu, SUM_WORDS * policy.photographs);
        Some(Self { gpu: Arc::clone(gpu), kernels: Kernels::new(gpu), policy, params, sums })
    }

    /// Returns the parameters for the rays of a tile at a step.
    fn params(&self, step: u64, rays: &Rays<WgpuBackend>) -> Params {
        Params { draws: self.policy.draws(step).words(), first: rays.first, ..self.params }
    }
}

impl PoseGradients<WgpuBackend> for WgpuPoses {
    fn displace(
        &self,
        tile: &mut Tile<'_, WgpuBackend>,
        step: u64,
        side: f32,
        displaced: &mut Displaced<WgpuBackend>,
    ) {
        let Tile { stream, rays, samples, .. } = tile;
        let count = rays.rays.known_len().unwrap_or(0);
        let rows = Rows::of(&samples.spheres, &mut stream.count);
        displaced.rays.resize(count);
        rows.size(&mut displaced.spheres, 1);
        let params = Params { side, count: count as u32, counter: rows.counter, ..self.params(step, rays) };
        let binds = [rays.rays.bind(), displaced.rays.bind()];
        self.gpu.dispatch(&self.kernels.displace_rays, &binds, &params, Size::Items(count as u64));
        let binds = [
            displaced.rays.bind(),
            samples.rays.bind(),
            samples.intervals.bind(),
            samples.spheres.bind(),
            displaced.spheres.bind(),
            rows.bind(),
        ];
        self.gpu.dispatch(&self.kernels.displace_spheres, &binds, &params, rows.dispatch(1, GROUP));
    }

    fn compare(
        &self,
        tile: &mut Tile<'_, WgpuBackend>,
        side: f32,
        feature_gradients: &Buffer<f32>,
        displaced: &mut Displaced<WgpuBackend>,
    ) {
        let Tile { stream, samples, .. } = tile;
        let rows = Rows::of(&samples.spheres, &mut stream.count);
        rows.size(&mut displaced.slopes, 1);
        let params = Params { side, counter: rows.counter, ..self.params };
        let binds =
            [rows.bind(), displaced.features.bind(), feature_gradients.bind(), displaced.slopes.bind()];
        self.gpu.dispatch(&self.kernels.compare, &binds, &params, rows.dispatch(1, GROUP));
    }

    fn add(&self, tile: &mut Tile<'_, WgpuBackend>, step: u64, slopes: &Buffer<f32>, sums: &mut Sums) {
        let Tile { rays, samples, .. } = tile;
        let count = rays.groups.known_len().unwrap_or(0) as u32;
        let bytes = (self.sums.capacity() * size_of::<u32>()) as u64;
        self.gpu.clear(self.sums.raw(), 0, bytes);
        let params = Params { count, ..self.params(step, rays) };
        let binds = [
            rays.rays.bind(),
            samples.intervals.bind(),
            slopes.bind(),
            samples.segments.bind(),
            rays.groups.bind(),
            rays.photographs.bind(),
            self.sums.bind(),
        ];
        self.gpu.dispatch(&self.kernels.add, &binds, &params, Size::Items(count.into()));
        if let Some(sums) = &mut sums.0 {
            sums.cameras = Some((self.sums.raw().clone(), self.policy.photographs));
        }
    }
}
