//! Density and colour networks on the CPU. The density network's 16 outputs are 1 logit and 15 geometry features; the
//! colour network reads 16 spherical harmonics, then those 16 outputs with a zero weight on the logit.

use crate::buffer::Buffer;
use crate::gemm::padded;
use crate::mlp::{Activations, Mlp, MlpGradient};
use crate::simd::Simd;
use crate::{CpuBackend, Lane};
use trimip_core::activation::{density, density_derivative, sigmoid, sigmoid_derivative};
use trimip_core::batch::{Deposit, Radiance, Rays, Samples};
use trimip_core::params::{GEOMETRY, Kind, Slot, color_layers, density_layers};
use trimip_core::sh::{self, spherical_harmonics};
use trimip_core::tri_mip::FEATURES;
use trimip_core::{Config, Field, Layout};

/// Outputs of the density network.
const OUTPUTS: usize = 1 + GEOMETRY;

/// Both networks.
pub struct CpuField {
    simd: Simd,
    density: Mlp,
    color: Mlp,
    slots: Vec<Slot>,
    density_layers: usize,
}

/// Activations of a span.
pub struct Tape {
    density: Activations,
    color_input: Buffer<f32>,
    color: Activations,
    /// Spherical harmonics of each ray, evaluated once.
    directions: Vec<[f32; sh::COUNT]>,
    /// Gradients of the colour logits, of the colour network's input and of the density network's output.
    color_gradient: Buffer<f32>,
    input_gradient: Buffer<f32>,
    output_gradient: Buffer<f32>,
}

/// Weight gradients.
pub struct FieldGradient {
    density: MlpGradient,
    color: MlpGradient,
}

impl CpuField {
    /// The networks of a configuration.
    pub fn new(simd: Simd, config: &Config, layout: &Layout) -> Self {
        let density_shapes = density_layers(config);
        let color_rows = (0..sh::COUNT)
            .map(Some)
            .chain([None]) // the density logit is no input of the colour network
            .chain((sh::COUNT..sh::COUNT + GEOMETRY).map(Some))
            .collect();
        Self {
            simd,
            density: Mlp::new(&density_shapes, (0..FEATURES).map(Some).collect()),
            color: Mlp::new(&color_layers(config), color_rows),
            slots: layout.slots.iter().filter(|slot| slot.kind == Kind::Network).cloned().collect(),
            density_layers: density_shapes.len(),
        }
    }
}

impl CpuField {
    /// Forgets all rows of a tape's density network.
    pub(crate) fn clear(&self, tape: &mut Tape) {
        tape.density.clear();
    }

    /// Appends rows of another tape's density network.
    pub(crate) fn append(&self, tape: &mut Tape, from: &Tape, rows: &[u32]) {
        tape.density.append(&self.density, &from.density, rows);
    }

    /// Becomes rows of another tape's density network.
    pub(crate) fn gather(&self, tape: &mut Tape, from: &Tape, rows: &[u32]) {
        tape.density.gather(&self.density, &from.density, rows);
    }
}

impl Field<CpuBackend> for CpuField {
    type Tape = Tape;
    type Gradient = FieldGradient;

    fn tape(&self) -> Tape {
        Tape {
            density: self.density.activations(),
            color_input: Buffer::zeros(0),
            color: self.color.activations(),
            directions: Vec::new(),
            color_gradient: Buffer::zeros(0),
            input_gradient: Buffer::zeros(0),
            output_gradient: Buffer::zeros(0),
        }
    }

    fn gradient(&self) -> FieldGradient {
        FieldGradient { density: self.density.gradient(), color: self.color.gradient() }
    }

    fn refresh(&mut self, parameters: &Buffer<f32>) {
        let weights: Vec<&[f32]> = self.slots.iter().map(|slot| &parameters[slot.range.clone()]).collect();
        let (density, color) = weights.split_at(self.density_layers);
        self.density.pack(density);
        self.color.pack(color);
    }

