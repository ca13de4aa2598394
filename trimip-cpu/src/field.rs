//! Density and colour networks on the CPU. The density network outputs a logit and the geometry features. The colour
//! network reads this output with a zero weight on the logit, and spherical harmonics, which go through the first
//! layer once per ray.

use crate::buffer::Buffer;

use crate::gemm::padded;
use crate::mlp::{Activations, Mlp, MlpGradient, Passing, Shared};
use crate::simd::Simd;
use crate::{CpuBackend, Lane};
use trimip_core::activation::{density, density_derivative, sigmoid, sigmoid_derivative};
use trimip_core::batch::{Deposit, Radiance, Rays, Samples};
use trimip_core::config::Precision;
use trimip_core::params::{ALIGNMENT, Slot, color_layers, density_layers, harmonics};
use trimip_core::sh::{self, spherical_harmonics};
use trimip_core::{Config, Field, Layout, encoders};

/// The density and colour networks.
pub struct CpuField {
    simd: Simd,
    density: Mlp,
    color: Mlp,
    slots: Vec<Slot>,
    density_layers: usize,
    /// True if the colour network's input includes directions.
    directed: bool,
}

/// Activations of a span.
pub struct Tape {
    density: Activations,
    color: Activations,
    directions: Directions,
    /// Gradients of the colour logits and of the density network's output.
    color_gradient: Buffer<f32>,
    output_gradient: Buffer<f32>,
    passing: Passing,
}

/// Spherical harmonics of the rays that have samples.
#[derive(Default)]
struct Directions {
    /// Number of rays with samples.
    count: usize,
    /// Shape: [rays with samples (padded), 16].
    harmonics: Buffer<f32>,
    /// Row of `harmonics` for each sample, padding included.
    of: Vec<u32>,
}

impl Directions {
    fn gather(&mut self, rays: &Rays<CpuBackend>, samples: &Samples<CpuBackend>) {
        self.of.clear();
        self.harmonics.clear();
        let (mut count, mut last) = (0, None);
        for &ray in samples.rays.iter() {
            if last != Some(ray) {
                last = Some(ray);
                count += 1;
                self.harmonics.resize(count * sh::COUNT);
                let harmonics = spherical_harmonics(rays.rays[ray as usize].direction);
                self.harmonics[(count - 1) * sh::COUNT..].copy_from_slice(&harmonics);
            }
            self.of.push(count as u32 - 1);
        }
        self.count = count;
        self.harmonics.resize(padded(count) * sh::COUNT);
        self.of.resize(padded(samples.rays.len()), 0);
    }

    fn shared(&self) -> Shared<'_> {
        Shared { groups: self.count, input: &self.harmonics, of: &self.of }
    }
}

/// Weight gradients of both networks.
pub struct FieldGradient {
    density: MlpGradient,
    color: MlpGradient,
}

impl CpuField {
    /// Creates the networks of a configuration, with products in `precision`.
    pub fn new(simd: Simd, config: &Config, layout: &Layout, precision: Precision) -> Self {
        let density_shapes = density_layers(config);
        let width = density_shapes[0][0];
        let features = (0..encoders::stride(config)).map(|row| (row < width).then_some(row)).collect();
        // The density logit is not an input of the colour network.
        let (harmonics, outputs) = (harmonics(config), 1 + config.field.geometry as usize);
        let geometry = |output: usize| (1..outputs).contains(&output).then(|| harmonics + output - 1);
        let directions = if config.field.directions { sh::COUNT } else { 0 };
        Self {
            simd,
            density: Mlp::new(&density_shapes, features, Vec::new(), precision),
            color: Mlp::new(
                &color_layers(config),
                (0..outputs.next_multiple_of(ALIGNMENT)).map(geometry).collect(),
                (0..directions).map(|i| (i < harmonics).then_some(i)).collect(),
                precision,
            ),
            slots: layout.networks().to_vec(),
            density_layers: density_shapes.len(),
            directed: config.field.directions,
        }
    }
}

impl CpuField {
    /// Removes all rows of the density network from a tape.
    pub(crate) fn clear(&self, tape: &mut Tape) {
        tape.density.clear();
    }

    /// Appends the rows `rows` of the density network from another tape.
    pub(crate) fn append(&self, tape: &mut Tape, from: &Tape, rows: &[u32]) {
        tape.density.append(&self.density, &from.density, rows);
    }

    /// Replaces the geometry features of each group of samples by their weighted mean, in the group's first row. `kept`
    /// lists these rows. `shares` has one value per sample: its weight in its group, negative for all samples of a group
    /// but the first.
    pub(crate) fn blend(&self, tape: &mut Tape, kept: &[u32], shares: &[f32]) {
        tape.density.blend(&self.density, kept, shares);
    }

    /// Replaces the density network's rows by the rows `rows` of another tape.
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
            color: self.color.activations(),
            directions: Directions::default(),
            color_gradient: Buffer::zeros(0),
            output_gradient: Buffer::zeros(0),
            passing: Passing::default(),
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
        self.density.forward(self.simd, rows, features, None, &mut tape.density);
        radiance.resize(rows);
        for (radiance, output) in
            radiance.iter_mut().zip(tape.density.output().chunks_exact(self.density.outputs()))
        {
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
        let Tape { density, color, directions, .. } = tape;
        if self.directed {
            directions.gather(rays, samples);
        }
        let shared = self.directed.then(|| directions.shared());
        self.color.forward(self.simd, rows, density.output(), shared, color);
        let logits = tape.color.output();
        for (radiance, logits) in radiance.iter_mut().zip(logits.chunks_exact(self.color.outputs())) {
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
        let Tape { density, color, directions, color_gradient, output_gradient, passing } = tape;
        let width = self.color.outputs();
        color_gradient.resize(padded(rows) * width);
        color_gradient.fill(0.0);
        let pairs = radiance.iter().zip(radiance_gradients.iter());
        for (out, (value, by_value)) in color_gradient.chunks_exact_mut(width).zip(pairs) {
            for c in 0..3 {
                out[c] = by_value.rgb[c] * sigmoid_derivative(value.rgb[c]);
            }
        }
        self.color.backward(
            simd,
            rows,
            density.output(),
            self.directed.then(|| directions.shared()),
            color,
            color_gradient,
            output_gradient,
            passing,
            &mut gradient.color,
        );
        let width = self.density.outputs();
        let outputs = density.output().chunks_exact(width).zip(radiance_gradients.iter());
        for (out, (output, by_value)) in output_gradient.chunks_exact_mut(width).zip(outputs) {
            out[0] = by_value.density * density_derivative(output[0]);
        }
        let weights = &mut gradient.density;
        self.density.backward(
            simd,
            rows,
            features,
            None,
            density,
            output_gradient,
            feature_gradients,
            passing,
            weights,
        );
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
