//! The occupancy grid on the GPU. Densities, bits and the list of selected cells leave the device only for
//! checkpoints.

use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Text};
use crate::gpu::{Buffer, GRID, GROUP, Gpu, Kernel, Size};
use crate::shaders::{BLOCKS, RANDOM, SIDE, SUM};
use crate::space::{GpuSpace, SPACE};
use crate::workspace::{DeviceCounters, Stream, WgpuBackend};
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use trimip_core::Config;
use trimip_core::engine::backend::Occupancy;
use trimip_core::engine::batch::{Radiance, Rays, Samples};
use trimip_core::engine::policy::OccupancyPolicy;
use trimip_core::geometry::occupancy::coordinates;
use trimip_core::math::bits;
use trimip_core::math::rng::Sequence;

/// Indices of the counters in `state`: selected cells, occupied cells, and cells that a tile queries.
const CHOSEN: u32 = 0;
pub const OCCUPIED: u32 = 1;
const ASKED: u32 = 2;

shared! {
    /// Parameters of the occupancy grid.
    struct Params as Params {
        space: GpuSpace,
        cell_draws: [u32; 4],
        point_draws: [u32; 4],
        cells: u32,
        fraction: f32,
        /// Index of the tile's first selected cell, and maximum number of cells of the tile.
        first: u32,
        capacity: u32,
        radius: f32,
        step_length: f32,
        decay: f32,
        threshold: f32,
        /// Number of workgroups that sum densities.
        blocks: u32,
        /// Number of cells inside the visual hull; cells outside have a negative density.
        inside: u32,
    }
}

const OCCUPANCY: [Source; 10] = [
    GRID,
    RANDOM,
    SPACE,
    BLOCKS,
    SUM,
    Source::of::<Params>(),
    Source::whole("CHOSEN", CHOSEN),
    Source::whole("OCCUPIED", OCCUPIED),
    Source::whole("ASKED", ASKED),
    Text(include_str!("shaders/occupancy.wgsl")),
];

kernels! {
    /// The kernels of the occupancy grid.
    pub struct Kernels {
        /// Selects cells.
        choose: Kernel::new(
            "choose",
            &OCCUPANCY,
            &[(0, Write), (1, Write), (2, Parameters), (3, Write), (6, Write)],
        ),
        /// Places a sample in each selected cell.
        probes: Kernel::new(
            "probes",
            &OCCUPANCY,
            &[(0, Write), (2, Parameters), (3, Write), (4, Write), (8, Write), (9, Write), (10, Write)],
        ),
        /// Updates the running densities.
        absorb: Kernel::new(
            "absorb",
            &OCCUPANCY,
            &[(0, Write), (2, Parameters), (3, Write), (5, Read), (6, Write)],
        ),
        sum_densities: Kernel::new("sum_densities", &OCCUPANCY, &[(2, Parameters), (6, Write), (7, Write)]),
        /// Computes the threshold.
        find_threshold: Kernel::new("find_threshold", &OCCUPANCY, &[(0, Write), (2, Parameters), (7, Write)]),
        set_bits: Kernel::new(
            "set_bits",
            &OCCUPANCY,
            &[(0, Write), (1, Write), (2, Parameters), (6, Write), (7, Write)],
        ),
        fill_if_empty: Kernel::new(
            "fill_if_empty",
            &OCCUPANCY,
            &[(0, Write), (1, Write), (2, Parameters), (6, Write)],
        ),
        set_outer_bits: Kernel::new("set_outer_bits", &OCCUPANCY, &[(0, Write), (1, Write), (2, Parameters)]),
    }
}

/// The occupancy grid: the running densities of its cells, and their bits.
pub struct WgpuOccupancy {
    gpu: Arc<Gpu>,
    kernels: Kernels,
    policy: OccupancyPolicy,
    params: Params,
    /// Number of samples that fit into a tile.
    capacity: usize,
    state: Buffer<u32>,
    /// The bits: two words per block of cells, then two words per block of blocks.
    grid: Buffer<u32>,
    chosen: Buffer<u32>,
    densities: Buffer<f32>,
    partial: Buffer<f32>,
    counters: Arc<DeviceCounters>,
}

impl WgpuOccupancy {
    /// Creates a grid in which every cell is occupied.
    pub fn new(
        gpu: &Arc<Gpu>,
        config: &Config,
        training: bool,
        capacity: usize,
        counters: Arc<DeviceCounters>,
    ) -> Self {
        let policy = OccupancyPolicy::new(config);
        let cells = policy.cells();
        let params = Params {
            space: GpuSpace::new(&policy.space, policy.resolution()),
            cells,
            radius: policy.radius,
            step_length: policy.step_length,
            decay: policy.settings.decay,
            threshold: policy.settings.threshold,
            blocks: cells.div_ceil(GROUP),
            inside: cells,
            ..Params::default()
        };
        let kept = if training { cells as usize } else { 1 };
        let mut grid = Self {
            gpu: Arc::clone(gpu),
            kernels: Kernels::new(gpu),
            policy,
            params,
            capacity,
            state: Buffer::zeros(gpu, 4),
            grid: Buffer::zeros(gpu, 0),
            chosen: Buffer::zeros(gpu, kept),
            densities: Buffer::zeros(gpu, kept),
            partial: Buffer::zeros(gpu, params.blocks as usize),
            counters,
        };
        grid.set_bits(|_| true);
        grid
    }

    /// Returns the number of cells along a side.
    pub fn resolution(&self) -> u32 {
        self.params.space.resolution
    }

    /// Returns the bits, for ray marching: two words per block of cells, then two words per block of blocks.
    pub fn grid(&self) -> &Buffer<u32> {
        &self.grid
    }

