//! The loss on the GPU: one kernel evaluates all pixel terms, and each ray term has its own kernel. Sums stay on the device
//! until the step is over.

use crate::gpu::{Binds, Buffer, GROUP, Gpu, Size};
use crate::losses::{GAIN_WORDS, Kernels, Params, PixelTerms, RayParams, SUM_WORDS};
use crate::shaders::POINT;
use crate::space::GpuSpace;
use crate::workspace::{Stream, WgpuBackend};
use std::sync::Arc;
use trimip_core::config::{LossConfig, LossRays};
use trimip_core::engine::backend::{Loss, RenderedTile};
use trimip_core::engine::batch::Radiance;
use trimip_core::field::losses::{self, Definition, PIXEL_TERMS, RAY_TERMS};
use trimip_core::{Config, Error, Result, Space};

/// Number of words of [`DeviceSums::buffer`].
pub const SUMS: usize = 9;

/// Byte offset of the number of drawn samples in [`DeviceSums::buffer`].
pub const DRAWN_AT: u64 = 4 * (SUMS as u64 - 1);

/// A step's sums on the device: loss, weight, squared error, number of non-finite pixels, then counts of samples.
#[derive(Default)]
pub struct Sums(pub Option<DeviceSums>);

/// The buffer that holds the sums.
pub struct DeviceSums {
    /// Words: four floats as bits, four counts, and the number of drawn samples.
    pub buffer: wgpu::Buffer,
    /// Number of pixels of the step.
    pub rays: u32,
    /// The exposure gain of each photograph and the derivative of the loss with respect to the gain's logarithm; then
    /// the number of photographs.
    pub exposures: Option<(wgpu::Buffer, usize)>,
    /// Derivatives of the loss with respect to the motion of each photograph's camera; then the number of photographs.
    pub cameras: Option<(wgpu::Buffer, usize)>,
}

/// Converts sums of derivatives, `N` per photograph, from 64-bit fixed point. The low word of a sum comes first.
pub fn sums_of<const N: usize>(words: &[u32]) -> Vec<[f64; N]> {
    let fixed = |[low, high]: [u32; 2]| (i64::from(high.cast_signed()) << 32) | i64::from(low);
    let value = |words: &[u32; 2]| fixed(*words) as f64 / f64::from(POINT);
    let sums: Vec<f64> = words.as_chunks().0.iter().map(value).collect();
    sums.as_chunks().0.to_vec()
}

/// The loss terms that a configuration uses.
pub struct WgpuLoss {
    gpu: Arc<Gpu>,
    kernels: Kernels,
    config: LossConfig,
    /// Progress of the run, from 0 to 1.
    progress: f64,
    space: GpuSpace,
    sums: Buffer<u32>,
    /// Exposure gains of the photographs, then the derivatives of the loss with respect to the gains' logarithms; empty
    /// if there are no gains.
    exposures: Buffer<u32>,
}

impl WgpuLoss {
    /// Creates the configured loss.
    ///
    /// # Errors
    /// When a term of another crate is enabled in a part of the run: such a term has no WGSL.
    pub fn new(gpu: &Arc<Gpu>, config: &Config) -> Result<Self> {
        let others = losses::others(config)?;
        let weight =
            |term: &losses::Term, at: u8| term.definition().weight_at(&config.loss, f64::from(at) / 100.0);
        let enabled = |term: &&losses::Term| (0..=100).any(|at| weight(term, at) > 0.0);
        if let Some(term) = others.iter().find(enabled) {
            let name = term.definition().name();
            let found = format!("the loss term `{name}` of another crate has no WGSL");
            return Err(Error::input("backend = \"wgpu\"", found, "use backend = \"cpu\""));
        }
        Ok(Self {
            gpu: Arc::clone(gpu),
            kernels: Kernels::new(gpu, config.loss.photometric),
            config: config.loss.clone(),
            progress: 0.0,
            // The loss uses no occupancy cells, so any resolution serves.
            space: GpuSpace::new(&Space::new(&config.scene), 1),
            sums: Buffer::zeros(gpu, SUMS),
            exposures: Buffer::zeros(gpu, 0),
        })
    }

