//! The CPU backend: buffers are plain memory, tiles run on rayon workers, partial gradients are added up in order.

use crate::buffer::{Buffer, take_mut};
use crate::encoder::CpuEncoder;
use crate::field::CpuField;
use crate::loss::CpuLoss;
use crate::occupancy::CpuOccupancy;
use crate::optimizer::CpuOptimizer;
use crate::poses::CpuPoses;
use crate::renderer::CpuRenderer;
use crate::sampler::CpuSampler;
use crate::{CpuBackend, WorkerScratch};
use bytemuck::Pod;
use rayon::prelude::*;
use std::any::TypeId;
use std::ops::Range;
use trimip_core::config::Precision;
use trimip_core::engine::backend::{Stages, TrainWork};
use trimip_core::engine::batch::{Batch, PartialGradients, StepResult, Tiling, Update, Workspace};
use trimip_core::{Backend, Config, Encoder, Error, Field, Layout, Optimizer, Pixel, Result, ViewSet};

/// Approximate number of samples that share a set of partial gradients. Weight gradients are summed over the sets at the end of a
/// step.
const SAMPLES_PER_DEPOSIT: u32 = 1024;

/// Returns the number of sets of partial gradients for a step of `samples` samples: enough sets to balance the load of
/// many cores.
pub fn partials(samples: u32) -> usize {
    (samples / SAMPLES_PER_DEPOSIT).clamp(16, 256) as usize
}

impl CpuBackend {
    /// Returns the precision of the networks' products: bf16 if it is configured and the processor has bf16
    /// instructions or emulation is allowed; otherwise f32.
    fn precision(&self, config: &Config) -> Precision {
        match config.field.precision {
            Precision::Bf16 if self.emulates_bf16 || self.simd.has_bf16() => Precision::Bf16,
            Precision::F32 | Precision::Bf16 | Precision::F16 => Precision::F32,
        }
    }

    /// Runs `work` with a workspace that no other worker uses.
    fn with_workspace(&self, field: &CpuField, work: impl FnOnce(&mut Workspace<Self>)) {
        let pooled = self.workspaces.lock().ok().and_then(|mut pool| pool.pop());
        let mut workspace = pooled.unwrap_or_else(|| Workspace::new(self, field));
        work(&mut workspace);
        if let Ok(mut pool) = self.workspaces.lock() {
            pool.push(workspace);
        }
    }
}

/// Minimum number of jobs per thread, if there are enough tiles.
const SHARES: usize = 64;

impl Backend for CpuBackend {
    type Buffer<T: Pod + Send + Sync> = Buffer<T>;
    type Stream = WorkerScratch;
    type Sums = StepResult;
    type Receipt = StepResult;
    type Encoder = CpuEncoder;
    type Field = CpuField;
    type Renderer = CpuRenderer;
    type Optimizer = CpuOptimizer;
    type Sampler = CpuSampler;
    type Occupancy = CpuOccupancy;
    type Loss = CpuLoss;
    type Poses = CpuPoses;

