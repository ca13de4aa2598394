//! The GPU backend. All stages record into one submission, a step is one tile, and sums are read once they are
//! available.

use crate::capacity::{Capacity, LEAST_CAPACITY};
use crate::encoder::WgpuEncoder;
use crate::field::WgpuField;
use crate::gpu::{Buffer, Receipt, lock};
use crate::loss::{SUMS, Sums, WgpuLoss, sums_of};
use crate::losses::{GAIN_WORDS, SUM_WORDS};
use crate::occupancy::{OCCUPIED, WgpuOccupancy};
use crate::optimizer::WgpuOptimizer;
use crate::poses::{self, WgpuPoses};
use crate::renderer::WgpuRenderer;
use crate::sampler::WgpuSampler;
use crate::tiles::Tiles;
use crate::workspace::{Stream, WgpuBackend};
use bytemuck::Pod;
use std::ops::Range;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use trimip_core::config::Precision;
use trimip_core::engine::backend::{Stages, TrainWork};
use trimip_core::engine::batch::{Batch, PartialGradients, StepResult, StepSums, Tiling, Workspace};
use trimip_core::{Backend, Config, Error, Layout, Result, ViewSet};

/// Number of iterations after which llvmpipe ends the loops of an invocation, minus a margin for the other loops of the
/// invocation.
const SOFTWARE_ROUNDS: usize = 60_000;

/// Byte offset of the sum of the loss weights within a step's sums.
const WEIGHT_AT: u64 = 4;

/// Number of marched samples that the training loop plans for one tile.
const SAMPLES_PER_TILE: usize = 512;

/// Maximum number of pixels or probes in the first tile, when their number of samples is not yet known.
const MOST_AT_FIRST: usize = 1 << 18;

impl WgpuBackend {
    fn with_workspace(&self, field: &WgpuField, work: impl FnOnce(&mut Workspace<Self>)) {
        let mut workspace = self.take_workspace(field);
        work(&mut workspace);
        self.keep_workspace(workspace);
    }

    fn take_workspace(&self, field: &WgpuField) -> Workspace<Self> {
        let pooled = lock(&self.workspaces).pop();
        pooled.unwrap_or_else(|| Workspace::new(self, field))
    }

    fn keep_workspace(&self, workspace: Workspace<Self>) {
        lock(&self.workspaces).push(workspace);
    }

    /// Returns the tiles that `count` items are divided into.
    fn tiles(&self, count: u32, per_tile: u32) -> Tiles {
        let capacity = *lock(&self.capacity);
        let chunk = (per_tile as usize * (capacity / SAMPLES_PER_TILE).max(1)).min(count as usize);
        let chunk = chunk.min(MOST_AT_FIRST) as u32;
        Tiles::new(count, chunk, capacity)
    }

    /// Copies a tile's results into the result array.
    fn gather<T: Pod + Send + Sync>(&self, from: &Buffer<T>, tile: Range<u32>, to: &Buffer<T>) {
        let bytes = |values: u32| u64::from(values) * size_of::<T>() as u64;
        self.gpu.copy(from.raw(), 0, to.raw(), bytes(tile.start), bytes(tile.end - tile.start));
    }
}

/// A pending transfer of a step's sums to the host.
pub struct StepReceipt {
    sums: Receipt<u32>,
    exposures: Option<Receipt<u32>>,
    cameras: Option<Receipt<u32>>,
    watched: Option<[Receipt<u32>; 2]>,
    rays: u32,
}

impl Backend for WgpuBackend {
    type Buffer<T: Pod + Send + Sync> = Buffer<T>;
    type Stream = Stream;
    type Sums = Sums;
    type Receipt = Option<StepReceipt>;
    type Encoder = WgpuEncoder;
    type Field = WgpuField;
    type Renderer = WgpuRenderer;
    type Optimizer = WgpuOptimizer;
    type Sampler = WgpuSampler;
    type Occupancy = WgpuOccupancy;
    type Loss = WgpuLoss;
    type Poses = WgpuPoses;

    const LAG: usize = 2;
    const RAYS_OF_A_BAND: u32 = 1 << 18;

