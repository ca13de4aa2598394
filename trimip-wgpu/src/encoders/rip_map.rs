//! Ripmaps on the GPU. A ripmap holds a copy of its base, so that every level is read from one array. The Gaussians of
//! the samples are the tape.

use super::{Encoding, GAUSSIANS, Left, Places, SETTLE_ENTRIES, TEXELS, whole};
use crate::buffer::Buffer;
use crate::device::{GROUP, Gpu, Size};
use crate::kernel::Access::{self, Parameters, Read, Write};
use crate::kernel::{ADD_ATOMIC, ADD_EXCHANGE, ADD_FIXED, Addition, FIXED, GRID, Kernel, RAY};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;
use trimip_core::encoders::rip_map::{self, CHANNELS};
use trimip_core::{Aabb, Config};

const PLANES: &str = include_str!("shaders/rip_planes.wgsl");
const MAP: &str = include_str!("shaders/rip_map.wgsl");
const ADD: &str = include_str!("shaders/rip_add.wgsl");
const ADDING_FIXED: &[&str] = &[GRID, PLANES, GAUSSIANS, TEXELS, MAP, FIXED, ADD_FIXED, ADD];
const ADDING_ATOMIC: &[&str] = &[GRID, PLANES, GAUSSIANS, TEXELS, MAP, ADD_ATOMIC, ADD];
const ADDING_EXCHANGE: &[&str] = &[GRID, PLANES, GAUSSIANS, TEXELS, MAP, ADD_EXCHANGE, ADD];
const PASS: &str = include_str!("shaders/rip_pass.wgsl");
const AVERAGING: &[&str] = &[GRID, PLANES, PASS, include_str!("shaders/rip_average.wgsl")];
const PULLING: &[&str] = &[GRID, PLANES, PASS, include_str!("shaders/rip_pull.wgsl")];

/// Computes the Gaussians of samples.
static PREPARE: Kernel = Kernel::new(
    "rip_prepare",
    &[GRID, RAY, GAUSSIANS, include_str!("shaders/rip_prepare.wgsl")],
    &[(0, Read), (1, Read), (2, Parameters), (3, Read), (4, Write), (5, Read), (6, Read)],
);
/// Computes the features of samples.
static READ: Kernel = Kernel::new(
    "rip_read",
    &[GRID, PLANES, GAUSSIANS, TEXELS, MAP, include_str!("shaders/rip_read.wgsl")],
    &[(0, Read), (1, Read), (2, Parameters), (4, Write), (5, Read), (9, Read)],
);
static BASE: Kernel =
    Kernel::new("rip_base", AVERAGING, &[(0, Write), (1, Read), (2, Parameters), (9, Read)]);
static AVERAGE_ALONG: Kernel =
    Kernel::new("rip_average_along", AVERAGING, &[(0, Write), (2, Parameters), (9, Read)]);
static AVERAGE_ACROSS: Kernel =
    Kernel::new("rip_average_across", AVERAGING, &[(0, Write), (2, Parameters), (9, Read)]);
static PULL_ALONG: Kernel = Kernel::new("rip_pull_along", PULLING, &[(0, Write), (2, Parameters), (9, Read)]);
static PULL_ACROSS: Kernel =
    Kernel::new("rip_pull_across", PULLING, &[(0, Write), (2, Parameters), (9, Read)]);
static TAKE: Kernel = Kernel::new("rip_take", PULLING, &[(0, Write), (1, Write), (2, Parameters), (9, Read)]);

/// The kernel that adds feature gradients to the gradients of ripmaps.
fn add(addition: Addition) -> Kernel {
    const FLOATS: &[(u32, Access)] =
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (9, Read)];
    const WORDS: &[(u32, Access)] =
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (6, Write), (8, Write), (9, Read)];
    match addition {
        Addition::Fixed => Kernel::new("rip_add", ADDING_FIXED, WORDS),
        Addition::Atomic => Kernel::new("rip_add", ADDING_ATOMIC, FLOATS),
        Addition::Exchange => Kernel::new("rip_add", ADDING_EXCHANGE, FLOATS),
    }
}

/// A plane in the layout of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Plane {
    places: [[f32; 4]; 2],
    axes: [[f32; 4]; 2],
    sides: [u32; 2],
    first: u32,
    start: u32,
}

