//! The encoder stage on the GPU: the list of all encoders, and the dispatch to the configured one once per tile.

use crate::encoders::{
    Encoding, FeatureGradients, Places, frequencies, hash_grid, rip_map, tensor, tri_mip, voxels,
};
#[cfg(test)]
use crate::gpu::Kernel;
use crate::gpu::{Buffer, Gpu, Rows};
use crate::workspace::{Addition, Stream, WgpuBackend};
use std::sync::Arc;
use trimip_core::config::EncoderKind;
use trimip_core::engine::batch::{PartialGradients, Tile};
use trimip_core::{Config, Encoder, field::encoders};

/// Returns the geometry of a tile's samples.
fn places(tile: &mut Tile<'_, WgpuBackend>) -> Places {
    let Tile { stream, rays, samples, .. } = tile;
    Places {
        rays: rays.rays.raw().clone(),
        owners: samples.rays.raw().clone(),
        intervals: samples.intervals.raw().clone(),
        spheres: samples.spheres.raw().clone(),
        rows: Rows::of(&samples.spheres, &mut stream.count),
    }
}

/// Feature gradients of a step, with the samples that they belong to.
#[derive(Default)]
pub struct EncoderGradient(Option<FeatureGradients>);

/// Generates the enum of all encoders and its dispatch from a list.
macro_rules! encoders {
    ($($name:ident => $encoding:ty),* $(,)?) => {
        /// The configured encoder.
        pub struct WgpuEncoder {
            any: Any,
            /// Number of floats in a row of features: the encoder's width, padded.
            stride: usize,
            /// Number of floats in a row of the context.
            context: usize,
        }

        /// Returns the kernels of all encoders, for validation.
        #[cfg(test)]
        pub(crate) fn kernels() -> Vec<Kernel> {
            [$(<$encoding as Encoding>::kernels()),*].concat()
        }

        #[allow(clippy::large_enum_variant)] // There is only one instance.
        enum Any { $($name($encoding)),* }

        impl WgpuEncoder {
            /// Creates the encoder of a configuration; `skipped`, one number, counts the gradient terms that are left
            /// out.
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
                Self { any, stride: encoders::stride(config), context: encoders::of(config).context(config) }
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
                tile: &mut Tile<'_, WgpuBackend>,
                context: &mut Buffer<f32>,
                features: &mut Buffer<f32>,
            ) {
                let (at, parameters) = (places(tile), tile.parameters);
                at.rows.size(features, self.stride);
                if self.context > 0 {
                    at.rows.size(context, self.context);
                }
                match &self.any {
                    $(Any::$name(encoding) => encoding.forward(parameters, &at, context, features)),*
                }
            }

            fn keep(
                &self,
                stream: &mut Stream,
                kept: &Buffer<u32>,
                context: &mut Buffer<f32>,
                features: &mut Buffer<f32>,
            ) {
                if self.context > 0 {
                    stream.keep(kept, context, self.context);
                }
                stream.keep(kept, features, self.stride);
            }

            fn backward(
                &self,
                tile: &mut Tile<'_, WgpuBackend>,
                context: &Buffer<f32>,
                feature_gradients: &Buffer<f32>,
                gradient: &mut EncoderGradient,
            ) {
                gradient.0 = Some(FeatureGradients {
                    at: places(tile),
                    context: context.raw().clone(),
                    gradients: feature_gradients.raw().clone(),
                });
            }

            fn reduce(
                &mut self,
                partials: &mut [PartialGradients<WgpuBackend>],
                parameters: &Buffer<f32>,
                parameter_gradient: &mut Buffer<f32>,
            ) {
                let left = partials.iter_mut().filter_map(|partial| partial.encoder.0.take());
                match &mut self.any {
                    $(Any::$name(encoding) => encoding.reduce(left, parameters, parameter_gradient)),*
                }
            }
        }
    };
}

encoders! {
    TriMip => tri_mip::Planes,
    HashGrid => hash_grid::Grid,
    RipMap => rip_map::RipMaps,
    Tensor => tensor::Factors,
    Frequencies => frequencies::Frequencies,
    Voxels => voxels::Grid,
}
