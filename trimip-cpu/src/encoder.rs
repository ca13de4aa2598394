//! The encoder stage on the CPU: the list of all encoders, and the dispatch to the configured one once per tile.

use crate::buffer::Buffer;
use crate::encoders::{
    Divided, Encoding, GradientMemory, Piece, Places, frequencies, hash_grid, rip_map, tensor, tri_mip,
    voxels,
};
use crate::gemm::padded;
use crate::simd::Simd;
use crate::wire::Reader;
use crate::{CpuBackend, WorkerScratch};
use trimip_core::config::EncoderKind;
use trimip_core::engine::batch::{PartialGradients, Samples, Tile};
use trimip_core::{Config, Encoder, Result, field::encoders};

/// Returns the parameters and the geometry of a tile's samples.
fn places<'a>(tile: &Tile<'a, CpuBackend>) -> Places<'a> {
    let Samples { rays: owners, intervals, spheres, .. } = tile.samples;
    Places { parameters: tile.parameters, rays: &tile.rays.rays, owners, intervals, spheres }
}

/// Generates the enum of all encoders and its dispatch from a list.
macro_rules! encoders {
    ($($name:ident => $encoding:ty),* $(,)?) => {
        /// The configured encoder.
        pub struct CpuEncoder {
            any: Any,
            /// Number of floats in a row of features: the encoder's width, padded.
            stride: usize,
            /// Floats in a row of the context.
            context: usize,
        }

        enum Any { $($name($encoding)),* }

        /// Returns the memory that accumulated gradients need.
        pub(crate) fn gradient_memory(config: &Config) -> GradientMemory {
            match config.encoder.kind {
                $(EncoderKind::$name => <$encoding as Encoding>::gradient_memory(config)),*
            }
        }

        /// Feature gradients collected from several tiles.
        pub struct EncoderGradient(AnyGradient);

        enum AnyGradient { $($name(<$encoding as Encoding>::Gradient)),* }

        impl CpuEncoder {
            /// Creates the encoder of a configuration; `training` adds room for gradients.
            pub fn new(simd: Simd, config: &Config, training: bool) -> Self {
                let any = match config.encoder.kind {
                    $(EncoderKind::$name => Any::$name(Encoding::new(simd, config, training))),*
                };
                Self { any, stride: encoders::stride(config), context: encoders::of(config).context(config) }
            }

            /// Returns the number of floats in a row of features.
            pub(crate) fn stride(&self) -> usize {
                self.stride
            }

            /// Returns the number of floats in a row of the context.
            pub(crate) fn context(&self) -> usize {
                self.context
            }

            /// See [`Encoding::touched`].
            pub(crate) fn touched(&self) -> Option<Vec<Piece<'_>>> {
                match &self.any { $(Any::$name(encoding) => encoding.touched()),* }
            }

            /// See [`Encoding::put`].
            pub(crate) fn put(&self, gradient: &EncoderGradient, out: &mut Vec<u8>) {
                match (&self.any, &gradient.0) {
                    $((Any::$name(encoding), AnyGradient::$name(gradient)) => encoding.put(gradient, out),)*
                    #[allow(unreachable_patterns)]
                    _ => unreachable!("a gradient is made by its own encoder"),
                }
            }

            /// See [`Encoding::take`].
            pub(crate) fn take(&self, from: &mut Reader<'_>, gradient: &mut EncoderGradient) -> Result<()> {
                match (&self.any, &mut gradient.0) {
                    $((Any::$name(encoding), AnyGradient::$name(gradient)) => encoding.take(from, gradient),)*
                    #[allow(unreachable_patterns)]
                    _ => unreachable!("a gradient is made by its own encoder"),
                }
            }

            /// See [`Encoding::divided`].
            pub(crate) fn divided(&mut self) -> Option<&mut dyn Divided> {
                match &mut self.any { $(Any::$name(encoding) => encoding.divided()),* }
            }

            /// Rebuilds the data derived from the parameters that the last gradient touched.
            pub(crate) fn refresh_touched(&mut self, parameters: &Buffer<f32>) {
                match &mut self.any { $(Any::$name(encoding) => encoding.refresh(parameters, false)),* }
            }
        }

        impl Encoder<CpuBackend> for CpuEncoder {
            type Gradient = EncoderGradient;

            fn gradient(&self) -> EncoderGradient {
                EncoderGradient(match &self.any {
                    $(Any::$name(encoding) => AnyGradient::$name(encoding.gradient())),*
                })
            }

            fn grow(&mut self, stage: u32) {
                match &mut self.any { $(Any::$name(encoding) => encoding.grow(stage)),* }
            }

            fn refresh(&mut self, parameters: &Buffer<f32>) {
                match &mut self.any { $(Any::$name(encoding) => encoding.refresh(parameters, true)),* }
            }

            fn forward(
                &self,
                tile: &mut Tile<'_, CpuBackend>,
                context: &mut Buffer<f32>,
                features: &mut Buffer<f32>,
            ) {
                let at = places(tile);
                context.resize(at.spheres.len() * self.context);
                features.resize(padded(at.spheres.len()) * self.stride);
                match &self.any {
                    $(Any::$name(encoding) => {
                        encoding.forward(at, context, features, self.stride);
                    })*
                }
            }

            fn keep(
                &self,
                _: &mut WorkerScratch,
                kept: &Buffer<u32>,
                context: &mut Buffer<f32>,
                features: &mut Buffer<f32>,
            ) {
                context.keep_rows(kept, self.context);
                features.keep_rows(kept, self.stride);
                features.resize(padded(kept.len()) * self.stride);
            }

            fn backward(
                &self,
                tile: &mut Tile<'_, CpuBackend>,
                context: &Buffer<f32>,
                feature_gradients: &Buffer<f32>,
                gradient: &mut EncoderGradient,
            ) {
                let at = places(tile);
                let rows = &feature_gradients[..at.spheres.len() * self.stride];
                match (&self.any, &mut gradient.0) {
                    $((Any::$name(encoding), AnyGradient::$name(gradient)) => {
                        encoding.backward(at, context, rows, self.stride, gradient);
                    })*
                    #[allow(unreachable_patterns)]
                    _ => unreachable!("a gradient is made by its own encoder"),
                }
            }

            fn reduce(
                &mut self,
                partials: &mut [PartialGradients<CpuBackend>],
                _: &Buffer<f32>,
                parameter_gradient: &mut Buffer<f32>,
            ) {
                match &mut self.any {
                    $(Any::$name(encoding) => {
                        let own = partials.iter_mut().filter_map(|partial| match &mut partial.encoder.0 {
                            AnyGradient::$name(gradient) => Some(gradient),
                            #[allow(unreachable_patterns)]
                            _ => None,
                        });
                        encoding.reduce(&mut own.collect::<Vec<_>>(), parameter_gradient);
                    })*
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
