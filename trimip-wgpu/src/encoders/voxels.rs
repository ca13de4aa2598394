//! A grid of densities and spherical harmonics on the GPU: one invocation per feature of a sample, forward and backward.

use super::{Encoding, Left, Places, SETTLE_ENTRIES, whole};
use crate::buffer::Buffer;
use crate::device::{GROUP, Gpu, Size};
use crate::kernel::Access::{self, Parameters, Read, Write};
use crate::kernel::{ADD_ATOMIC, ADD_EXCHANGE, ADD_FIXED, Addition, FIXED, GRID, HARMONICS, Kernel, RAY};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;
use trimip_core::encoders::voxels::{Shape, WIDTH, slots};
use trimip_core::params::ALIGNMENT;
use trimip_core::{Config, encoders};

const VOXELS: &str = include_str!("shaders/voxels.wgsl");
const ADDING: &str = include_str!("shaders/voxels_add.wgsl");
const ADDING_FIXED: &[&str] = &[GRID, RAY, VOXELS, HARMONICS, FIXED, ADD_FIXED, ADDING];
const ADDING_ATOMIC: &[&str] = &[GRID, RAY, VOXELS, HARMONICS, ADD_ATOMIC, ADDING];
const ADDING_EXCHANGE: &[&str] = &[GRID, RAY, VOXELS, HARMONICS, ADD_EXCHANGE, ADDING];

/// Computes the features of samples.
static READ: Kernel = Kernel::new(
    "voxels_read",
    &[GRID, RAY, VOXELS, HARMONICS, include_str!("shaders/voxels_read.wgsl")],
    &[(0, Read), (1, Read), (2, Parameters), (4, Write), (5, Read), (6, Read), (9, Read)],
);

/// The kernel that adds gradients.
fn add(addition: Addition) -> Kernel {
    const FLOATS: &[(u32, Access)] =
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (7, Read), (9, Read)];
    const WORDS: &[(u32, Access)] = &[
        (0, Read),
        (1, Read),
        (2, Parameters),
        (3, Write),
        (5, Read),
        (6, Write),
        (7, Read),
        (8, Write),
        (9, Read),
    ];
    match addition {
        Addition::Fixed => Kernel::new("voxels_add", ADDING_FIXED, WORDS),
        Addition::Atomic => Kernel::new("voxels_add", ADDING_ATOMIC, FLOATS),
        Addition::Exchange => Kernel::new("voxels_add", ADDING_EXCHANGE, FLOATS),
    }
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    sides: [u32; 3],
    stride: u32,
    density: u32,
    colors: u32,
    harmonics: u32,
    counter: u32,
}

/// The grid, and room for gradients in fixed point.
pub(crate) struct Grid {
    gpu: Arc<Gpu>,
    /// By stage of growth, and the one in use.
    shapes: Vec<Shape>,
    shape: Shape,
    /// Where the densities and the colours begin.
    starts: [u32; 2],
    stride: u32,
    /// Floats of both, up to the next slot.
    length: usize,
    addition: Addition,
    /// High words of the gradient in fixed point.
    high: Buffer<f32>,
    /// Counter of terms that do not fit into fixed point.
    skipped: wgpu::Buffer,
}

impl Grid {
    fn params(&self, counter: u32) -> Params {
        Params {
            sides: self.shape.sides.map(|side| side as u32),
            stride: self.stride,
            density: self.starts[0],
            colors: self.starts[1],
            harmonics: self.shape.harmonics as u32,
            counter,
        }
    }
}

impl Encoding for Grid {
    fn new(
        gpu: &Arc<Gpu>,
        config: &Config,
        training: bool,
        addition: Addition,
        skipped: &Buffer<u32>,
    ) -> Self {
        let slots = slots(config);
        let length = slots.last().map_or(ALIGNMENT, |slot| slot.padded().end);
        let fixed = training && addition == Addition::Fixed;
        Self {
            gpu: Arc::clone(gpu),
            shapes: Shape::all(config),
            shape: Shape::new(config, 0),
            starts: [0, 1].map(|i| slots[i].range.start as u32),
            stride: encoders::stride(config) as u32,
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
        let (values, rows) = (parameters.part(0, self.length), &at.rows);
        let binds =
            [values, whole(&at.spheres), features.bind(), rows.bind(), whole(&at.rays), whole(&at.owners)];
        self.gpu.dispatch(&READ, &binds, &self.params(rows.counter), rows.dispatch(WIDTH as u32, GROUP));
    }

    fn flush(
        &mut self,
        deposits: impl Iterator<Item = Left>,
        _: &Buffer<f32>,
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
            }
            binds.push(whole(&left.at.rays));
            if fixed {
                binds.push(whole(&self.skipped));
            }
            binds.push(whole(&left.at.owners));
            let size = rows.dispatch(WIDTH as u32, GROUP);
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
