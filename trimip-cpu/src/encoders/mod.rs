//! The encoders on the CPU. Each is a file or folder here with an [`Encoding`], and a line in the list at the end.
//! The dispatch to the configured encoder happens once per span.

pub mod hash_grid;
pub mod tri_mip;

use crate::buffer::Buffer;
use crate::gemm::padded;
use crate::simd::Simd;
use crate::{CpuBackend, Lane};
use std::ops::Range;
use trimip_core::batch::{Deposit, Interval, Ray, Rays, Samples, Sphere};
use trimip_core::config::EncoderKind;
use trimip_core::{Config, Encoder, encoders};

/// The interface of an encoder on the CPU.
pub(crate) trait Encoding: Sized + Send + Sync {
    /// Feature gradients of some spans.
    type Gradient: Send + Sync;

    /// Creates the configured encoder; `training` adds room for gradients.
    fn new(simd: Simd, config: &Config, training: bool) -> Self;

    /// Creates an empty gradient.
    fn gradient(&self) -> Self::Gradient;

    /// Switches to the parameters that are in use at growth stage `stage`.
    fn grow(&mut self, _stage: u32) {}

    /// Rebuilds data derived from the parameters. If `all` is false, only parameters that the last gradient touched
    /// have changed.
    fn refresh(&mut self, _parameters: &[f32], _all: bool) {}

    /// Encodes every sample. Features are rows of `stride` floats; those beyond the encoder's width stay zero. The
    /// tape has rows of the definition's length.
    fn forward(
        &self,
        parameters: &[f32],
        at: Places<'_>,
        tape: &mut [f32],
        features: &mut [f32],
        stride: usize,
    );

    /// Adds the gradient of the features, in rows of `stride` floats, to the deposit.
    fn backward(
        &self,
        parameters: &[f32],
        at: Places<'_>,
        tape: &[f32],
        rows: &[f32],
        stride: usize,
        gradient: &mut Self::Gradient,
    );

    /// Sums all deposits in order, overwrites the encoder's part of `parameter_gradient` and empties the deposits.
    fn flush(&mut self, gradients: &mut [&mut Self::Gradient], parameter_gradient: &mut [f32]);

    /// Memory of the deposited gradients.
    fn left(config: &Config) -> Left;

    /// Pieces of the first slot outside of which the last gradient is zero; `None` if unknown.
    fn touched(&self) -> Option<Vec<Piece<'_>>> {
        None
    }
}

/// Memory in bytes of a gradient that is collected until the end of a step.
pub(crate) struct Left {
    /// Bytes per sample.
    pub by_sample: usize,
    /// Bytes per deposit, however many samples it has.
    pub by_deposit: usize,
}

/// The geometry of a span's samples.
#[derive(Clone, Copy)]
#[allow(dead_code)] // No present encoder uses rays and intervals.
pub(crate) struct Places<'a> {
    /// Rays of the span.
    pub rays: &'a [Ray],
    /// Index of each sample's ray.
    pub owners: &'a [u32],
    /// One per sample.
    pub intervals: &'a [Interval],
    /// One per sample.
    pub spheres: &'a [Sphere],
}

impl<'a> Places<'a> {
    fn new(rays: &'a Rays<CpuBackend>, samples: &'a Samples<CpuBackend>) -> Self {
        let Samples { rays: owners, intervals, spheres, .. } = samples;
        Self { rays: &rays.rays, owners, intervals, spheres }
    }
}

/// A part of a slot in rows of `row` floats; some floats of each row are touched.
pub(crate) struct Piece<'a> {
    /// Number of floats.
    pub length: usize,
    /// Floats in a row.
    pub row: usize,
    /// The range of touched floats in each row.
    pub within: Box<dyn Fn(usize) -> Range<usize> + Sync + 'a>,
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
                _: &mut Lane,
                parameters: &Buffer<f32>,
                rays: &Rays<CpuBackend>,
                samples: &Samples<CpuBackend>,
                tape: &mut Buffer<f32>,
                features: &mut Buffer<f32>,
            ) {
                let at = Places::new(rays, samples);
                tape.resize(at.spheres.len() * self.tape);
                features.resize(padded(at.spheres.len()) * self.stride);
                match &self.any {
                    $(Any::$name(encoding) => {
                        encoding.forward(parameters, at, tape, features, self.stride);
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
                _: &mut Lane,
                parameters: &Buffer<f32>,
                rays: &Rays<CpuBackend>,
                samples: &Samples<CpuBackend>,
                tape: &Buffer<f32>,
                feature_gradients: &Buffer<f32>,
                gradient: &mut EncoderGradient,
            ) {
                let at = Places::new(rays, samples);
                let rows = &feature_gradients[..at.spheres.len() * self.stride];
                match (&self.any, &mut gradient.0) {
                    $((Any::$name(encoding), AnyGradient::$name(gradient)) => {
                        encoding.backward(parameters, at, tape, rows, self.stride, gradient);
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
}
