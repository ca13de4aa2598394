//! Ray marching, pruning and compositing on the GPU.

use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Parts, Text};
use crate::gpu::{Bind, Buffer, GRID, GROUP, Gpu, Kernel, Size};
use crate::hybrid::Hybrid;
use crate::loss::{DRAWN_AT, Sums};
use crate::occupancy::WgpuOccupancy;
use crate::shaders::{BLOCKS, COMPOSITING, PIXEL, PRUNING, RANDOM, RAY, SEGMENTS, TARGET};
use crate::space::{GpuSpace, SPACE};
use crate::workspace::{Stream, WgpuBackend};
use std::sync::Arc;
use trimip_core::engine::backend::{Stages, evaluate_visible_samples};
use trimip_core::engine::batch::{Radiance, Rays, Samples, Segment, Tile, Workspace};
use trimip_core::engine::policy::RendererPolicy;
use trimip_core::engine::proxy::Guide;
use trimip_core::math::compositing::Pruning;
use trimip_core::math::rng::Sequence;
use trimip_core::{Config, Pixel, Renderer, Result};

/// Number of segments per invocation of the prefix sums.
const EACH: u32 = 4;

/// Number of segments per workgroup of the prefix sums.
const BLOCK: u32 = EACH * GROUP;

/// Indices of the counters in [`Samples::counts`].
pub(crate) const MARCHED: u32 = 0;
pub(crate) const KEPT: u32 = 1;
const DRAWN: u32 = 4;

/// Number of pairs in [`Samples::counts`]. Each counter has a second counter, for the samples that are dropped.
const COUNTS: usize = 4;

/// Distance from a counter to the counter of the samples that do not fit into their arrays.
const DROPPED: u32 = 2;

shared! {
    /// Parameters of ray marching.
    struct MarchParams as Params {
        space: GpuSpace,
        draws: [u32; 4],
        step_length: f32,
        step_per_radius: f32,
        jitter: u32,
        /// Index of the tile's first ray within the step.
        first: u32,
        /// Number of rays.
        count: u32,
        /// Number of words per ray; a word has one bit per step.
        words: u32,
        /// Maximum number of samples.
        capacity: u32,
    }

    /// Parameters of the prefix sums of segments.
    struct ScanParams as Params {
        count: u32,
        blocks: u32,
        /// Index of the counter for the total, and maximum of the total.
        counter: u32,
        capacity: u32,
    }

    /// Parameters of pruning.
    struct PruneParams as Params {
        /// Number of rays.
        count: u32,
        max_depth: f32,
        min_weight: f32,
        /// Maximum number of kept samples.
        capacity: u32,
    }

    /// Parameters of compositing.
    struct CompositeParams as Params {
        background: [f32; 3],
        /// Number of pixels.
        count: u32,
        /// 1 if pixels have targets with their own backgrounds.
        targets: u32,
    }

    /// Parameters of the gradient of compositing.
    struct GradientParams as Params {
        /// Number of pixels.
        count: u32,
    }
}

/// Shader source: walks rays in steps through the occupied cells of the occupancy grid.
pub const WALK: Source = Parts(&[SPACE, BLOCKS, Text(include_str!("shaders/walk.wgsl"))]);

const MARCH: [Source; 6] =
    [GRID, RANDOM, WALK, SEGMENTS, Source::of::<MarchParams>(), Text(include_str!("shaders/march.wgsl"))];
const SCAN: [Source; 4] = [
    Source::of::<ScanParams>(),
    Source::whole("EACH", EACH),
    Source::whole("DROPPED", DROPPED),
    Text(include_str!("shaders/scan.wgsl")),
];
const PRUNE: [Source; 6] = [
    GRID,
    COMPOSITING,
    PRUNING,
    SEGMENTS,
    Source::of::<PruneParams>(),
    Text(include_str!("shaders/prune.wgsl")),
];
const COMPOSITE: [Source; 7] = [
    GRID,
    RAY,
    PIXEL,
    TARGET,
    COMPOSITING,
    Source::of::<CompositeParams>(),
    Text(include_str!("shaders/composite.wgsl")),
];
const GRADIENT: [Source; 5] = [
    GRID,
    PIXEL,
    COMPOSITING,
    Source::of::<GradientParams>(),
    Text(include_str!("shaders/composite_gradient.wgsl")),
];