    fn name(&self) -> &'static str {
        "cpu"
    }

    fn device_name(&self) -> String {
        let threads = self.pool.current_num_threads();
        format!("{}, {}", self.simd, trimip_core::plural::count(threads, "thread"))
    }

    fn notes(&self, config: &Config) -> Vec<String> {
        match config.field.precision {
            Precision::F16 => vec!["field.precision = \"f16\" is for GPUs: the CPU computes in f32".into()],
            Precision::Bf16 if self.precision(config) == Precision::F32 => vec![
                "field.precision = \"bf16\" is no faster than f32 on this processor: the CPU computes in f32"
                    .into(),
            ],
            Precision::F32 | Precision::Bf16 => Vec::new(),
        }
    }

    fn stages(&self, config: &Config, views: Option<ViewSet>) -> Result<Stages<Self>> {
        let layout = Layout::new(config);
        let training = views.is_some();
        if let Some(scale) = views.iter().flat_map(|v| &v.scales).find(|s| s.pixels.len() > u32::MAX as usize)
        {
            return Err(Error::input(
                "training views",
                format!("{} pixels at scale 1/{}", scale.pixels.len(), scale.factor),
                "lower data.most_pixels: a scale has at most 2^32 pixels",
            ));
        }
        Ok(Stages {
            encoder: CpuEncoder::new(self.simd, config, training),
            field: CpuField::new(self.simd, config, &layout, self.precision(config)),
            renderer: CpuRenderer::new(self.simd, config),
            optimizer: CpuOptimizer::new(self.simd, config, &layout, training),
            poses: CpuPoses::new(config, views.as_ref()),
            sampler: CpuSampler::new(config, views),
            occupancy: CpuOccupancy::new(config),
            loss: CpuLoss::new(config)?,
        })
    }

    fn stream(&self) -> WorkerScratch {
        WorkerScratch::default()
    }

    fn zeros<T: Pod + Send + Sync>(&self, length: usize) -> Buffer<T> {
        Buffer::zeros(length)
    }

    fn write<T: Pod + Send + Sync>(&self, buffer: &mut Buffer<T>, values: &[T]) {
        buffer.resize(values.len());
        buffer.copy_from_slice(values);
    }

    fn read<T: Pod + Send + Sync>(&self, buffer: &Buffer<T>) -> Vec<T> {
        buffer.to_vec()
    }

    fn look<T: Pod + Send + Sync, R>(&self, buffer: &Buffer<T>, look: impl FnOnce(&[T]) -> R) -> R {
        look(buffer)
    }

    fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R {
        self.pool.install(work)
    }

    fn train_tiles(
        &self,
        field: &CpuField,
        batch: &Batch<'_>,
        partials: &mut [PartialGradients<Self>],
        work: &TrainWork<'_, Self>,
    ) {
        let Batch { allocation, this_rank, per_tile } = *batch;
        let count = partials.len() as u64;
        let bound = |i: u64| (u64::from(allocation.cones()) * i / count) as u32;
        let parts = field.reduction_tree(partials.len());
        let own: Vec<_> = partials.iter_mut().enumerate().filter(|(i, _)| parts.has(this_rank, *i)).collect();
        own.into_par_iter().with_max_len(1).for_each(|(i, partial)| {
            let (from, to) = (bound(i as u64), bound(i as u64 + 1));
            self.with_workspace(field, |workspace| {
                for start in (from..to).step_by(per_tile as usize) {
                    let tile =
                        allocation.pixel_from(start)..allocation.pixel_from((start + per_tile).min(to));
                    if !tile.is_empty() {
                        work(workspace, partial, tile);
                    }
                }
            });
        });
    }

    fn map_tiles<T: Pod + Send + Sync>(
        &self,
        field: &CpuField,
        tiling: Tiling,
        out: &mut Buffer<T>,
        work: &(dyn Fn(&mut Workspace<Self>, Range<u32>) + Sync),
        result: &(dyn Fn(&Workspace<Self>) -> &Buffer<T> + Sync),
    ) {
        let Tiling { count, per_tile } = tiling;
        // Rays are processed in groups, because a ray has hundreds of samples or none. A probe has exactly one sample.
        let rays = TypeId::of::<T>() == TypeId::of::<Pixel>();
        out.resize(count as usize);
        // A job covers up to 8 adjacent tiles; fewer, if threads would otherwise wait long for the last job.
        let tiles = count.div_ceil(per_tile) as usize;
        let most = (tiles / (SHARES * rayon::current_num_threads())).clamp(1, 8);
        out.par_chunks_mut(per_tile as usize).enumerate().with_max_len(most).for_each(|(i, mut out)| {
            let mut start = i as u32 * per_tile;
            self.with_workspace(field, |workspace| {
                while !out.is_empty() {
                    let most = if rays { workspace.stream.pixels_at_once() } else { out.len() };
                    let count = most.min(out.len());
                    let now = take_mut(&mut out, count);
                    let end = start + now.len() as u32;
                    work(workspace, start..end);
                    now.copy_from_slice(result(workspace));
                    if rays {
                        workspace.stream.saw(&workspace.rays.groups, &workspace.samples.segments);
                    }
                    start = end;
                }
            });
        });
    }

    fn update(&self, stages: &mut Stages<Self>, update: &mut Update<'_, Self>) {
        if !stages.optimizer.policy().skips_untouched() || self.weight(update.partials) <= 0.0 {
            return self.update_all(stages, update);
        }
        let touched = stages.encoder.touched();
        stages.optimizer.step_within(update, touched);
        stages.encoder.refresh_touched(update.parameters);
        stages.field.refresh(update.parameters);
    }

    fn update_all(&self, stages: &mut Stages<Self>, update: &mut Update<'_, Self>) {
        if self.weight(update.partials) > 0.0 {
            stages.optimizer.step(update);
            stages.encoder.refresh(update.parameters);
            stages.field.refresh(update.parameters);
        }
    }

    fn weight(&self, partials: &[PartialGradients<Self>]) -> f64 {
        partials.iter().map(|partial| partial.sums.sums.weight).sum()
    }

    fn set_weight(&self, partials: &mut [PartialGradients<Self>], weight: f64) {
        for (i, partial) in partials.iter_mut().enumerate() {
            partial.sums.sums.weight = if i == 0 { weight } else { 0.0 };
        }
    }

    fn partials(&self, samples: u32) -> usize {
        partials(samples)
    }

    fn post(&self, partials: &[PartialGradients<Self>]) -> StepResult {
        let mut result = StepResult::default();
        for partial in partials {
            result.add(&partial.sums);
        }
        result
    }

    fn redeem(&self, result: StepResult) -> Result<StepResult> {
        Ok(result)
    }
}
