//! The hash grid on the GPU: one invocation per sample and level, forward and backward.

use super::{Encoding, Left, Places, SETTLE_ENTRIES, whole};
use crate::buffer::Buffer;
use crate::device::{GROUP, Gpu, Size};
use crate::kernel::Access::{self, Parameters, Read, Write};
use crate::kernel::{ADD_ATOMIC, ADD_EXCHANGE, ADD_FIXED, Addition, FIXED, GRID, Kernel, RAY};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;
use trimip_core::encoders::hash_grid::{Levels, PRIMES, Points};
use trimip_core::params::ALIGNMENT;
use trimip_core::{Aabb, Config, encoders};

const HASH: &str = include_str!("shaders/hash_grid.wgsl");
const READING: &[&str] = &[GRID, HASH, include_str!("shaders/hash_read.wgsl")];
const ADDING: &str = include_str!("shaders/hash_add.wgsl");
const ADDING_FIXED: &[&str] = &[GRID, HASH, FIXED, ADD_FIXED, ADDING];
const ADDING_ATOMIC: &[&str] = &[GRID, HASH, ADD_ATOMIC, ADDING];
const ADDING_EXCHANGE: &[&str] = &[GRID, HASH, ADD_EXCHANGE, ADDING];

/// Constants of the kernels for entries of `features` floats, read at the points of a sample.
fn constants(features: u32, points: &Points<f32>) -> [(&'static str, u32); 5] {
    let [_, y, z] = PRIMES;
    let weighted = u32::from(points.downweight);
    let points = points.count as u32;
    [("FEATURES", features), ("POINTS", points), ("WEIGHTED", weighted), ("PRIME_Y", y), ("PRIME_Z", z)]
}

/// Computes the points of samples.
static PREPARE: Kernel = Kernel::new(
    "hash_points",
    &[GRID, RAY, include_str!("shaders/hash_points.wgsl")],
    &[(0, Read), (1, Read), (2, Parameters), (3, Read), (4, Write), (5, Read), (6, Read)],
);

/// The kernel of trilinear reads.
fn read(features: u32, points: &Points<f32>) -> Kernel {
    let bindings = &[(0, Read), (1, Read), (2, Parameters), (4, Write), (5, Read), (9, Read)];
    Kernel::new("hash_read", READING, bindings).with(&constants(features, points))
}

/// The kernel that adds gradients of entries.
fn add(features: u32, points: &Points<f32>, addition: Addition) -> Kernel {
    const FLOATS: &[(u32, Access)] =
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (9, Read)];
    const WORDS: &[(u32, Access)] =
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (6, Write), (8, Write), (9, Read)];
    let kernel = match addition {
        Addition::Fixed => Kernel::new("hash_add", ADDING_FIXED, WORDS),
        Addition::Atomic => Kernel::new("hash_add", ADDING_ATOMIC, FLOATS),
        Addition::Exchange => Kernel::new("hash_add", ADDING_EXCHANGE, FLOATS),
    };
    kernel.with(&constants(features, points))
}

/// A level in the layout of the shaders.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Level {
    scale: f32,
    /// 0 if corners share entries through the hash.
    side: u32,
    first: u32,
    entries: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    levels: u32,
    stride: u32,
    counter: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Preparing {
    extent: [f32; 3],
    longest: f32,
    points: u32,
    counter: u32,
}

/// The levels, and room for gradients in fixed point.
pub(crate) struct Grid {
    gpu: Arc<Gpu>,
    features: u32,
    points: Points<f32>,
    levels: Buffer<Level>,
    count: u32,
    stride: u32,
    /// Floats of the table, up to the next slot.
    length: usize,
    addition: Addition,
    /// High words of the gradient in fixed point.
    high: Buffer<f32>,
    /// Counter of terms that do not fit into fixed point.
    skipped: wgpu::Buffer,
}

impl Grid {
    fn params(&self, counter: u32) -> Params {
        Params { levels: self.count, stride: self.stride, counter }
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
        let grid = Levels::new(&config.hash_grid);
        let length = (grid.entries() * grid.features).next_multiple_of(ALIGNMENT);
        let own = grid.levels.iter().map(|level| Level {
            scale: level.scale,
            side: if level.hashed { 0 } else { level.side },
            first: level.first,
            entries: level.entries,
        });
        let mut levels = Buffer::zeros(gpu, 0);
        levels.write(&own.collect::<Vec<_>>());
        let fixed = training && addition == Addition::Fixed;
        Self {
            gpu: Arc::clone(gpu),
            features: grid.features as u32,
            points: Points::new(&config.hash_grid, &Aabb::new(&config.scene)),
            levels,
            count: grid.levels.len() as u32,
            stride: encoders::stride(config) as u32,
            length,
            addition,
            high: Buffer::zeros(gpu, if fixed { length } else { ALIGNMENT }),
            skipped: skipped.raw().clone(),
        }
    }

    fn forward(&self, parameters: &Buffer<f32>, at: &Places, tape: &Buffer<f32>, features: &Buffer<f32>) {
        let (table, rows) = (parameters.part(0, self.length), &at.rows);
        if !self.points.is_plain() {
            let binds = [
                whole(&at.rays),
                whole(&at.owners),
                whole(&at.intervals),
                tape.bind(),
                rows.bind(),
                whole(&at.spheres),
            ];
            let points = self.points.count as u32;
            let preparing = Preparing {
                extent: self.points.extent,
                longest: self.points.longest,
                points,
                counter: rows.counter,
            };
            self.gpu.dispatch(&PREPARE, &binds, &preparing, rows.dispatch(points, GROUP));
        }
        let places = if self.points.is_plain() { whole(&at.spheres) } else { tape.bind() };
        let binds = [table, places, features.bind(), rows.bind(), self.levels.bind()];
        let size = rows.dispatch(self.count, GROUP);
        self.gpu.dispatch(&read(self.features, &self.points), &binds, &self.params(rows.counter), size);
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
            let (table, rows) = (parameter_gradient.part(0, self.length), &left.at.rows);
            let places = if self.points.is_plain() { &left.at.spheres } else { &left.tape };
            let mut binds = vec![whole(&left.gradients), whole(places), table, rows.bind()];
            if fixed {
                binds.push(self.high.bind());
                binds.push(whole(&self.skipped));
            }
            binds.push(self.levels.bind());
            let kernel = add(self.features, &self.points, self.addition);
            let size = rows.dispatch(self.count, GROUP);
            self.gpu.dispatch(&kernel, &binds, &self.params(rows.counter), size);
        }
        if fixed {
            let count = self.length as u32 / 4;
            let binds = [parameter_gradient.part(0, self.length), self.high.part(0, self.length)];
            self.gpu.dispatch(&SETTLE_ENTRIES, &binds, &count, Size::Items(count.into()));
        }
    }

    #[cfg(test)]
    fn kernels() -> Vec<Kernel> {
        let points = [(1, false), (1, true), (6, true)].map(|(count, downweight)| Points {
            count,
            downweight,
            extent: [1.0; 3],
            longest: 1.0,
        });
        let variants = [1, 2, 4, 8].into_iter().flat_map(|f| points.map(|points| (f, points)));
        let ways = [Addition::Fixed, Addition::Atomic, Addition::Exchange];
        let of = |(f, points): (u32, Points<f32>)| {
            let adding = ways.map(|way| add(f, &points, way));
            adding.into_iter().chain([read(f, &points)])
        };
        variants.flat_map(of).chain([SETTLE_ENTRIES.clone(), PREPARE.clone()]).collect()
    }
}
