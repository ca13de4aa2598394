//! The hash grid on the GPU: one invocation per sample and level, forward and backward.

use super::scatter::Scatter;
use super::{Encoding, FeatureGradients, Places, whole};
use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Constant, Parts, Text};
use crate::gpu::{Buffer, GRID, GROUP, Gpu, Kernel, Pipeline, Value};
use crate::shaders::{BASIS, RAY};
use crate::workspace::Addition;
use std::sync::Arc;
use trimip_core::field::encoders::hash_grid::{Levels, PRIMES, Points, TURNS};
use trimip_core::field::params::ALIGNMENT;
use trimip_core::{Aabb, Config, field::encoders};

shared! {
    /// A level of the grid.
    struct Level as Level {
        /// Number of cells across the box, minus one.
        scale: f32,
        /// Number of corners along a side; 0 if a hash maps corners to entries.
        side: u32,
        /// Index of the first entry, and number of entries.
        first: u32,
        entries: u32,
    }

    /// Parameters of the kernels that read entries and add up gradients.
    struct Params as Params {
        levels: u32,
        /// Number of floats in a row of features.
        stride: u32,
        counter: u32,
    }

    /// Parameters of the kernel that computes the points of samples.
    struct Preparing as Params {
        /// Size of the box in world units, and its longest side.
        extent: [f32; 3],
        longest: f32,
        /// Number of points per sample: 1 or 6.
        points: u32,
        counter: u32,
    }
}

const HASH: Source = Parts(&[
    GRID,
    Source::of::<Level>(),
    Source::of::<Params>(),
    Source::whole("PRIME_Y", PRIMES[1]),
    Source::whole("PRIME_Z", PRIMES[2]),
    Text(include_str!("shaders/hash_grid.wgsl")),
]);

/// Returns the constants of the kernels for entries of `features` floats that samples read at `points`.
fn constants(features: u32, points: &Points<f32>) -> [(&'static str, u32); 3] {
    [("FEATURES", features), ("POINTS", points.count as u32), ("WEIGHTED", u32::from(points.downweight))]
}

/// Returns the kernel that computes the points of samples.
fn prepare() -> Kernel {
    let turns = Constant("TURNS", Value::Reals(&TURNS));
    Kernel::new(
        "hash_points",
        &[GRID, RAY, BASIS, Source::of::<Preparing>(), turns, Text(include_str!("shaders/hash_points.wgsl"))],
        &[(0, Read), (1, Read), (2, Parameters), (3, Read), (4, Write), (5, Read), (6, Read)],
    )
}

/// Returns the kernel that reads entries with trilinear interpolation.
fn read(features: u32, points: &Points<f32>) -> Kernel {
    Kernel::new(
        "hash_read",
        &[HASH, Text(include_str!("shaders/hash_read.wgsl"))],
        &[(0, Read), (1, Read), (2, Parameters), (4, Write), (5, Read), (9, Read)],
    )
    .with(&constants(features, points))
}

/// Returns the kernel that adds up the gradients of entries.
fn add(features: u32, points: &Points<f32>, addition: Addition) -> Kernel {
    let kernel = addition.kernel(
        "hash_add",
        &[HASH, Text(include_str!("shaders/hash_add.wgsl"))],
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (5, Read), (9, Read)],
    );
    kernel.with(&constants(features, points))
}

/// The levels, and the sums of the gradients of their entries.
pub(crate) struct Grid {
    gpu: Arc<Gpu>,
    points: Points<f32>,
    levels: Buffer<Level>,
    /// Number of levels, and number of levels in use, coarse to fine.
    count: u32,
    active: u32,
    stride: u32,
    prepare: Pipeline,
    read: Pipeline,
    /// Sums of gradients for the table, up to the next slot.
    sums: Scatter,
}

impl Grid {
    fn params(&self, counter: u32) -> Params {
        Params { levels: self.active, stride: self.stride, counter }
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
        let features = grid.features as u32;
        let points = Points::new(&config.hash_grid, &Aabb::new(&config.scene));
        let add = add(features, &points, addition);
        Self {
            gpu: Arc::clone(gpu),
            levels,
            count: grid.levels.len() as u32,
            active: grid.levels.len() as u32,
            stride: encoders::stride(config) as u32,
            prepare: gpu.pipeline(prepare()),
            read: gpu.pipeline(read(features, &points)),
            sums: Scatter::new(gpu, add, addition, training, length, skipped),
            points,
        }
    }

    fn grow(&mut self, stage: u32) {
        self.active = self.count.saturating_sub(stage);
    }

    fn forward(&self, parameters: &Buffer<f32>, at: &Places, context: &Buffer<f32>, features: &Buffer<f32>) {
        let (table, rows) = (parameters.part(0, self.sums.length()), &at.rows);
        if !self.points.is_plain() {
            let binds = [
                whole(&at.rays),
                whole(&at.owners),
                whole(&at.intervals),
                context.bind(),
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
            self.gpu.dispatch(&self.prepare, &binds, &preparing, rows.dispatch(points, GROUP));
        }
        let places = if self.points.is_plain() { whole(&at.spheres) } else { context.bind() };
        let binds = [table, places, features.bind(), rows.bind(), self.levels.bind()];
        let size = rows.dispatch(self.active, GROUP);
        self.gpu.dispatch(&self.read, &binds, &self.params(rows.counter), size);
    }

    fn reduce(
        &mut self,
        partials: impl Iterator<Item = FeatureGradients>,
        _: &Buffer<f32>,
        parameter_gradient: &Buffer<f32>,
    ) {
        self.sums.clear(parameter_gradient);
        for from in partials {
            let rows = &from.at.rows;
            let places = if self.points.is_plain() { &from.at.spheres } else { &from.context };
            let work = (&self.params(rows.counter), rows.dispatch(self.active, GROUP));
            self.sums.add(&from, places, parameter_gradient, &[self.levels.bind()], work);
        }
        self.sums.to_float(parameter_gradient);
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
        let of = |(f, points): (u32, Points<f32>)| {
            let adding = super::scatter::ADDITIONS.map(|way| add(f, &points, way));
            adding.into_iter().chain([read(f, &points)])
        };
        variants.flat_map(of).chain([super::scatter::to_float(), prepare()]).collect()
    }
}