kernels! {
    /// The kernels of the renderer.
    pub struct Kernels {
        /// Marks the steps in occupied cells and counts them.
        march: Kernel::new("march", &MARCH, &[(0, Read), (1, Write), (2, Write), (3, Parameters), (4, Read)]),
        /// Turns marks into samples.
        place: Kernel::new(
            "place",
            &MARCH,
            &[(0, Read), (1, Write), (2, Write), (3, Parameters), (5, Write), (6, Write), (7, Write)],
        ),
        /// The three passes of the prefix sums.
        sum_blocks: Kernel::new("sum_blocks", &SCAN, &[(0, Write), (1, Write), (2, Parameters)]),
        sum_all: Kernel::new("sum_all", &SCAN, &[(1, Write), (2, Parameters), (3, Write)]),
        start_segments: Kernel::new("start_segments", &SCAN, &[(0, Write), (1, Write), (2, Parameters)]),
        /// Marks the visible samples.
        see: Kernel::new(
            "see",
            &PRUNE,
            &[(0, Write), (2, Parameters), (3, Read), (4, Write), (5, Write), (6, Write)],
        ),
        /// Counts the marked samples.
        recount: Kernel::new("recount", &PRUNE, &[(0, Write), (2, Parameters), (5, Write), (6, Write)]),
        /// Lists the marked samples.
        list: Kernel::new("list", &PRUNE, &[(0, Write), (1, Write), (2, Parameters), (5, Write), (6, Write)]),
        composite: Kernel::new(
            "composite",
            &COMPOSITE,
            &[
                (0, Read),
                (1, Write),
                (2, Parameters),
                (3, Read),
                (4, Read),
                (5, Read),
                (6, Read),
                (7, Read),
                (8, Write),
            ],
        ),
        composite_gradient: Kernel::new(
            "composite_gradient",
            &GRADIENT,
            &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read), (5, Read), (6, Read), (7, Read)],
        ),
    }
}

/// The renderer: its policy, the capacity of its arrays, and the proxy of hybrid rendering.
pub struct WgpuRenderer {
    gpu: Arc<Gpu>,
    kernels: Kernels,
    pub(crate) policy: RendererPolicy,
    training: bool,
    /// Number of marched samples, and number of kept samples, that fit into a tile.
    pub(crate) capacity: usize,
    kept_capacity: usize,
    hybrid: Option<Hybrid>,
}

impl WgpuRenderer {
    /// Creates the renderer of a configuration, with room for `capacity` marched and `kept_capacity` kept samples per tile.
    pub fn new(
        gpu: &Arc<Gpu>,
        config: &Config,
        training: bool,
        [capacity, kept_capacity]: [usize; 2],
    ) -> Self {
        let policy = RendererPolicy::new(config);
        let kernels = Kernels::new(gpu);
        Self { gpu: Arc::clone(gpu), kernels, policy, training, capacity, kept_capacity, hybrid: None }
    }

    /// Computes the start of every segment and writes the total to a counter.
    pub(crate) fn scan(
        &self,
        stream: &mut Stream,
        segments: &Buffer<Segment>,
        counts: &Buffer<[u32; 2]>,
        counter: u32,
        capacity: usize,
    ) {
        let count = segments.known_len().unwrap_or(segments.capacity()) as u32;
        let blocks = count.div_ceil(BLOCK);
        stream.blocks.resize(blocks as usize);
        let params = ScanParams { count, blocks, counter, capacity: capacity as u32 };
        let Kernels { sum_blocks, sum_all, start_segments, .. } = &self.kernels;
        let groups = Size::Groups(blocks.into());
        let binds = [segments.bind(), stream.blocks.bind()];
        self.gpu.dispatch(sum_blocks, &binds, &params, groups);
        self.gpu.dispatch(sum_all, &[stream.blocks.bind(), counts.bind()], &params, Size::Groups(1));
        self.gpu.dispatch(start_segments, &binds, &params, groups);
    }
}

