//! The encoders on the CPU. Each is a file or folder here with an [`Encoding`], and a line in the list at the end; which one is
//! at work is asked once a span.

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

/// What an encoder does on the CPU.
pub(crate) trait Encoding: Sized + Send + Sync {
    /// What spans leave behind.
    type Gradient: Send + Sync;

    /// The configured encoder; `training` adds room for gradients.
    fn new(simd: Simd, config: &Config, training: bool) -> Self;

    /// An empty gradient.
    fn gradient(&self) -> Self::Gradient;

    /// Uses its parameters as far as they have grown at `stage`.
    fn grow(&mut self, _stage: u32) {}

    /// Rebuilds what derives from the parameters; where `all` is false, only what the last gradient touched has changed.
    fn refresh(&mut self, _parameters: &[f32], _all: bool) {}

    /// Encodes every sample. Features are rows of `stride` floats, of which those behind the encoder's width stay zero;
    /// the tape has rows of the definition's length.
    fn forward(
        &self,
        parameters: &[f32],
        at: Places<'_>,
        tape: &mut [f32],
        features: &mut [f32],
        stride: usize,
    );

    /// Deposits the gradient of the features, rows of `stride` floats.
    fn backward(
        &self,
        parameters: &[f32],
        at: Places<'_>,
        tape: &[f32],
        rows: &[f32],
        stride: usize,
        gradient: &mut Self::Gradient,
    );

    /// Adds all deposits in their order: overwrites the encoder's part of `parameter_gradient`, and empties them.
    fn flush(&mut self, gradients: &mut [&mut Self::Gradient], parameter_gradient: &mut [f32]);

    /// Memory of what spans leave behind.
    fn left(config: &Config) -> Left;

    /// Pieces of the first slot outside of which the last gradient is zero; `None`: not known.
    fn touched(&self) -> Option<Vec<Piece<'_>>> {
        None
    }
}

/// Memory of a gradient that gathers until the end of a step, in bytes.
pub(crate) struct Left {
    /// For each sample.
    pub by_sample: usize,
    /// For each deposit, however many samples it has.
    pub by_deposit: usize,
}

/// Where the samples of a span are.
#[derive(Clone, Copy)]
#[allow(dead_code)] // No encoder of today asks for rays and intervals.
pub(crate) struct Places<'a> {
    /// Rays of the span.
    pub rays: &'a [Ray],
    /// Ray of each sample.
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

/// A part of a slot as rows of `row` floats, of each of which some are touched.
pub(crate) struct Piece<'a> {
    /// Floats in all.
    pub length: usize,
    /// Floats of a row.
    pub row: usize,
    /// Floats of each row that are touched.
    pub within: Box<dyn Fn(usize) -> Range<usize> + Sync + 'a>,
}

/// Makes the enumeration of all encoders and their dispatch from a list of them.
macro_rules! encoders {
    ($($name:ident => $encoding:ty),* $(,)?) => {
        /// The configured encoder.
        pub struct CpuEncoder {
            any: Any,
            /// Floats of a row of features: the encoder's width, padded.
            stride: usize,
            /// Floats of a row of the tape.
            tape: usize,
        }

        enum Any { $($name($encoding)),* }

        /// Memory of what spans leave behind.
        pub(crate) fn left(config: &Config) -> Left {
            match config.encoder.kind {
                $(EncoderKind::$name => <$encoding as Encoding>::left(config)),*
            }
        }

        /// What spans leave behind.
        pub struct EncoderGradient(AnyGradient);

        enum AnyGradient { $($name(<$encoding as Encoding>::Gradient)),* }

        impl CpuEncoder {
            /// The encoder of a configuration; `training` adds room for gradients.
            pub fn new(simd: Simd, config: &Config, training: bool) -> Self {
                let any = match config.encoder.kind {
                    $(EncoderKind::$name => Any::$name(Encoding::new(simd, config, training))),*
                };
                Self { any, stride: encoders::stride(config), tape: encoders::of(config).tape(config) }
            }

            /// Floats of a row of features.
            pub(crate) fn stride(&self) -> usize {
                self.stride
            }

            /// Floats of a row of the tape.
            pub(crate) fn tape(&self) -> usize {
                self.tape
            }

            /// See [`Encoding::touched`].
            pub(crate) fn touched(&self) -> Option<Vec<Piece<'_>>> {
                match &self.any { $(Any::$name(encoding) => encoding.touched()),* }
            }

            /// Rebuilds what derives from the parameters that the last gradient touched.
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
