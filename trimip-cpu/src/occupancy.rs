//! The occupancy grid on the CPU: one bit per cell, in words of 4×4×4 cells, and the distance field that lets ray
//! marching skip empty space.

use crate::buffer::Buffer;
use crate::distance::distances as fill_distances;
use crate::{CpuBackend, WorkerScratch};
use rayon::prelude::*;
use std::ops::Range;
use trimip_core::Config;
use trimip_core::engine::backend::Occupancy;
use trimip_core::engine::batch::{Radiance, Rays, Samples};
use trimip_core::engine::policy::OccupancyPolicy;
use trimip_core::geometry::occupancy::{coordinates, decayed, mean, threshold};
use trimip_core::math::bits;

/// Number of cells along a side of a block.
const BLOCK: u32 = 4;

/// The occupancy grid: the running densities of its cells, their bits, and the distance field.
pub struct CpuOccupancy {
    policy: OccupancyPolicy,
    densities: Vec<f32>,
    /// Block (x, y, z) has index x + B·(y + B·z) for B blocks along a side. Within a block, cell (x, y, z) has bit x +
    /// 4·(y + 4·z).
    blocks: Vec<u64>,
    /// Chebyshev distance of each cell to the nearest occupied cell, in cells, at most 255.
    distances: Vec<u8>,
    occupied: usize,
    chosen: Vec<u32>,
}

impl CpuOccupancy {
    /// Creates a grid in which every cell is occupied.
    pub fn new(config: &Config) -> Self {
        let policy = OccupancyPolicy::new(config);
        let cells = policy.cells() as usize;
        let mut grid = Self {
            policy,
            densities: vec![0.0; cells],
            blocks: vec![0; cells / (BLOCK * BLOCK * BLOCK) as usize],
            distances: Vec::new(),
            occupied: 0,
            chosen: Vec::new(),
        };
        grid.set_bits(|_| true);
        grid
    }

    /// Returns the number of cells along a side.
    #[inline]
    pub fn resolution(&self) -> u32 {
        self.policy.resolution()
    }

    /// Returns the Chebyshev distance of a cell to the nearest occupied cell, 0 if the cell itself is occupied.
    /// Marching may skip all cells that are closer than this distance.
    #[inline(always)]
    pub fn empty_around(&self, [x, y, z]: [u32; 3]) -> u32 {
        let side = self.policy.resolution();
        self.distances[(x + side * (y + side * z)) as usize].into()
    }

    /// Returns the running maximum of the density of a cell, see [`decayed`]; 0 in a model that is only rendered.
    #[inline(always)]
    pub fn density(&self, [x, y, z]: [u32; 3]) -> f32 {
        let side = self.policy.resolution();
        self.densities[(x + side * (y + side * z)) as usize] / self.policy.step_length
    }

    /// Returns the block index and the bit index of a cell.
    fn place(&self, cell: u32) -> (usize, u32) {
        let blocks = self.policy.resolution() / BLOCK;
        let [x, y, z] = coordinates(cell, self.policy.resolution());
        let block = x / BLOCK + blocks * (y / BLOCK + blocks * (z / BLOCK));
        (block as usize, bit_of([x, y, z]))
    }

    fn is_occupied(&self, cell: u32) -> bool {
        let (block, bit) = self.place(cell);
        self.blocks[block] >> bit & 1 == 1
    }

    fn cells(&self) -> u32 {
        self.densities.len() as u32
    }

    /// Sets every cell's bit to `occupied(cell)`.
    fn set_bits(&mut self, occupied: impl Fn(u32) -> bool + Sync) {
        let (resolution, blocks) = (self.policy.resolution(), self.policy.resolution() / BLOCK);
        self.blocks.par_iter_mut().enumerate().for_each(|(i, word)| {
            let corner = coordinates(i as u32, blocks).map(|c| c * BLOCK);
            *word = 0;
            for bit in 0..64 {
                let [x, y, z] = [bit % BLOCK, bit / BLOCK % BLOCK, bit / (BLOCK * BLOCK)];
                let cell = corner[0] + x + resolution * (corner[1] + y + resolution * (corner[2] + z));
                *word |= u64::from(occupied(cell)) << bit;
            }
        });
        let mut distances = std::mem::take(&mut self.distances);
        distances.resize((resolution as usize).pow(3), 0);
        distances.par_chunks_mut(resolution as usize).enumerate().for_each(|(i, row)| {
            let first = i as u32 * resolution;
            for (cell, distance) in (first..).zip(row) {
                *distance = if self.is_occupied(cell) { 0 } else { 255 };
            }
        });
        fill_distances(&mut distances, resolution as usize);
        self.distances = distances;
        self.occupied = self.blocks.iter().map(|word| word.count_ones() as usize).sum();
    }
}

/// Returns the bit index of a cell within its block.
#[inline(always)]
fn bit_of([x, y, z]: [u32; 3]) -> u32 {
    x % BLOCK + BLOCK * (y % BLOCK + BLOCK * (z % BLOCK))
}

impl Occupancy<CpuBackend> for CpuOccupancy {
    fn select(&mut self, step: u64) -> u32 {
        let choice = self.policy.choice(step, self.occupied);
        let chosen: Vec<u32> = (0..self.cells())
            .into_par_iter()
            .filter(|&cell| self.densities[cell as usize] >= 0.0)
            .filter(|&cell| choice.includes(cell, self.is_occupied(cell)))
            .collect();
        self.chosen = chosen;
        self.chosen.len() as u32
    }

    fn probes(
        &self,
        _: &mut WorkerScratch,
        step: u64,
        range: Range<u32>,
        rays: &mut Rays<CpuBackend>,
        samples: &mut Samples<CpuBackend>,
    ) {
        let cells = &self.chosen[range.start as usize..range.end as usize];
        rays.rays.resize(cells.len());
        samples.rays.resize(cells.len());
        samples.intervals.resize(cells.len());
        samples.spheres.resize(cells.len());
        for (i, &cell) in cells.iter().enumerate() {
            let (ray, interval, sphere) = self.policy.probe(cell, step);
            samples.rays[i] = i as u32;
            (rays.rays[i], samples.intervals[i], samples.spheres[i]) = (ray, interval, sphere);
        }
    }

    fn update(&mut self, radiance: &Buffer<Radiance>) {
        for (&cell, radiance) in self.chosen.iter().zip(radiance.iter()) {
            let density = &mut self.densities[cell as usize];
            let new = radiance.density * self.policy.step_length;
            *density = decayed(*density, new, self.policy.settings.decay);
        }
        let limit = threshold(mean(&self.densities), &self.policy.settings);
        let densities = std::mem::take(&mut self.densities);
        self.set_bits(|cell| densities[cell as usize] > limit);
        // If all densities are equal, none is above their mean. Without this rule, such a grid would stay empty.
        if self.occupied == 0 {
            self.set_bits(|cell| densities[cell as usize] >= 0.0);
        }
        self.densities = densities;
    }

    fn occupied(&self) -> f64 {
        self.occupied as f64 / self.densities.len() as f64
    }

    fn densities(&self) -> Vec<f32> {
        self.densities.clone()
    }

    fn bits(&self) -> Vec<u8> {
        bits::of(self.densities.len(), |cell| self.is_occupied(cell as u32))
    }

    fn restore(&mut self, bits: &[u8], densities: Option<&[f32]>) {
        self.set_bits(|cell| bits::is_set(bits, cell as usize));
        if let Some(densities) = densities {
            self.densities.copy_from_slice(densities);
        }
    }
}
