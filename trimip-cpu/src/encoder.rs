//! The encoder stage on the CPU: the list of all encoders, and the dispatch to the configured one once per span.

use crate::buffer::Buffer;
use crate::encoders::{
    Divided, Encoding, Left, Piece, Places, frequencies, hash_grid, rip_map, tensor, tri_mip, voxels,
};
use crate::gemm::padded;
use crate::simd::Simd;
use crate::wire::Reader;
use crate::{CpuBackend, Lane};
use trimip_core::batch::{Deposit, Samples, Tile};
use trimip_core::config::EncoderKind;
use trimip_core::{Config, Encoder, Result, encoders};

/// The parameters, and the geometry of a span's samples.
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
            /// Floats in a row of features: the encoder's width, padded.
            stride: usize,
            /// Floats in a row of the tape.
            tape: usize,
        }

        enum Any { $($name($encoding)),* }

        /// Memory of the deposited gradients.
        pub(crate) fn left(config: &Config) -> Left {
            match config.encoder.kind {
                $(EncoderKind::$name => <$encoding as Encoding>::left(config)),*
            }
        }

        /// Feature gradients of some spans.
        pub struct EncoderGradient(AnyGradient);

        enum AnyGradient { $($name(<$encoding as Encoding>::Gradient)),* }

        impl CpuEncoder {
            /// Creates the encoder of a configuration; `training` adds room for gradients.
            pub fn new(simd: Simd, config: &Config, training: bool) -> Self {
                let any = match config.encoder.kind {
                    $(EncoderKind::$name => Any::$name(Encoding::new(simd, config, training))),*
                };
                Self { any, stride: encoders::stride(config), tape: encoders::of(config).tape(config) }
            }

            /// Floats in a row of features.
            pub(crate) fn stride(&self) -> usize {
                self.stride
            }

            /// Floats in a row of the tape.
            pub(crate) fn tape(&self) -> usize {
                self.tape
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
                tape: &mut Buffer<f32>,
                features: &mut Buffer<f32>,
            ) {
                let at = places(tile);
                tape.resize(at.spheres.len() * self.tape);
                features.resize(padded(at.spheres.len()) * self.stride);
                match &self.any {
                    $(Any::$name(encoding) => {
                        encoding.forward(at, tape, features, self.stride);
                    })*
                }
            }

            fn keep(
                &self,
                _: &mut Lane,
                kept: &Buffer<u32>,
                tape: &mut Buffer<f32>,
                features: &mut Buffer<f32>,
            ) {
                tape.keep_rows(kept, self.tape);
                features.keep_rows(kept, self.stride);
                features.resize(padded(kept.len()) * self.stride);
            }

            fn backward(
                &self,
                tile: &mut Tile<'_, CpuBackend>,
                tape: &Buffer<f32>,
                feature_gradients: &Buffer<f32>,
                gradient: &mut EncoderGradient,
            ) {
                let at = places(tile);
                let rows = &feature_gradients[..at.spheres.len() * self.stride];
                match (&self.any, &mut gradient.0) {
                    $((Any::$name(encoding), AnyGradient::$name(gradient)) => {
                        encoding.backward(at, tape, rows, self.stride, gradient);
                    })*
                    #[allow(unreachable_patterns)]
                    _ => unreachable!("a gradient is made by its own encoder"),
                }
            }

            fn flush(
                &mut self,
                deposits: &mut [Deposit<CpuBackend>],
                _: &Buffer<f32>,
                parameter_gradient: &mut Buffer<f32>,
            ) {
                match &mut self.any {
                    $(Any::$name(encoding) => {
                        let own = deposits.iter_mut().filter_map(|deposit| match &mut deposit.encoder.0 {
                            AnyGradient::$name(gradient) => Some(gradient),
                            #[allow(unreachable_patterns)]
                            _ => None,
                        });
                        encoding.flush(&mut own.collect::<Vec<_>>(), parameter_gradient);
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
