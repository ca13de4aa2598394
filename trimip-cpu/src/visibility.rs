//! Evaluates densities front to back. Rays are walked in pieces of a few samples, and a ray that has become opaque is
//! dropped. The kept samples, their features and their densities are bit-identical to those of evaluating all samples
//! and pruning afterwards.

use crate::buffer::Buffer;
use crate::cursor::Cursor;
use crate::gemm::padded;
use crate::hybrid::Hybrid;
use crate::march::advance;
use crate::simd::{Kernel, Lanes};
use crate::worker::{Groups, Rows, Scratch, Walker};
use crate::{CpuBackend, CpuField, WorkerScratch};
use trimip_core::engine::backend::Stages;
use trimip_core::engine::batch::{Interval, Radiance, Rays, Samples, Segment, Sphere, Tile, Workspace};
use trimip_core::engine::policy::RendererPolicy;
use trimip_core::math::compositing::{Pruning, Visibility};
use trimip_core::{Encoder, Field, Renderer};

/// Maximum number of samples in a piece of a ray.
const PIECE: usize = 16;

/// Minimum number of samples in a piece before the densities of the occupancy grid can end the piece.
const LEAST: usize = 4;

impl Rows {
    fn new(field: &CpuField) -> Self {
        let samples = Samples {
            segments: Buffer::zeros(0),
            rays: Buffer::zeros(0),
            intervals: Buffer::zeros(0),
            spheres: Buffer::zeros(0),
            counts: Buffer::zeros(1),
        };
        let (encoder_context, features) = (Buffer::zeros(0), Buffer::zeros(0));
        Self {
            samples,
            encoder_context,
            features,
            field_context: field.context(),
            radiance: Buffer::zeros(0),
        }
    }

    fn clear(&mut self, field: &CpuField) {
        self.samples.rays.clear();
        self.samples.intervals.clear();
        self.samples.spheres.clear();
        self.encoder_context.clear();
        self.features.clear();
        self.radiance.clear();
        field.clear(&mut self.field_context);
    }
}

/// See [`trimip_core::Renderer::visibility_pass`].
pub(crate) fn visibility_pass(
    stages: &Stages<CpuBackend>,
    parameters: &Buffer<f32>,
    workspace: &mut Workspace<CpuBackend>,
    jitter: Option<u64>,
) {
    let mut scratch =
        workspace.stream.scratch.take().unwrap_or_else(|| Box::new(Scratch::new(&stages.field)));
    scratch.start(&stages.renderer.policy, &workspace.rays, jitter);
    let hybrid = stages.renderer.hybrid.as_ref().filter(|_| jitter.is_none());
    let chosen = hybrid.is_some_and(|hybrid| scratch.choose(hybrid, stages, &workspace.rays));
    let marched = if chosen {
        evaluate_chosen(stages, parameters, workspace, &mut scratch.piece.samples)
    } else {
        let marched =
            scratch.walk(&mut workspace.stream, stages, parameters, &workspace.rays, hybrid.is_some());
        scratch.sort_by_ray(stages, workspace);
        marched
    };
    if let Some(hybrid) = hybrid {
        hybrid.blend(&stages.field, workspace, &scratch.sure, &mut scratch.groups);
    }
    workspace.samples.counts.resize(1);
    workspace.samples.counts[0] = [marched as u32, workspace.samples.spheres.len() as u32];
    workspace.stream.scratch = Some(scratch);
}

/// Evaluates the densities of the samples `chosen`, which are ordered by ray, and keeps the visible ones. Returns the
/// number of evaluated samples.
fn evaluate_chosen(
    stages: &Stages<CpuBackend>,
    parameters: &Buffer<f32>,
    workspace: &mut Workspace<CpuBackend>,
    chosen: &mut Samples<CpuBackend>,
) -> usize {
    std::mem::swap(&mut workspace.samples, chosen);
    let count = workspace.samples.spheres.len();
    workspace.samples.counts.resize(1);
    stages.density(parameters, workspace);
    let Workspace { stream, samples, field_context, radiance, kept, .. } = workspace;
    stages.renderer.prune(stream, radiance, samples, kept);
    // Features are not pruned, because only training reads them again.
    if kept.len() < count {
        stages.field.keep(stream, kept, field_context, radiance);
    }
    count
}

impl Scratch {
    fn new(field: &CpuField) -> Self {
        Self {
            walkers: Vec::new(),
            piece: Rows::new(field),
            seen: Buffer::zeros(0),
            staged: Rows::new(field),
            order: Vec::new(),
            sure: Vec::new(),
            groups: Groups::default(),
        }
    }

