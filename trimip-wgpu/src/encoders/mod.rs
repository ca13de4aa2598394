//! The encoders on the GPU. Each is a file here with an [`Encoding`] and its WGSL in `shaders`, and a line in the
//! list at the end. The dispatch to the configured encoder happens once per span.

pub mod hash_grid;
pub mod tri_mip;

use crate::backend::{Lane, WgpuBackend};
use crate::buffer::Buffer;
use crate::device::{Bind, Gpu};
use crate::kernel::Addition;
#[cfg(test)]
use crate::kernel::Kernel;
use crate::rows::Rows;
use std::sync::Arc;
use trimip_core::batch::{Deposit, Rays, Samples};
use trimip_core::config::EncoderKind;
use trimip_core::{Config, Encoder, encoders};

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
#[allow(dead_code)] // No present encoder uses rays and intervals.
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

impl Places {
    fn new(lane: &mut Lane, rays: &Rays<WgpuBackend>, samples: &Samples<WgpuBackend>) -> Self {
        Self {
            rays: rays.rays.raw().clone(),
            owners: samples.rays.raw().clone(),
            intervals: samples.intervals.raw().clone(),
            spheres: samples.spheres.raw().clone(),
            rows: Rows::of(&samples.spheres, &mut lane.count),
        }
    }
}

/// Feature gradients of a step, with the places they belong to.
#[derive(Default)]
pub struct EncoderGradient(Option<Left>);

/// See [`EncoderGradient`].
#[allow(dead_code)] // No present encoder keeps a tape.
pub(crate) struct Left {
    pub at: Places,
    pub tape: wgpu::Buffer,
    pub gradients: wgpu::Buffer,
}

/// Binds a whole array.
pub(crate) fn whole(buffer: &wgpu::Buffer) -> Bind<'_> {
    Bind { buffer, offset: 0, size: None }
}

/// Generates the enum of all encoders and its dispatch from a list.
macro_rules! encoders {
    ($($name:ident => $encoding:ty),* $(,)?) => {
        /// The configured encoder.
        pub struct WgpuEncoder {
            any: Any,
            /// Floats in a row of features: the encoder's width, padded.
            stride: usize,
            /// Floats in a row of the tape.
            tape: usize,
        }

        /// Kernels of all encoders, for validation.
        #[cfg(test)]
        pub(crate) fn kernels() -> Vec<Kernel> {
            [$(<$encoding as Encoding>::kernels()),*].concat()
        }

        #[allow(clippy::large_enum_variant)] // There is only one instance.
        enum Any { $($name($encoding)),* }

        impl WgpuEncoder {
            /// Creates the encoder of a configuration; `skipped` counts the gradient terms that are left out.
            pub fn new(
                gpu: &Arc<Gpu>,
                config: &Config,
                training: bool,
                addition: Addition,
                skipped: &Buffer<u32>,
            ) -> Self {
                let any = match config.encoder.kind {
                    $(EncoderKind::$name => Any::$name(Encoding::new(gpu, config, training, addition, skipped))),*
                };
                Self { any, stride: encoders::stride(config), tape: encoders::of(config).tape(config) }
            }
        }

        impl Encoder<WgpuBackend> for WgpuEncoder {
            type Gradient = EncoderGradient;

            fn gradient(&self) -> EncoderGradient {
                EncoderGradient::default()
            }

            fn grow(&mut self, stage: u32) {
                match &mut self.any { $(Any::$name(encoding) => encoding.grow(stage)),* }
            }

            fn refresh(&mut self, parameters: &Buffer<f32>) {
                match &mut self.any { $(Any::$name(encoding) => encoding.refresh(parameters)),* }
            }

            fn forward(
                &self,
                lane: &mut Lane,
                parameters: &Buffer<f32>,
                rays: &Rays<WgpuBackend>,
                samples: &Samples<WgpuBackend>,
                tape: &mut Buffer<f32>,
                features: &mut Buffer<f32>,
            ) {
                let at = Places::new(lane, rays, samples);
                at.rows.size(features, self.stride);
                if self.tape > 0 {
                    at.rows.size(tape, self.tape);
                }
                match &self.any {
                    $(Any::$name(encoding) => encoding.forward(parameters, &at, tape, features)),*
                }
            }

            fn keep(
                &self,
                lane: &mut Lane,
                kept: &Buffer<u32>,
                tape: &mut Buffer<f32>,
                features: &mut Buffer<f32>,
            ) {
                if self.tape > 0 {
                    lane.keep(kept, tape, self.tape);
                }
                lane.keep(kept, features, self.stride);
            }

            fn backward(
                &self,
                lane: &mut Lane,
                _: &Buffer<f32>,
                rays: &Rays<WgpuBackend>,
                samples: &Samples<WgpuBackend>,
                tape: &Buffer<f32>,
                feature_gradients: &Buffer<f32>,
                gradient: &mut EncoderGradient,
            ) {
                gradient.0 = Some(Left {
                    at: Places::new(lane, rays, samples),
                    tape: tape.raw().clone(),
                    gradients: feature_gradients.raw().clone(),
                });
            }

            fn flush(
                &mut self,
                deposits: &mut [Deposit<WgpuBackend>],
                parameters: &Buffer<f32>,
                parameter_gradient: &mut Buffer<f32>,
            ) {
                let left = deposits.iter_mut().filter_map(|deposit| deposit.encoder.0.take());
                match &mut self.any {
                    $(Any::$name(encoding) => encoding.flush(left, parameters, parameter_gradient)),*
                }
            }
        }
    };
}

encoders! {
    TriMip => tri_mip::Planes,
    HashGrid => hash_grid::Grid,
}