    fn density(
        &self,
        _: &mut Lane,
        samples: &Samples<CpuBackend>,
        features: &Buffer<f32>,
        tape: &mut Tape,
        radiance: &mut Buffer<Radiance>,
    ) {
        let rows = samples.spheres.len();
        self.density.forward(self.simd, rows, features, &mut tape.density);
        radiance.resize(rows);
        for (radiance, output) in radiance.iter_mut().zip(tape.density.output().chunks_exact(OUTPUTS)) {
            *radiance = Radiance { rgb: [0.0; 3], density: density(output[0]) };
        }
    }

    fn keep(&self, _: &mut Lane, kept: &Buffer<u32>, tape: &mut Tape, radiance: &mut Buffer<Radiance>) {
        tape.density.keep(&self.density, kept);
        radiance.keep_rows(kept, 1);
    }

    fn color(
        &self,
        _: &mut Lane,
        rays: &Rays<CpuBackend>,
        samples: &Samples<CpuBackend>,
        tape: &mut Tape,
        radiance: &mut Buffer<Radiance>,
    ) {
        let rows = samples.spheres.len();
        tape.directions.clear();
        tape.directions.extend(rays.rays.iter().map(|ray| spherical_harmonics(ray.direction)));
        let width = self.color.inputs();
        tape.color_input.resize(padded(rows) * width);
        let outputs = tape.density.output().chunks_exact(OUTPUTS);
        for ((input, output), &ray) in
            tape.color_input.chunks_exact_mut(width).zip(outputs).zip(samples.rays.iter())
        {
            input[..sh::COUNT].copy_from_slice(&tape.directions[ray as usize]);
            input[sh::COUNT..].copy_from_slice(output);
        }
        self.color.forward(self.simd, rows, &tape.color_input, &mut tape.color);
        let logits = tape.color.output();
        let width = logits.len() / padded(rows).max(1);
        for (radiance, logits) in radiance.iter_mut().zip(logits.chunks_exact(width.max(1))) {
            radiance.rgb = [0, 1, 2].map(|c| sigmoid(logits[c]));
        }
    }

    fn backward(
        &self,
        _: &mut Lane,
        samples: &Samples<CpuBackend>,
        features: &Buffer<f32>,
        tape: &mut Tape,
        radiance: &Buffer<Radiance>,
        radiance_gradients: &Buffer<Radiance>,
        feature_gradients: &mut Buffer<f32>,
        gradient: &mut FieldGradient,
    ) {
        let (simd, rows) = (self.simd, samples.spheres.len());
        let Tape { density, color_input, color, color_gradient, input_gradient, output_gradient, .. } = tape;
        let width = color.output().len() / padded(rows).max(1);
        color_gradient.resize(padded(rows) * width);
        color_gradient.fill(0.0);
        let pairs = radiance.iter().zip(radiance_gradients.iter());
        for (out, (value, by_value)) in color_gradient.chunks_exact_mut(width.max(1)).zip(pairs) {
            for c in 0..3 {
                out[c] = by_value.rgb[c] * sigmoid_derivative(value.rgb[c]);
            }
        }
        self.color.backward(
            simd,
            rows,
            color_input,
            color,
            color_gradient,
            input_gradient,
            &mut gradient.color,
        );

        output_gradient.resize(padded(rows) * OUTPUTS);
        let outputs = density.output().chunks_exact(OUTPUTS);
        let pairs =
            output_gradient.chunks_exact_mut(OUTPUTS).zip(input_gradient.chunks_exact(self.color.inputs()));
        for ((out, by_input), (output, by_value)) in pairs.zip(outputs.zip(radiance_gradients.iter())) {
            out.copy_from_slice(&by_input[sh::COUNT..]);
            out[0] = by_value.density * density_derivative(output[0]);
        }
        let weights = &mut gradient.density;
        self.density.backward(simd, rows, features, density, output_gradient, feature_gradients, weights);
    }

    fn flush(&mut self, deposits: &mut [Deposit<CpuBackend>], parameter_gradient: &mut Buffer<f32>) {
        for (i, slot) in self.slots.iter().enumerate() {
            let out = &mut parameter_gradient[slot.range.clone()];
            let fields = deposits.iter_mut().map(|deposit| &mut deposit.field);
            match i.checked_sub(self.density_layers) {
                None => self.density.flush(i, fields.map(|field| &mut field.density), out),
                Some(i) => self.color.flush(i, fields.map(|field| &mut field.color), out),
            }
        }
    }
}
