//! Factored tensors on the GPU: one invocation per group of four features of a sample, forward and backward.

use super::scatter::Scatter;
use super::{Encoding, FeatureGradients, Places, whole};
use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Parts, Text};
use crate::gpu::{Buffer, GRID, GROUP, Gpu, Kernel, Pipeline};
use crate::workspace::Addition;
use std::sync::Arc;
use trimip_core::field::encoders::tensor::{KINDS, Shape, slots};
use trimip_core::field::params::ALIGNMENT;
use trimip_core::{Config, field::encoders};

shared! {
    /// Parameters of factored tensors.
    struct Params as Params {
        /// Number of grid points along each of the box's axes.
        sides: [u32; 3],
        /// Number of planes: 3, or 0 for products of three lines.
        planes: u32,
        /// First index of the planes and the lines of the density tensor, then of the colour tensor, in units of four
        /// floats.
        starts: [u32; 4],
        /// Number of components of the density tensor and of the colour tensor, in units of four.
        components: [u32; 2],
        /// Number of floats in a row of features, in units of four.
        stride: u32,
        counter: u32,
    }
}

const TENSOR: Source = Parts(&[GRID, Source::of::<Params>(), Text(include_str!("shaders/tensor.wgsl"))]);

/// Returns the kernel that computes the features of samples.
fn read() -> Kernel {
    Kernel::new(
        "tensor_read",
        &[TENSOR, Text(include_str!("shaders/tensor_read.wgsl"))],
        &[(1, Read), (2, Parameters), (4, Write), (5, Read), (9, Read)],
    )
}

/// Returns the kernel that adds up the gradients of factors.
fn add(addition: Addition) -> Kernel {
    addition.kernel(
        "tensor_add",
        &[TENSOR, Text(include_str!("shaders/tensor_add.wgsl"))],
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (9, Read)],
    )
}

/// The shape of the factors, and the sums of their gradients.
pub(crate) struct Factors {
    gpu: Arc<Gpu>,
    /// Shapes at all growth stages; `shape` is the one in use.
    shapes: Vec<Shape>,
    shape: Shape,
    /// First index of the planes and the lines of each tensor, in units of four floats.
    starts: [u32; 4],
    stride: u32,
    read: Pipeline,
    /// Sums of gradients for all factors, up to the next slot.
    sums: Scatter,
}

impl Factors {
    fn params(&self, counter: u32) -> Params {
        Params {
            sides: self.shape.sides.map(|side| side as u32),
            planes: self.shape.planes() as u32,
            starts: self.starts,
            components: KINDS.map(|kind| self.shape.components(kind) as u32 / 4),
            stride: self.stride,
            counter,
        }
    }
}

impl Encoding for Factors {
    fn new(
        gpu: &Arc<Gpu>,
        config: &Config,
        training: bool,
        addition: Addition,
        skipped: &Buffer<u32>,
    ) -> Self {
        let (shape, slots) = (Shape::new(config, 0), slots(config));
        let each = if shape.planes() > 0 { 2 } else { 1 };
        let start = |kind: usize, factor: usize| (slots[kind * each + factor].range.start / 4) as u32;
        let length = slots.last().map_or(ALIGNMENT, |slot| slot.padded().end);
        Self {
            gpu: Arc::clone(gpu),
            shapes: Shape::all(config),
            starts: [start(0, 0), start(0, each - 1), start(1, 0), start(1, each - 1)],
            shape,
            stride: (encoders::stride(config) / 4) as u32,
            read: gpu.pipeline(read()),
            sums: Scatter::new(gpu, add(addition), addition, training, length, skipped),
        }
    }

    fn grow(&mut self, stage: u32) {
        self.shape = self.shapes[stage as usize].clone();
    }

    fn forward(&self, parameters: &Buffer<f32>, at: &Places, _: &Buffer<f32>, features: &Buffer<f32>) {
        let (factors, rows) = (parameters.part(0, self.sums.length()), &at.rows);
        let binds = [whole(&at.spheres), features.bind(), rows.bind(), factors];
        self.gpu.dispatch(&self.read, &binds, &self.params(rows.counter), rows.dispatch(self.stride, GROUP));
    }

    fn reduce(
        &mut self,
        partials: impl Iterator<Item = FeatureGradients>,
        parameters: &Buffer<f32>,
        parameter_gradient: &Buffer<f32>,
    ) {
        self.sums.clear(parameter_gradient);
        let factors = parameters.part(0, self.sums.length());
        for from in partials {
            let rows = &from.at.rows;
            let work = (&self.params(rows.counter), rows.dispatch(self.stride, GROUP));
            self.sums.add(&from, &from.at.spheres, parameter_gradient, &[factors], work);
        }
        self.sums.to_float(parameter_gradient);
    }

    #[cfg(test)]
    fn kernels() -> Vec<Kernel> {
        super::scatter::ADDITIONS.map(add).into_iter().chain([read()]).collect()
    }
}