    /// Places a walker at the start of every ray.
    fn start(&mut self, policy: &RendererPolicy, rays: &Rays<CpuBackend>, jitter: Option<u64>) {
        self.walkers.clear();
        self.walkers.extend(rays.rays.iter().zip(0..).map(|(ray, index)| Walker {
            ray: index,
            cursor: Cursor::new(policy, ray, jitter, rays.first + index),
            passed: policy.pruning.behind(0.0),
            out: false,
        }));
    }

    /// Chooses all samples of every ray and writes them to `piece`. Returns false if some rays are too wide for the
    /// proxy.
    fn choose(&mut self, hybrid: &Hybrid, stages: &Stages<CpuBackend>, rays: &Rays<CpuBackend>) -> bool {
        let (walkers, samples) = (&mut self.walkers, &mut self.piece.samples);
        stages.renderer.simd.run(Choose { hybrid, walkers, stages, rays, samples });
        self.sure.clear();
        self.sure.extend(walkers.iter().map(|walker| walker.out));
        self.sure.iter().all(|sure| *sure)
    }

    /// Walks all rays to their end and collects visible samples in `staged`. Returns the number of evaluated samples.
    /// If `placed` is true, `piece` already holds the first piece.
    fn walk(
        &mut self,
        stream: &mut WorkerScratch,
        stages: &Stages<CpuBackend>,
        parameters: &Buffer<f32>,
        rays: &Rays<CpuBackend>,
        mut placed: bool,
    ) -> usize {
        let Self { walkers, piece, seen, staged, .. } = self;
        let renderer = &stages.renderer;
        staged.clear(&stages.field);
        let mut marched = 0;
        while !walkers.is_empty() {
            if !std::mem::take(&mut placed) {
                renderer.simd.run(PlaceSamples { walkers, stages, rays, samples: &mut piece.samples });
            }
            let samples = &piece.samples;
            marched += samples.spheres.len();
            let tile = &mut Tile { stream: &mut *stream, parameters, rays, samples };
            stages.encoder.forward(tile, &mut piece.encoder_context, &mut piece.features);
            stages.field.density(tile, &piece.features, &mut piece.field_context, &mut piece.radiance);
            look(walkers, &mut piece.samples, &piece.radiance, renderer.policy.pruning, seen);
            let samples = &piece.samples;
            staged.samples.rays.append_rows(&samples.rays, seen, 1);
            staged.samples.intervals.append_rows(&samples.intervals, seen, 1);
            staged.samples.spheres.append_rows(&samples.spheres, seen, 1);
            staged.encoder_context.append_rows(&piece.encoder_context, seen, stages.encoder.context());
            staged.features.append_rows(&piece.features, seen, stages.encoder.stride());
            staged.radiance.append_rows(&piece.radiance, seen, 1);
            stages.field.append(&mut staged.field_context, &piece.field_context, seen);
        }
        marched
    }

    /// Copies the visible samples into the workspace, ray by ray.
    fn sort_by_ray(&mut self, stages: &Stages<CpuBackend>, workspace: &mut Workspace<CpuBackend>) {
        let Self { staged, order, .. } = self;
        let Workspace { rays, samples, encoder_context, features, field_context, radiance, .. } = workspace;
        let segments = &mut samples.segments;
        segments.resize(rays.rays.len());
        segments.fill(Segment::default());
        for &ray in staged.samples.rays.iter() {
            segments[ray as usize].count += 1;
        }
        let mut start = 0;
        for segment in segments.iter_mut() {
            segment.start = start;
            start += std::mem::take(&mut segment.count);
        }
        let count = start as usize;
        order.resize(count, 0);
        for (row, &ray) in staged.samples.rays.iter().enumerate() {
            let segment = &mut segments[ray as usize];
            order[(segment.start + segment.count) as usize] = row as u32;
            segment.count += 1;
        }
        samples.rays.gather_rows(&staged.samples.rays, order, 1, count);
        samples.intervals.gather_rows(&staged.samples.intervals, order, 1, count);
        samples.spheres.gather_rows(&staged.samples.spheres, order, 1, count);
        radiance.gather_rows(&staged.radiance, order, 1, count);
        encoder_context.gather_rows(&staged.encoder_context, order, stages.encoder.context(), count);
        features.gather_rows(&staged.features, order, stages.encoder.stride(), padded(count));
        stages.field.gather(field_context, &staged.field_context, order);
    }
}

