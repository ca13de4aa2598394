//! The loss on the GPU: of pixels, and of the samples' weights. Sums stay on the device until the step is over.

use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Parts, Text};
use crate::gpu::{Binds, Buffer, GRID, GROUP, Gpu, Kernel, Size};
use crate::shaders::{COMPOSITING, FIXED, POINT, SUM, SUM_OF_FOUR};
use crate::space::{GpuSpace, SPACE};
use crate::workspace::{Lane, WgpuBackend};
use std::sync::Arc;
use trimip_core::backend::Loss;
use trimip_core::batch::{Radiance, Rays, Samples};
use trimip_core::config::{LossConfig, LossRays};
use trimip_core::edges::LEAST_OPACITY;
use trimip_core::{Config, Pixel, Space};

shared! {
    /// Parameters of the loss of pixels.
    struct Params as Params {
        /// Number of pixels.
        count: u32,
        blocks: u32,
        beta: f32,
        /// 1 to average only over pixels with samples.
        live: u32,
        /// Weight of the opacity relative to the colour.
        opacity: f32,
        /// Number of photographs that have gains.
        photographs: u32,
    }

    /// Parameters of the distortion.
    struct DistortionParams as Params {
        space: GpuSpace,
        /// Number of pixels.
        count: u32,
        blocks: u32,
        /// Weight of the distortion relative to the colour.
        distortion: f32,
    }
}

/// The loss of pixels, without the exposure of photographs.
pub const PHOTOMETRIC: Source = Parts(&[
    GRID,
    SUM_OF_FOUR,
    Source::of::<Params>(),
    Source::real("LEAST_OPACITY", LEAST_OPACITY as f32),
    Text(include_str!("shaders/loss.wgsl")),
]);

/// One exposure for all photographs.
pub const ONE_EXPOSURE: Source = Text(include_str!("shaders/exposure_none.wgsl"));

const EXPOSURES: [Source; 2] = [FIXED, Text(include_str!("shaders/exposure_gain.wgsl"))];

const DISTORTION: [Source; 6] = [
    GRID,
    SPACE,
    COMPOSITING,
    SUM,
    Source::of::<DistortionParams>(),
    Text(include_str!("shaders/distortion.wgsl")),
];

/// The kernel that evaluates the loss of pixels.
fn evaluate() -> Kernel {
    Kernel::new(
        "evaluate",
        &[PHOTOMETRIC],
        &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Write), (7, Read), (8, Read)],
    )
}

kernels! {
    /// The kernels of the loss.
    pub struct Kernels {
        evaluate: evaluate().and(&[ONE_EXPOSURE], &[]),
        evaluate_exposed: evaluate().and(&EXPOSURES, &[(9, Read), (10, Write)]),
        add_up: Kernel::new(
            "add_up",
            &[PHOTOMETRIC, ONE_EXPOSURE],
            &[(2, Parameters), (4, Write), (5, Write), (6, Read)],
        ),
        distort: Kernel::new(
            "distort",
            &DISTORTION,
            &[
                (0, Read),
                (1, Write),
                (2, Parameters),
                (3, Read),
                (4, Read),
                (5, Read),
                (6, Read),
                (7, Read),
                (8, Write),
            ],
        ),
        add_distortion: Kernel::new("add_distortion", &DISTORTION, &[(2, Parameters), (8, Write), (9, Write)]),
    }
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
    /// Gains of photographs with the derivatives by their logarithms, and the number of photographs.
    pub exposures: Option<(wgpu::Buffer, usize)>,
}

/// Words of a photograph's three gains, and of the three sums in fixed point that follow the gains of all.
pub const GAIN_WORDS: usize = 3;
/// As [`GAIN_WORDS`].
pub const SUM_WORDS: usize = 6;

/// The sums of the photographs' derivatives, RGB of each: 64-bit fixed point, low words first.
pub fn sums_of(words: &[u32]) -> Vec<[f64; 3]> {
    let fixed = |[low, high]: [u32; 2]| (i64::from(high.cast_signed()) << 32) | i64::from(low);
    let value = |words: &[u32; 2]| fixed(*words) as f64 / f64::from(POINT);
    let sums: Vec<f64> = words.as_chunks().0.iter().map(value).collect();
    sums.as_chunks().0.to_vec()
}

/// Area-weighted smooth-L1 of pixels, and the distortion of cones.
pub struct WgpuLoss {
    gpu: Arc<Gpu>,
    kernels: Kernels,
    config: LossConfig,
    space: GpuSpace,
    sums: Buffer<u32>,
    /// Gains of the photographs, then the derivatives by their logarithms; empty without gains.
    exposures: Buffer<u32>,
}

impl WgpuLoss {
    /// Creates the configured loss.
    pub fn new(gpu: &Arc<Gpu>, config: &Config) -> Self {
        Self {
            gpu: Arc::clone(gpu),
            kernels: Kernels::new(gpu),
            config: config.loss.clone(),
            // The loss needs no cells.
            space: GpuSpace::new(&Space::new(&config.scene), 1),
            sums: Buffer::zeros(gpu, 8),
            exposures: Buffer::zeros(gpu, 0),
        }
    }
}

impl Loss<WgpuBackend> for WgpuLoss {
    fn expose(&mut self, gains: &[[f32; 3]]) {
        let words = (GAIN_WORDS + SUM_WORDS) * gains.len();
        if self.exposures.most() != words {
            self.exposures = Buffer::zeros(&self.gpu, words);
        }
        self.gpu.write(self.exposures.raw(), gains.as_flattened());
    }

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
        let photographs = self.exposures.most() / (GAIN_WORDS + SUM_WORDS);
        let live = u32::from(self.config.rays == LossRays::Live);
        let params = Params {
            count,
            blocks,
            beta: self.config.beta,
            live,
            opacity: self.config.opacity,
            photographs: photographs as u32,
        };
        let mut binds = Binds::new(pixels.bind()).and([
            pixel_gradients.bind(),
            rays.targets.bind(),
            lane.sums.bind(),
            samples.segments.bind(),
            rays.groups.bind(),
        ]);
        let mut kernel = &self.kernels.evaluate;
        if photographs > 0 {
            let [first, length] = [GAIN_WORDS, SUM_WORDS].map(|words| (4 * words * photographs) as u64);
            self.gpu.clear(self.exposures.raw(), first, length);
            kernel = &self.kernels.evaluate_exposed;
            binds = binds.and([rays.photographs.bind(), self.exposures.bind()]);
        }
        self.gpu.dispatch(kernel, &binds, &params, Size::Items(count.into()));
        let binds = [lane.sums.bind(), self.sums.bind(), samples.counts.bind()];
        self.gpu.dispatch(&self.kernels.add_up, &binds, &params, Size::Groups(1));
        let exposures = (photographs > 0).then(|| (self.exposures.raw().clone(), photographs));
        sums.0 = Some(DeviceSums { buffer: self.sums.raw().clone(), rays: count, exposures });
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
        let params =
            DistortionParams { space: self.space, count, blocks, distortion: self.config.distortion };
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
        self.gpu.dispatch(&self.kernels.distort, &binds, &params, Size::Items(count.into()));
        let binds = [lane.sums.bind(), self.sums.bind()];
        self.gpu.dispatch(&self.kernels.add_distortion, &binds, &params, Size::Groups(1));
    }
}