impl Plane {
    fn new(plane: &rip_map::Plane<f64>) -> Self {
        let four = |[x, y, z]: [f64; 3], w: f64| [x, y, z, w].map(|value| value as f32);
        Self {
            places: [0, 1].map(|axis| four(plane.factors[axis], plane.offsets[axis])),
            axes: [0, 1].map(|axis| four(plane.axes[axis], plane.base[axis])),
            sides: plane.sides.map(|side| side as u32),
            first: plane.first as u32,
            start: plane.start as u32,
        }
    }
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Preparing {
    extent: [f32; 3],
    counter: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    planes: u32,
    levels: u32,
    counter: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Pass {
    planes: u32,
    levels: u32,
    level: u32,
}

/// The planes and their ripmaps.
pub(crate) struct RipMaps {
    gpu: Arc<Gpu>,
    own: Vec<rip_map::Plane<f64>>,
    planes: Buffer<Plane>,
    levels: u32,
    extent: [f32; 3],
    /// Floats of the bases of all planes.
    base: usize,
    maps: Buffer<f32>,
    map_gradients: Buffer<f32>,
    addition: Addition,
    /// High words of the gradients in fixed point.
    high: Buffer<f32>,
    /// Counter of terms that do not fit into fixed point.
    skipped: wgpu::Buffer,
}

impl RipMaps {
    fn params(&self, counter: u32) -> Params {
        Params { planes: self.own.len() as u32, levels: self.levels, counter }
    }

    /// Runs a pass over the texels of `level` along an axis: along the rows, or across them.
    fn pass(
        &self,
        kernel: &Kernel,
        across: bool,
        level: u32,
        maps: &Buffer<f32>,
        base: Option<&Buffer<f32>>,
    ) {
        let texels = self.own.iter().map(|plane| match across {
            true => plane.sides[0] * (plane.sides[1] >> level),
            false => (plane.sides[0] >> level) * plane.height(),
        });
        let size = Size::Items((texels.sum::<usize>() * CHANNELS / 4) as u64);
        let mut binds = vec![maps.bind()];
        binds.extend(base.map(|base| base.part(0, self.base)));
        binds.push(self.planes.bind());
        let pass = Pass { planes: self.own.len() as u32, levels: self.levels, level };
        self.gpu.dispatch(kernel, &binds, &pass, size);
    }
}

impl Encoding for RipMaps {
    fn new(
        gpu: &Arc<Gpu>,
        config: &Config,
        training: bool,
        addition: Addition,
        skipped: &Buffer<u32>,
    ) -> Self {
        let aabb = Aabb::<f64>::new(&config.scene);
        let own = rip_map::planes(&config.rip_map, &aabb);
        let [base, maps] = rip_map::texels(&config.rip_map, &aabb).map(|texels| texels * CHANNELS);
        let mut planes = Buffer::zeros(gpu, 0);
        planes.write(&own.iter().map(Plane::new).collect::<Vec<_>>());
        let fixed = training && addition == Addition::Fixed;
        Self {
            gpu: Arc::clone(gpu),
            own,
            planes,
            levels: config.rip_map.levels,
            extent: aabb.extent().map(|side| side as f32),
            base,
            maps: Buffer::zeros(gpu, maps),
            map_gradients: Buffer::zeros(gpu, if training { maps } else { CHANNELS }),
            addition,
            high: Buffer::zeros(gpu, if fixed { maps } else { CHANNELS }),
            skipped: skipped.raw().clone(),
        }
    }

    fn refresh(&mut self, parameters: &Buffer<f32>) {
        self.pass(&BASE, true, 0, &self.maps, Some(parameters));
        for level in 1..self.levels {
            self.pass(&AVERAGE_ACROSS, true, level, &self.maps, None);
        }
        for level in 1..self.levels {
            self.pass(&AVERAGE_ALONG, false, level, &self.maps, None);
        }
    }

    fn forward(&self, _: &Buffer<f32>, at: &Places, tape: &Buffer<f32>, features: &Buffer<f32>) {
        let rows = &at.rows;
        let binds = [
            whole(&at.rays),
            whole(&at.owners),
            whole(&at.intervals),
            tape.bind(),
            rows.bind(),
            whole(&at.spheres),
        ];
        let preparing = Preparing { extent: self.extent, counter: rows.counter };
        self.gpu.dispatch(&PREPARE, &binds, &preparing, rows.dispatch(1, GROUP));
        let binds = [self.maps.bind(), tape.bind(), features.bind(), rows.bind(), self.planes.bind()];
        let size = rows.dispatch(4 * self.own.len() as u32, GROUP);
        self.gpu.dispatch(&READ, &binds, &self.params(rows.counter), size);
    }

    fn flush(
        &mut self,
        deposits: impl Iterator<Item = Left>,
        _: &Buffer<f32>,
        parameter_gradient: &Buffer<f32>,
    ) {
        for buffer in [&self.map_gradients, &self.high] {
            self.gpu.clear(buffer.raw(), 0, (buffer.capacity() * size_of::<f32>()) as u64);
        }
        let fixed = self.addition == Addition::Fixed;
        for left in deposits {
            let rows = &left.at.rows;
            let mut binds =
                vec![whole(&left.gradients), whole(&left.tape), self.map_gradients.bind(), rows.bind()];
            if fixed {
                binds.push(self.high.bind());
                binds.push(whole(&self.skipped));
            }
            binds.push(self.planes.bind());
            let size = rows.dispatch(4 * self.own.len() as u32, GROUP);
            self.gpu.dispatch(&add(self.addition), &binds, &self.params(rows.counter), size);
        }
        let gradients = &self.map_gradients;
        if fixed {
            let count = (gradients.capacity() / 4) as u32;
            let binds = [gradients.bind(), self.high.bind()];
            self.gpu.dispatch(&SETTLE_ENTRIES, &binds, &count, Size::Items(count.into()));
        }
        for level in (1..self.levels).rev() {
            self.pass(&PULL_ALONG, false, level, gradients, None);
        }
        for level in (1..self.levels).rev() {
            self.pass(&PULL_ACROSS, true, level, gradients, None);
        }
        self.pass(&TAKE, true, 0, gradients, Some(parameter_gradient));
    }

    #[cfg(test)]
    fn kernels() -> Vec<Kernel> {
        let adding = [Addition::Fixed, Addition::Atomic, Addition::Exchange].map(add);
        let passes = [&BASE, &AVERAGE_ALONG, &AVERAGE_ACROSS, &PULL_ALONG, &PULL_ACROSS, &TAKE];
        let others = [&PREPARE, &READ].into_iter().chain(passes).cloned();
        adding.into_iter().chain(others).collect()
    }
}
