//! A grid of densities and spherical harmonics on the GPU: one invocation per feature of a sample, forward and backward.

use super::scatter::Scatter;
use super::{Encoding, FeatureGradients, Places, whole};
use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Parts, Text};
use crate::gpu::{Buffer, GRID, GROUP, Gpu, Kernel, Pipeline};
use crate::shaders::{HARMONICS, RAY};
use crate::workspace::Addition;
use std::sync::Arc;
use trimip_core::field::encoders::voxels::{Shape, WIDTH, slots};
use trimip_core::field::params::ALIGNMENT;
use trimip_core::{Config, field::encoders};

shared! {
    /// Parameters of the grid.
    struct Params as Params {
        /// Number of grid points along each of the box's axes.
        sides: [u32; 3],
        /// Number of floats in a row of features.
        stride: u32,
        /// Index of the first density and of the first colour.
        density: u32,
        colors: u32,
        /// Number of spherical harmonics of a colour.
        harmonics: u32,
        counter: u32,
    }
}

const VOXELS: Source = Parts(&[
    GRID,
    RAY,
    HARMONICS,
    Source::of::<Params>(),
    Source::whole("WIDTH", WIDTH as u32),
    Text(include_str!("shaders/voxels.wgsl")),
]);

/// Returns the kernel that computes the features of samples.
fn read() -> Kernel {
    Kernel::new(
        "voxels_read",
        &[VOXELS, Text(include_str!("shaders/voxels_read.wgsl"))],
        &[(0, Read), (1, Read), (2, Parameters), (4, Write), (5, Read), (6, Read), (9, Read)],
    )
}

/// Returns the kernel that adds up gradients.
fn add(addition: Addition) -> Kernel {
    addition.kernel(
        "voxels_add",
        &[VOXELS, Text(include_str!("shaders/voxels_add.wgsl"))],
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (9, Read), (10, Read)],
    )
}

/// The grid, and the sums of its gradients.
pub(crate) struct Grid {
    gpu: Arc<Gpu>,
    /// Shapes at all growth stages; `shape` is the one in use.
    shapes: Vec<Shape>,
    shape: Shape,
    /// Index of the first density and of the first colour.
    starts: [u32; 2],
    stride: u32,
    read: Pipeline,
    /// Sums of gradients for densities and colours, up to the next slot.
    sums: Scatter,
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
        Self {
            gpu: Arc::clone(gpu),
            shapes: Shape::all(config),
            shape: Shape::new(config, 0),
            starts: [0, 1].map(|i| slots[i].range.start as u32),
            stride: encoders::stride(config) as u32,
            read: gpu.pipeline(read()),
            sums: Scatter::new(gpu, add(addition), addition, training, length, skipped),
        }
    }

    fn grow(&mut self, stage: u32) {
        self.shape = self.shapes[stage as usize].clone();
    }

    fn forward(&self, parameters: &Buffer<f32>, at: &Places, _: &Buffer<f32>, features: &Buffer<f32>) {
        let (values, rows) = (parameters.part(0, self.sums.length()), &at.rows);
        let binds =
            [values, whole(&at.spheres), features.bind(), rows.bind(), whole(&at.rays), whole(&at.owners)];
        self.gpu.dispatch(&self.read, &binds, &self.params(rows.counter), rows.dispatch(WIDTH as u32, GROUP));
    }

    fn reduce(
        &mut self,
        partials: impl Iterator<Item = FeatureGradients>,
        _: &Buffer<f32>,
        parameter_gradient: &Buffer<f32>,
    ) {
        self.sums.clear(parameter_gradient);
        for from in partials {
            let Places { rays, owners, spheres, rows, .. } = &from.at;
            let work = (&self.params(rows.counter), rows.dispatch(WIDTH as u32, GROUP));
            self.sums.add(&from, spheres, parameter_gradient, &[whole(rays), whole(owners)], work);
        }
        self.sums.to_float(parameter_gradient);
    }

    #[cfg(test)]
    fn kernels() -> Vec<Kernel> {
        super::scatter::ADDITIONS.map(add).into_iter().chain([read()]).collect()
    }
}