    /// Returns the counters: selected cells, occupied cells, and cells that a tile queries.
    pub fn state(&self) -> &Buffer<u32> {
        &self.state
    }

    /// Returns the block index and the bit index of a cell.
    fn place(&self, cell: u32) -> (usize, u32) {
        place(coordinates(cell, self.params.space.resolution), self.params.space.resolution / SIDE)
    }

    /// Sets every cell's bit to `occupied(cell)`.
    fn set_bits(&mut self, occupied: impl Fn(u32) -> bool) {
        let blocks = self.params.space.resolution / SIDE;
        let outer = blocks.div_ceil(SIDE);
        let inner_words = 2 * (blocks as usize).pow(3);
        let mut words = vec![0_u32; inner_words + 2 * (outer as usize).pow(3)];
        let mut count = 0;
        for cell in (0..self.params.cells).filter(|&cell| occupied(cell)) {
            let (block, bit) = self.place(cell);
            words[2 * block + bit as usize / 32] |= 1 << (bit % 32);
            let (outer_block, bit) = place(coordinates(block as u32, blocks), outer);
            words[inner_words + 2 * outer_block + bit as usize / 32] |= 1 << (bit % 32);
            count += 1;
        }
        self.grid.write(&words);
        self.state.write(&[0, count, 0, 0]);
        self.counters.occupied.store(count.into(), Ordering::Relaxed);
    }
}

/// Returns the index of the block that contains `at`, and the bit index within the block. Blocks have side four, and
/// there are `blocks` blocks along each side.
fn place(at: [u32; 3], blocks: u32) -> (usize, u32) {
    let [x, y, z] = at.map(|c| c / SIDE);
    let [bx, by, bz] = at.map(|c| c % SIDE);
    ((x + blocks * (y + blocks * z)) as usize, bx + SIDE * (by + SIDE * bz))
}

impl Occupancy<WgpuBackend> for WgpuOccupancy {
    fn select(&mut self, step: u64) -> u32 {
        self.params.fraction = self.policy.fraction(step);
        self.params.cell_draws = self.policy.random.at(Sequence::Cell, step).words();
        self.gpu.clear(self.state.raw(), u64::from(4 * CHOSEN), 4);
        let binds = [self.state.bind(), self.grid.bind(), self.chosen.bind(), self.densities.bind()];
        self.gpu.dispatch(&self.kernels.choose, &binds, &self.params, Size::Items(self.params.cells.into()));
        // The number of selected cells is stored on the device; this is its upper bound.
        self.params.cells
    }

    fn probes(
        &self,
        _: &mut Stream,
        step: u64,
        range: Range<u32>,
        rays: &mut Rays<WgpuBackend>,
        samples: &mut Samples<WgpuBackend>,
    ) {
        let (capacity, state) = (range.len().min(self.capacity), self.state.raw());
        rays.rays.count_by(capacity, state, ASKED, 1);
        samples.rays.count_by(capacity, state, ASKED, 1);
        samples.intervals.count_by(capacity, state, ASKED, 1);
        samples.spheres.count_by(capacity, state, ASKED, 1);
        let params = Params {
            point_draws: self.policy.random.at(Sequence::Point, step).words(),
            first: range.start,
            capacity: capacity as u32,
            ..self.params
        };
        let binds = [
            self.state.bind(),
            self.chosen.bind(),
            samples.spheres.bind(),
            rays.rays.bind(),
            samples.rays.bind(),
            samples.intervals.bind(),
        ];
        self.gpu.dispatch(&self.kernels.probes, &binds, &params, Size::Items(capacity as u64));
    }

    fn update(&mut self, radiance: &Buffer<Radiance>) {
        let Self { gpu, kernels, params, state, grid, chosen, densities, partial, .. } = self;
        let cells = Size::Items(params.cells.into());
        let binds = [state.bind(), chosen.bind(), radiance.bind(), densities.bind()];
        gpu.dispatch(&kernels.absorb, &binds, params, cells);
        gpu.dispatch(&kernels.sum_densities, &[densities.bind(), partial.bind()], params, cells);
        gpu.dispatch(&kernels.find_threshold, &[state.bind(), partial.bind()], params, Size::Groups(1));
        let blocks = u64::from(params.space.resolution / SIDE).pow(3);
        let binds = [state.bind(), grid.bind(), densities.bind(), partial.bind()];
        gpu.dispatch(&kernels.set_bits, &binds, params, Size::Items(blocks));
        let binds = [state.bind(), grid.bind(), densities.bind()];
        gpu.dispatch(&kernels.fill_if_empty, &binds, params, Size::Items(blocks));
        let binds = [state.bind(), grid.bind()];
        gpu.dispatch(&kernels.set_outer_bits, &binds, params, Size::Items(blocks));
    }

    fn occupied(&self) -> f64 {
        self.counters.occupied.load(Ordering::Relaxed) as f64 / f64::from(self.params.cells)
    }

    fn densities(&self) -> Vec<f32> {
        self.densities.read()
    }

    fn bits(&self) -> Vec<u8> {
        let words = self.grid.read();
        bits::of(self.params.cells as usize, |cell| {
            let (block, bit) = self.place(cell as u32);
            words[2 * block + bit as usize / 32] >> (bit % 32) & 1 == 1
        })
    }

    fn restore(&mut self, bits: &[u8], densities: Option<&[f32]>) {
        self.set_bits(|cell| bits::is_set(bits, cell as usize));
        if let Some(densities) = densities {
            self.params.inside = densities.iter().filter(|density| **density >= 0.0).count().max(1) as u32;
            self.densities.write(densities);
        }
    }
}