impl WgpuRenderer {
    /// Lists the marked samples in `kept` and drops all others. On entry, the segments' counts are the numbers of marked
    /// samples; their sum is written to the counter with index `counter`.
    pub(crate) fn list(
        &self,
        stream: &mut Stream,
        marks: &wgpu::Buffer,
        samples: &mut Samples<WgpuBackend>,
        kept: &mut Buffer<u32>,
        counter: u32,
    ) {
        let count = samples.segments.known_len().unwrap_or(0);
        let kept_capacity = self.kept_capacity.min(samples.spheres.most());
        self.scan(stream, &samples.segments, &samples.counts, counter, kept_capacity);
        kept.count_by(kept_capacity, samples.counts.raw(), counter, 1);
        let binds = [samples.segments.bind(), kept.bind(), stream.old_segments.bind(), Bind::whole(marks)];
        let params = self.prune_params(count, kept_capacity);
        self.gpu.dispatch(&self.kernels.list, &binds, &params, Size::Items(count as u64));
        stream.keep(kept, &mut samples.rays, 1);
        stream.keep(kept, &mut samples.intervals, 2);
        stream.keep(kept, &mut samples.spheres, 4);
    }

    fn prune_params(&self, count: usize, kept_capacity: usize) -> PruneParams {
        let Pruning { max_depth, min_weight } = self.policy.pruning;
        // WGSL cannot express infinity.
        let max_depth = max_depth.min(f32::MAX);
        PruneParams { count: count as u32, max_depth, min_weight, capacity: kept_capacity as u32 }
    }
}

impl Renderer<WgpuBackend> for WgpuRenderer {
    fn policy(&self) -> &RendererPolicy {
        &self.policy
    }

    fn policy_mut(&mut self) -> &mut RendererPolicy {
        &mut self.policy
    }

    fn set_guide(&mut self, guide: Option<Guide>) -> Result<()> {
        self.hybrid = guide.map(|guide| Hybrid::new(&self.gpu, &guide)).transpose()?;
        Ok(())
    }

    fn visibility_pass(
        &self,
        stages: &Stages<WgpuBackend>,
        parameters: &Buffer<f32>,
        workspace: &mut Workspace<WgpuBackend>,
        jitter: Option<u64>,
    ) {
        match &self.hybrid {
            Some(hybrid) if jitter.is_none() => hybrid.visibility_pass(stages, parameters, workspace),
            _ => evaluate_visible_samples(stages, parameters, workspace, jitter),
        }
    }

    fn march(
        &self,
        stream: &mut Stream,
        rays: &Rays<WgpuBackend>,
        occupancy: &WgpuOccupancy,
        jitter: Option<u64>,
        samples: &mut Samples<WgpuBackend>,
    ) {
        let count = rays.rays.known_len().unwrap_or(0);
        let most_samples = self.policy.most_samples();
        let words = most_samples.div_ceil(32);
        // A small view needs little room. In training, arrays have their full size from the first step on.
        let capacity =
            if self.training { self.capacity } else { self.capacity.min(count * most_samples).max(1) };
        samples.segments.resize(count);
        samples.counts.resize(COUNTS);
        stream.bits.resize(count * words);
        stream.marched = true;
        let params = MarchParams {
            space: GpuSpace::new(&self.policy.space, occupancy.resolution()),
            draws: jitter.map_or([0; 4], |step| self.policy.random.at(Sequence::Jitter, step).words()),
            step_length: self.policy.step_length(),
            step_per_radius: self.policy.step_per_radius,
            jitter: u32::from(jitter.is_some()),
            first: rays.first,
            count: count as u32,
            words: words as u32,
            capacity: capacity as u32,
        };
        let items = Size::Items(count as u64);
        let binds = [rays.rays.bind(), stream.bits.bind(), samples.segments.bind(), occupancy.grid().bind()];
        self.gpu.dispatch(&self.kernels.march, &binds, &params, items);
        self.scan(stream, &samples.segments, &samples.counts, MARCHED, capacity);
        let counts = samples.counts.raw().clone();
        samples.rays.count_by(capacity, &counts, MARCHED, 1);
        samples.intervals.count_by(capacity, &counts, MARCHED, 1);
        samples.spheres.count_by(capacity, &counts, MARCHED, 1);
        let binds = [
            rays.rays.bind(),
            stream.bits.bind(),
            samples.segments.bind(),
            samples.rays.bind(),
            samples.intervals.bind(),
            samples.spheres.bind(),
        ];
        self.gpu.dispatch(&self.kernels.place, &binds, &params, items);
    }

