//! Factored tensors on the GPU: one invocation per sample and four features, forward and backward.

use super::{Encoding, Left, Places, SETTLE_ENTRIES, whole};
use crate::buffer::Buffer;
use crate::device::{GROUP, Gpu, Size};
use crate::kernel::Access::{self, Parameters, Read, Write};
use crate::kernel::{ADD_ATOMIC, ADD_EXCHANGE, ADD_FIXED, Addition, FIXED, GRID, Kernel};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;
use trimip_core::encoders::tensor::{KINDS, Shape, slots};
use trimip_core::params::ALIGNMENT;
use trimip_core::{Config, encoders};

const TENSOR: &str = include_str!("shaders/tensor.wgsl");
const ADDING: &str = include_str!("shaders/tensor_add.wgsl");
const ADDING_FIXED: &[&str] = &[GRID, TENSOR, FIXED, ADD_FIXED, ADDING];
const ADDING_ATOMIC: &[&str] = &[GRID, TENSOR, ADD_ATOMIC, ADDING];
const ADDING_EXCHANGE: &[&str] = &[GRID, TENSOR, ADD_EXCHANGE, ADDING];

/// Computes the features of samples.
static READ: Kernel = Kernel::new(
    "tensor_read",
    &[GRID, TENSOR, include_str!("shaders/tensor_read.wgsl")],
    &[(1, Read), (2, Parameters), (4, Write), (5, Read), (9, Read)],
);

/// The kernel that adds gradients of factors.
fn add(addition: Addition) -> Kernel {
    const FLOATS: &[(u32, Access)] =
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (9, Read)];
    const WORDS: &[(u32, Access)] =
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (6, Write), (8, Write), (9, Read)];
    match addition {
        Addition::Fixed => Kernel::new("tensor_add", ADDING_FIXED, WORDS),
        Addition::Atomic => Kernel::new("tensor_add", ADDING_ATOMIC, FLOATS),
        Addition::Exchange => Kernel::new("tensor_add", ADDING_EXCHANGE, FLOATS),
    }
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    sides: [u32; 3],
    planes: u32,
    starts: [u32; 4],
    components: [u32; 2],
    stride: u32,
    counter: u32,
}

/// The shape of the factors, and room for gradients in fixed point.
pub(crate) struct Factors {
    gpu: Arc<Gpu>,
    /// By stage of growth, and the one in use.
    shapes: Vec<Shape>,
    shape: Shape,
    /// Where the planes and lines of both tensors begin.
    starts: [u32; 4],
    stride: u32,
    /// Floats of all factors, up to the next slot.
    length: usize,
    addition: Addition,
    /// High words of the gradient in fixed point.
    high: Buffer<f32>,
    /// Counter of terms that do not fit into fixed point.
    skipped: wgpu::Buffer,
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
        let fixed = training && addition == Addition::Fixed;
        Self {
            gpu: Arc::clone(gpu),
            shapes: Shape::all(config),
            starts: [start(0, 0), start(0, each - 1), start(1, 0), start(1, each - 1)],
            shape,
            stride: (encoders::stride(config) / 4) as u32,
            length,
            addition,
            high: Buffer::zeros(gpu, if fixed { length } else { ALIGNMENT }),
            skipped: skipped.raw().clone(),
        }
    }

    fn grow(&mut self, stage: u32) {
        self.shape = self.shapes[stage as usize].clone();
    }

    fn forward(&self, parameters: &Buffer<f32>, at: &Places, _: &Buffer<f32>, features: &Buffer<f32>) {
        let (factors, rows) = (parameters.part(0, self.length), &at.rows);
        let binds = [whole(&at.spheres), features.bind(), rows.bind(), factors];
        self.gpu.dispatch(&READ, &binds, &self.params(rows.counter), rows.dispatch(self.stride, GROUP));
    }

    fn flush(
        &mut self,
        deposits: impl Iterator<Item = Left>,
        parameters: &Buffer<f32>,
        parameter_gradient: &Buffer<f32>,
    ) {
        let bytes = |count: usize| (count * size_of::<f32>()) as u64;
        self.gpu.clear(parameter_gradient.raw(), 0, bytes(self.length));
        self.gpu.clear(self.high.raw(), 0, bytes(self.high.capacity()));
        let fixed = self.addition == Addition::Fixed;
        for left in deposits {
            let (sums, rows) = (parameter_gradient.part(0, self.length), &left.at.rows);
            let mut binds = vec![whole(&left.gradients), whole(&left.at.spheres), sums, rows.bind()];
            if fixed {
                binds.push(self.high.bind());
                binds.push(whole(&self.skipped));
            }
            binds.push(parameters.part(0, self.length));
            let size = rows.dispatch(self.stride, GROUP);
            self.gpu.dispatch(&add(self.addition), &binds, &self.params(rows.counter), size);
        }
        if fixed {
            let count = self.length as u32 / 4;
            let binds = [parameter_gradient.part(0, self.length), self.high.part(0, self.length)];
            self.gpu.dispatch(&SETTLE_ENTRIES, &binds, &count, Size::Items(count.into()));
        }
    }

    #[cfg(test)]
    fn kernels() -> Vec<Kernel> {
        let adding = [Addition::Fixed, Addition::Atomic, Addition::Exchange].map(add);
        adding.into_iter().chain([READ.clone()]).collect()
    }
}