    /// Returns the weight of a term, then its numbers, as the shaders read them.
    fn numbers<T: Definition + ?Sized>(&self, term: &T) -> [f32; 4] {
        let [a, b, c] = term.numbers(&self.config);
        [term.weight_at(&self.config, self.progress), a, b, c]
    }
}

impl Loss<WgpuBackend> for WgpuLoss {
    fn set_gains(&mut self, gains: &[[f32; 3]]) {
        let words = (GAIN_WORDS + SUM_WORDS) * gains.len();
        if self.exposures.most() != words {
            self.exposures = Buffer::zeros(&self.gpu, words);
        }
        self.gpu.write(self.exposures.raw(), gains.as_flattened());
    }

    fn set_progress(&mut self, progress: f64) {
        self.progress = progress;
    }

    fn evaluate_pixels(
        &self,
        stream: &mut Stream,
        tile: &RenderedTile<'_, WgpuBackend>,
        pixel_gradients: &mut Buffer<[f32; 4]>,
        sums: &mut Sums,
    ) {
        let RenderedTile { rays, samples, pixels, .. } = tile;
        let count = pixels.known_len().unwrap_or(0) as u32;
        let blocks = count.div_ceil(GROUP);
        pixel_gradients.resize(count as usize);
        stream.sums.resize(4 * blocks as usize);
        let photographs = self.exposures.most() / (GAIN_WORDS + SUM_WORDS);
        let params = Params {
            count,
            blocks,
            live: u32::from(self.config.rays == LossRays::Live),
            photographs: photographs as u32,
            photometric: self.numbers(self.config.photometric.term()),
            terms: PixelTerms::of(std::array::from_fn(|i| self.numbers(PIXEL_TERMS[i]))),
        };
        let mut binds = Binds::new(pixels.bind()).and([
            pixel_gradients.bind(),
            rays.targets.bind(),
            stream.sums.bind(),
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
        let binds = [stream.sums.bind(), self.sums.bind(), samples.counts.bind()];
        self.gpu.dispatch(&self.kernels.add_up, &binds, &params, Size::Groups(1));
        let exposures = (photographs > 0).then(|| (self.exposures.raw().clone(), photographs));
        sums.0 = Some(DeviceSums { buffer: self.sums.raw().clone(), rays: count, exposures, cameras: None });
    }

    fn evaluate_rays(
        &self,
        stream: &mut Stream,
        tile: &RenderedTile<'_, WgpuBackend>,
        radiance_gradients: &mut Buffer<Radiance>,
        _: &mut Sums,
    ) {
        let RenderedTile { rays, samples, radiance, .. } = tile;
        let count = rays.groups.known_len().unwrap_or(0) as u32;
        let blocks = count.div_ceil(GROUP);
        for (term, kernels) in RAY_TERMS.iter().zip(&self.kernels.rays) {
            let term = self.numbers(*term);
            if term[0] == 0.0 {
                continue;
            }
            let params = RayParams { space: self.space, term, count, blocks };
            // The array can be reused, because the sums of the pixels are already added up.
            stream.sums.resize(4 * blocks as usize);
            let binds = Binds::new(samples.segments.bind())
                .and([radiance_gradients.bind(), radiance.bind(), samples.intervals.bind()])
                .and(kernels.reads_rays.then(|| rays.rays.bind()))
                .and([rays.targets.bind(), rays.groups.bind(), stream.sums.bind()]);
            self.gpu.dispatch(&kernels.cones, &binds, &params, Size::Items(count.into()));
            let binds = [stream.sums.bind(), self.sums.bind()];
            self.gpu.dispatch(&kernels.sums, &binds, &params, Size::Groups(1));
        }
    }
}