/// Places the samples of the next piece of every ray that is being walked; each piece becomes one segment of `samples`. A piece
/// ends where the running densities of the occupancy grid make the ray opaque, so that few samples behind the surface are
/// evaluated. These densities are maxima and may exceed the field's; if the ray is not opaque after all, it continues with
/// another piece.
struct PlaceSamples<'a> {
    walkers: &'a mut [Walker],
    stages: &'a Stages<CpuBackend>,
    rays: &'a Rays<CpuBackend>,
    samples: &'a mut Samples<CpuBackend>,
}

impl Kernel for PlaceSamples<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { walkers, stages, rays, samples } = self;
        let most = walkers.len() * PIECE;
        samples.rays.resize(most);
        samples.intervals.resize(most);
        samples.spheres.resize(most);
        samples.segments.resize(walkers.len());
        let Samples { segments, rays: owners, intervals, spheres, .. } = samples;
        let (owners, intervals, spheres): (&mut [u32], &mut [Interval], &mut [Sphere]) =
            (owners, intervals, spheres);
        let mut count = 0;
        for (walker, segment) in walkers.iter_mut().zip(segments.iter_mut()) {
            let start = count;
            let ray = &rays.rays[walker.ray as usize];
            let mut depth = walker.passed.depth;
            walker.out = advance(
                &stages.renderer.policy,
                ray,
                &stages.occupancy,
                &mut walker.cursor,
                |interval, sphere, cell| {
                    (owners[count], intervals[count], spheres[count]) = (walker.ray, interval, sphere);
                    count += 1;
                    depth += stages.occupancy.density(cell) * interval.length;
                    let own = count - start;
                    own < LEAST || own < PIECE && !(depth > stages.renderer.policy.pruning.max_depth)
                },
            );
            *segment = Segment { start: start as u32, count: (count - start) as u32 };
        }
        samples.rays.resize(count);
        samples.intervals.resize(count);
        samples.spheres.resize(count);
    }
}

/// Chooses all samples of every ray; each ray becomes one segment of `samples`. A ray that is too wide for the proxy
/// gets no samples and is walked afterwards.
struct Choose<'a> {
    hybrid: &'a Hybrid,
    walkers: &'a mut [Walker],
    stages: &'a Stages<CpuBackend>,
    rays: &'a Rays<CpuBackend>,
    samples: &'a mut Samples<CpuBackend>,
}

impl Kernel for Choose<'_> {
    type Output = ();
    #[inline(always)]
    fn run<L: Lanes>(self) {
        let Self { hybrid, walkers, stages, rays, samples } = self;
        samples.rays.clear();
        samples.intervals.clear();
        samples.spheres.clear();
        samples.segments.resize(walkers.len());
        let Samples { segments, rays: owners, intervals, spheres, .. } = samples;
        for (walker, segment) in walkers.iter_mut().zip(segments.iter_mut()) {
            let start = owners.len();
            let ray = &rays.rays[walker.ray as usize];
            walker.out =
                hybrid.choose(&stages.renderer.policy, ray, &stages.occupancy, |interval, sphere| {
                    owners.push(walker.ray);
                    intervals.push(interval);
                    spheres.push(sphere);
                });
            if !walker.out {
                owners.resize(start);
                intervals.resize(start);
                spheres.resize(start);
            }
            *segment = Segment { start: start as u32, count: (owners.len() - start) as u32 };
        }
    }
}

/// Lists the visible samples in `seen`, lengthens their intervals to include merged samples, and drops rays that have ended or
/// become opaque.
fn look(
    walkers: &mut Vec<Walker>,
    samples: &mut Samples<CpuBackend>,
    radiance: &Buffer<Radiance>,
    pruning: Pruning<f32>,
    seen: &mut Buffer<u32>,
) {
    seen.clear();
    let mut segments = samples.segments.iter();
    walkers.retain_mut(|walker| {
        let Some(segment) = segments.next() else { return false };
        for row in segment.start..segment.start + segment.count {
            let length = &mut samples.intervals[row as usize].length;
            let own = radiance[row as usize].density * *length;
            match pruning.decide(&mut walker.passed, own) {
                Visibility::Keep(factor) => {
                    *length *= factor;
                    seen.push(row);
                }
                Visibility::Merge => {}
                Visibility::Terminate => return false,
            }
        }
        !walker.out && !(walker.passed.depth > pruning.max_depth)
    });
}