    fn prune(
        &self,
        stream: &mut Stream,
        radiance: &Buffer<Radiance>,
        samples: &mut Samples<WgpuBackend>,
        kept: &mut Buffer<u32>,
    ) {
        let count = samples.segments.known_len().unwrap_or(0);
        let capacity = samples.spheres.most();
        samples.counts.resize(COUNTS);
        stream.old_segments.resize(count);
        stream.marks.resize(capacity);
        let params = self.prune_params(count, self.kept_capacity.min(capacity));
        let binds = [
            samples.segments.bind(),
            radiance.bind(),
            samples.intervals.bind(),
            stream.old_segments.bind(),
            stream.marks.bind(),
        ];
        self.gpu.dispatch(&self.kernels.see, &binds, &params, Size::Items(count as u64));
        let marks = stream.marks.raw().clone();
        self.list(stream, &marks, samples, kept, KEPT);
    }

    fn keep_drawn(
        &self,
        stream: &mut Stream,
        marks: &Buffer<u32>,
        samples: &mut Samples<WgpuBackend>,
        drawn: &mut Buffer<u32>,
        sums: &mut Sums,
    ) {
        let count = samples.segments.known_len().unwrap_or(0);
        samples.counts.resize(COUNTS);
        stream.old_segments.resize(count);
        let params = self.prune_params(count, self.kept_capacity);
        let binds = [samples.segments.bind(), stream.old_segments.bind(), marks.bind()];
        self.gpu.dispatch(&self.kernels.recount, &binds, &params, Size::Items(count as u64));
        self.list(stream, marks.raw(), samples, drawn, DRAWN);
        if let Some(sums) = &sums.0 {
            self.gpu.copy(samples.counts.raw(), 4 * u64::from(DRAWN), &sums.buffer, DRAWN_AT, 4);
        }
    }

    fn composite(
        &self,
        tile: &mut Tile<'_, WgpuBackend>,
        radiance: &Buffer<Radiance>,
        cones: &mut Buffer<Pixel>,
        pixels: &mut Buffer<Pixel>,
    ) {
        let (rays, samples) = (tile.rays, tile.samples);
        let count = rays.groups.known_len().unwrap_or(0);
        cones.resize(rays.rays.known_len().unwrap_or(0));
        pixels.resize(count);
        let targets = rays.targets.known_len().unwrap_or(0) > 0;
        let params = CompositeParams {
            background: self.policy.background,
            count: count as u32,
            targets: u32::from(targets),
        };
        let binds = [
            samples.segments.bind(),
            pixels.bind(),
            radiance.bind(),
            samples.intervals.bind(),
            rays.rays.bind(),
            rays.targets.bind(),
            rays.groups.bind(),
            cones.bind(),
        ];
        self.gpu.dispatch(&self.kernels.composite, &binds, &params, Size::Items(count as u64));
    }

    fn backward(
        &self,
        tile: &mut Tile<'_, WgpuBackend>,
        radiance: &Buffer<Radiance>,
        cones: &Buffer<Pixel>,
        pixel_gradients: &Buffer<[f32; 4]>,
        radiance_gradients: &mut Buffer<Radiance>,
    ) {
        let (rays, samples) = (tile.rays, tile.samples);
        let count = rays.groups.known_len().unwrap_or(0);
        match radiance.counter() {
            Some((counts, counter)) => radiance_gradients.count_by(radiance.most(), counts, counter, 1),
            None => radiance_gradients.resize(radiance.known_len().unwrap_or(0)),
        }
        let binds = [
            samples.segments.bind(),
            radiance_gradients.bind(),
            radiance.bind(),
            samples.intervals.bind(),
            cones.bind(),
            pixel_gradients.bind(),
            rays.groups.bind(),
        ];
        let params = GradientParams { count: count as u32 };
        self.gpu.dispatch(&self.kernels.composite_gradient, &binds, &params, Size::Items(count as u64));
    }
}