    fn name(&self) -> &'static str {
        "wgpu"
    }

    fn longest_ray(&self) -> usize {
        if self.gpu.is_software() { SOFTWARE_ROUNDS } else { usize::MAX }
    }

    fn device_name(&self) -> String {
        self.gpu.name()
    }

    fn notes(&self, config: &Config) -> Vec<String> {
        match config.field.precision {
            Precision::F32 => Vec::new(),
            Precision::F16 if self.gpu.matrices().is_some() => {
                match self.counters.overflows.load(Ordering::Relaxed) {
                    0 => Vec::new(),
                    count => vec![format!(
                        "field.precision = \"f16\": {count} numbers were too large for f16, the run continues in f32"
                    )],
                }
            }
            Precision::F16 => vec![format!(
                "field.precision = \"f16\": {} has no cooperative matrices of f16 with sums of f32: networks are computed in f32",
                self.gpu.name()
            )],
            Precision::Bf16 => {
                vec!["field.precision = \"bf16\" is for CPUs: the GPU computes in f32, or in \"f16\"".into()]
            }
        }
    }

    fn stages(&self, config: &Config, views: Option<ViewSet>) -> Result<Stages<Self>> {
        let layout = Layout::new(config);
        let training = views.is_some();
        let (steps, most) =
            (trimip_core::Space::new(&config.scene).most_steps(config.step_length()) - 2, self.longest_ray());
        if steps > most {
            return Err(Error::input(
                "renderer.steps_per_diagonal",
                format!("{steps}, but {} follows a ray for at most {most} samples", self.gpu.name()),
                "use fewer steps, or backend = \"cpu\"",
            ));
        }
        let binding = self.gpu.limits().max_storage_buffer_binding_size;
        let capacity = Capacity::new(config, training, binding);
        let Capacity { marched, kept } = capacity;
        if marched < LEAST_CAPACITY {
            return Err(Error::input(
                "field.hidden",
                format!(
                    "at a width of {}, only {marched} samples fit into the {binding} bytes that the device binds at once",
                    config.field.hidden
                ),
                format!(
                    "use a smaller field.hidden (a ray may have {LEAST_CAPACITY} samples), or backend = \"cpu\""
                ),
            ));
        }
        *lock(&self.capacity) = marched;
        let gpu = &self.gpu;
        let occupancy = WgpuOccupancy::new(gpu, config, training, marched, Arc::clone(&self.counters));
        self.counters.overflows.store(0, Ordering::Relaxed);
        let field = WgpuField::new(gpu, config, &layout, Arc::clone(&self.counters));
        *lock(&self.watched) = Some([occupancy.state().raw().clone(), field.overflows().raw().clone()]);
        let skipped = Buffer::zeros(gpu, 1);
        let stages = Stages {
            encoder: WgpuEncoder::new(gpu, config, training, self.addition, &skipped),
            field,
            renderer: WgpuRenderer::new(gpu, config, training, [marched, kept]),
            optimizer: WgpuOptimizer::new(gpu, config, &layout, training, skipped),
            poses: WgpuPoses::new(gpu, config, views.as_ref()),
            sampler: WgpuSampler::new(gpu, config, views)?,
            occupancy,
            loss: WgpuLoss::new(gpu, config)?,
        };
        gpu.submit();
        gpu.check("building the stages")?;
        Ok(stages)
    }

    fn stream(&self) -> Stream {
        Stream::new(&self.gpu)
    }

    fn zeros<T: Pod + Send + Sync>(&self, length: usize) -> Buffer<T> {
        Buffer::zeros(&self.gpu, length)
    }

    fn write<T: Pod + Send + Sync>(&self, buffer: &mut Buffer<T>, values: &[T]) {
        buffer.write(values);
    }

    fn read<T: Pod + Send + Sync>(&self, buffer: &Buffer<T>) -> Vec<T> {
        buffer.read()
    }

    async fn read_async<T: Pod + Send + Sync>(&self, buffer: &Buffer<T>) -> Vec<T> {
        buffer.read_async().await
    }

    fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        work()
    }

    fn train_tiles(
        &self,
        field: &WgpuField,
        batch: &Batch<'_>,
        partials: &mut [PartialGradients<Self>],
        work: &TrainWork<'_, Self>,
    ) {
        let Some(partial) = partials.first_mut() else { return };
        self.with_workspace(field, |workspace| {
            work(workspace, partial, batch.this_rank.part(batch.allocation.pixels()));
        });
    }

    fn map_tiles<T: Pod + Send + Sync>(
        &self,
        field: &WgpuField,
        tiling: Tiling,
        out: &mut Buffer<T>,
        work: &(dyn Fn(&mut Workspace<Self>, Range<u32>) + Sync),
        result: &(dyn Fn(&Workspace<Self>) -> &Buffer<T> + Sync),
    ) {
        out.resize(tiling.count as usize);
        let mut tiles = self.tiles(tiling.count, tiling.per_tile);
        self.with_workspace(field, |workspace| {
            while let Some(tile) = tiles.next() {
                workspace.stream.marched = false;
                work(workspace, tile.clone());
                let marched = workspace.stream.marched;
                if tiles.fits(&tile, marched.then(|| workspace.samples.counts.read())) {
                    self.gather(result(workspace), tile, out);
                }
            }
        });
    }

    async fn map_tiles_async<T: Pod + Send + Sync>(
        &self,
        field: &WgpuField,
        tiling: Tiling,
        out: &mut Buffer<T>,
        work: &(dyn Fn(&mut Workspace<Self>, Range<u32>) + Sync),
        result: &(dyn Fn(&Workspace<Self>) -> &Buffer<T> + Sync),
    ) {
        out.resize(tiling.count as usize);
        let mut tiles = self.tiles(tiling.count, tiling.per_tile);
        let mut workspace = self.take_workspace(field);
        while let Some(tile) = tiles.next() {
            workspace.stream.marched = false;
            work(&mut workspace, tile.clone());
            let counts = match workspace.stream.marched {
                true => Some(workspace.samples.counts.read_async().await),
                false => None,
            };
            if tiles.fits(&tile, counts) {
                self.gather(result(&workspace), tile, out);
            }
        }
        self.keep_workspace(workspace);
    }

    fn weight(&self, partials: &[PartialGradients<Self>]) -> f64 {
        let sums = partials.iter().find_map(|partial| partial.sums.0.as_ref());
        sums.map_or(0.0, |sums| self.gpu.redeem(self.gpu.send::<f32>(&sums.buffer, WEIGHT_AT, 1))[0].into())
    }

    fn set_weight(&self, partials: &mut [PartialGradients<Self>], weight: f64) {
        if let Some(sums) = partials.iter().find_map(|partial| partial.sums.0.as_ref()) {
            self.gpu.write_at(&sums.buffer, WEIGHT_AT, &[weight as f32]);
        }
    }

    fn partials(&self, _: u32) -> usize {
        1
    }

    fn post(&self, partials: &[PartialGradients<Self>]) -> Option<StepReceipt> {
        let sums = partials.iter().find_map(|partial| partial.sums.0.as_ref())?;
        let watched = lock(&self.watched);
        Some(StepReceipt {
            sums: self.gpu.send(&sums.buffer, 0, SUMS),
            exposures: sums.exposures.as_ref().map(|(buffer, photographs)| {
                self.gpu.send(buffer, (4 * GAIN_WORDS * photographs) as u64, SUM_WORDS * photographs)
            }),
            cameras: sums
                .cameras
                .as_ref()
                .map(|(buffer, photographs)| self.gpu.send(buffer, 0, poses::SUM_WORDS * photographs)),
            watched: watched.as_ref().map(|[grid, field]| {
                [self.gpu.send(grid, u64::from(4 * OCCUPIED), 1), self.gpu.send(field, 0, 1)]
            }),
            rays: sums.rays,
        })
    }

    fn submit(&self) {
        self.gpu.submit();
    }

    fn redeem(&self, receipt: Option<StepReceipt>) -> Result<StepResult> {
        let Some(StepReceipt { sums, exposures, cameras, watched, rays }) = receipt else {
            return Ok(StepResult::default());
        };
        let words = self.gpu.redeem(sums);
        let [exposures, cameras] =
            [exposures, cameras].map(|sums| sums.map(|sums| self.gpu.redeem(sums)).unwrap_or_default());
        if let Some([occupied, overflows]) = watched {
            self.counters.occupied.store(self.gpu.redeem(occupied)[0].into(), Ordering::Relaxed);
            self.counters.overflows.store(self.gpu.redeem(overflows)[0].into(), Ordering::Relaxed);
        }
        self.gpu.check("a training step")?;
        let float = |i: usize| f64::from(f32::from_bits(words[i]));
        let sums = StepSums {
            loss: float(0),
            weight: float(1),
            squared_error: float(2),
            rays: rays.into(),
            marched: (words[4] + words[6]).into(),
            kept: words[5].into(),
            drawn: words[8].into(),
            non_finite: float(3) as u64,
        };
        Ok(StepResult { sums, exposures: sums_of(&exposures), cameras: sums_of(&cameras) })
    }

    fn health(&self) -> Result<()> {
        self.gpu.check("reading the model back")
    }
}
