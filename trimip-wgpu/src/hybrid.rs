//! Hybrid rendering on the GPU: the densities of the proxy determine where a ray has samples.

use crate::field::Context;
use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Text};
use crate::gpu::{Buffer, GRID, Gpu, Kernel, Size};
use crate::occupancy::WgpuOccupancy;
use crate::renderer::{KEPT, MARCHED, WALK, WgpuRenderer};
use crate::shaders::{COMPOSITING, PRUNING, SEGMENTS};
use crate::space::GpuSpace;
use crate::workspace::{Stream, WgpuBackend};
use std::sync::Arc;
use trimip_core::engine::backend::Stages;
use trimip_core::engine::batch::{Radiance, Rays, Samples, Tile, Workspace};
use trimip_core::engine::proxy::{BEHIND, BRICK, Guide, Layers, Rule};
use trimip_core::{Error, Result};

shared! {
    /// Parameters of the kernels that choose samples.
    struct ChooseParams as Params {
        space: GpuSpace,
        /// Number of cells of the proxy along each axis.
        cells: [u32; 3],
        /// Number of rays.
        count: u32,
        /// Index of the first word of the bricks in the proxy, and of the first word of the codes.
        bricks: u32,
        codes: u32,
        /// Maximum number of samples.
        capacity: u32,
        /// Upper bound of the number of steps of a ray.
        last: f32,
        /// Step length along the proxy, and step length of volume rendering.
        step: f32,
        step_length: f32,
        step_per_radius: f32,
        /// Largest radius of a sphere for which the proxy is used.
        widest: f32,
        /// See [`Rule`] and [`BEHIND`].
        least: f32,
        opaque: f32,
        behind: f32,
        /// See [`Layers`]; if the number of layers is 0, the rule of weights applies.
        delta: f32,
        surface: f32,
        layers: u32,
        samples: u32,
    }

    /// Parameters of the kernel that shares colours.
    struct ShareParams as Params {
        /// Number of rays.
        count: u32,
        max_depth: f32,
        min_weight: f32,
        /// See [`Rule`].
        shared_weight: f32,
        reach: f32,
        /// Width of the density network's output: the logit, the geometry features, and padding.
        outputs: u32,
        geometry: u32,
    }
}

const CHOICE: [Source; 6] = [
    GRID,
    WALK,
    SEGMENTS,
    Source::whole("BRICK", BRICK),
    Source::of::<ChooseParams>(),
    Text(include_str!("shaders/choose.wgsl")),
];
const SHARE: [Source; 5] =
    [GRID, COMPOSITING, PRUNING, Source::of::<ShareParams>(), Text(include_str!("shaders/share.wgsl"))];

kernels! {
    /// The kernels of hybrid rendering.
    pub struct Kernels {
        /// Counts the samples of each ray.
        count: Kernel::new(
            "count",
            &CHOICE,
            &[(0, Read), (1, Write), (2, Write), (3, Parameters), (4, Read), (8, Read)],
        ),
        /// Writes the samples.
        fill: Kernel::new(
            "fill",
            &CHOICE,
            &[
                (0, Read),
                (1, Write),
                (2, Write),
                (3, Parameters),
                (4, Read),
                (5, Write),
                (6, Write),
                (7, Write),
                (8, Read),
            ],
        ),
        /// Marks the visible samples that have a colour of their own.
        share: Kernel::new(
            "share",
            &SHARE,
            &[(0, Write), (1, Read), (2, Parameters), (3, Write), (4, Write), (5, Write), (6, Write), (7, Write)],
        ),
    }
}

/// The proxy of a model on the device.
pub struct Hybrid {
    gpu: Arc<Gpu>,
    kernels: Kernels,
    /// For each code, the optical depth and opacity of a step; then one word per brick; then the cells' codes, eight
    /// per word.
    proxy: Buffer<u32>,
    cells: [u32; 3],
    /// Index of the first word of the bricks, and index of the first word of the codes.
    places: [u32; 2],
    rule: Rule,
    layers: Option<Layers>,
    step: f32,
    widest: f32,
}

impl Hybrid {
    /// Copies a proxy to the device.
    ///
    /// # Errors
    /// When the proxy is larger than the device's largest binding.
    pub fn new(gpu: &Arc<Gpu>, guide: &Guide) -> Result<Self> {
        let steps = guide.steps.iter().flatten().map(|value| value.to_bits());
        let mut words: Vec<u32> = steps.collect();
        let bricks = words.len() as u32;
        words.extend_from_slice(guide.proxy.index());
        let codes = words.len() as u32;
        let word = |four: &[u8]| four.iter().rev().fold(0, |word, &code| word << 8 | u32::from(code));
        words.extend(guide.proxy.codes().chunks(4).map(word));
        let (bytes, most) = (4 * words.len() as u64, gpu.limits().max_storage_buffer_binding_size);
        if bytes > most {
            return Err(Error::input(
                "the model's proxy",
                format!("has {bytes} bytes, but the device binds at most {most} at once"),
                "bake a coarser one (hybrid.resolution), or use renderer.kind = \"volume\"",
            ));
        }
        let mut proxy = Buffer::zeros(gpu, 0);
        proxy.write(&words);
        Ok(Self {
            gpu: Arc::clone(gpu),
            kernels: Kernels::new(gpu),
            proxy,
            cells: guide.proxy.cells(),
            places: [bricks, codes],
            rule: guide.rule,
            layers: guide.layers,
            step: guide.step,
            widest: guide.widest,
        })
    }

    /// See [`trimip_core::Renderer::visibility_pass`].
    pub fn visibility_pass(
        &self,
        stages: &Stages<WgpuBackend>,
        parameters: &Buffer<f32>,
        workspace: &mut Workspace<WgpuBackend>,
    ) {
        let Workspace { stream, rays, samples, .. } = workspace;
        self.choose(&stages.renderer, stream, rays, &stages.occupancy, samples);
        stages.density(parameters, workspace);
        let Workspace { stream, rays, samples, field_context, radiance, kept, .. } = workspace;
        let tile = &mut Tile { stream, parameters, rays, samples };
        self.share(stages, tile, field_context, radiance);
        let marks = stream.marks.raw().clone();
        stages.renderer.list(stream, &marks, samples, kept, KEPT);
        stages.field.keep_outputs(stream, kept, field_context, radiance);
    }

    /// Places the samples of all rays.
    fn choose(
        &self,
        renderer: &WgpuRenderer,
        stream: &mut Stream,
        rays: &Rays<WgpuBackend>,
        occupancy: &WgpuOccupancy,
        samples: &mut Samples<WgpuBackend>,
    ) {
        let count = rays.rays.known_len().unwrap_or(0);
        let most_samples = renderer.policy.space.most_steps(self.step.min(renderer.policy.step_length()));
        let capacity = renderer.capacity.min(count * most_samples).max(1);
        samples.segments.resize(count);
        samples.counts.resize(2);
        stream.sure.resize(count);
        stream.marched = true;
        let (Rule { least, opaque, .. }, layers) = (self.rule, self.layers);
        let params = ChooseParams {
            space: GpuSpace::new(&renderer.policy.space, occupancy.resolution()),
            cells: self.cells,
            count: count as u32,
            bricks: self.places[0],
            codes: self.places[1],
            capacity: capacity as u32,
            last: most_samples as f32,
            step: self.step,
            step_length: renderer.policy.step_length(),
            step_per_radius: renderer.policy.step_per_radius,
            widest: self.widest,
            least,
            opaque,
            behind: BEHIND,
            delta: layers.map_or(0.0, |rule| rule.delta),
            surface: layers.map_or(0.0, |rule| rule.surface),
            layers: layers.map_or(0, |rule| rule.layers),
            samples: layers.map_or(0, |rule| rule.samples),
        };
        let items = Size::Items(count as u64);
        let (rays, grid, proxy) = (rays.rays.bind(), occupancy.grid().bind(), self.proxy.bind());
        let binds = [rays, stream.sure.bind(), samples.segments.bind(), grid, proxy];
        self.gpu.dispatch(&self.kernels.count, &binds, &params, items);
        renderer.scan(stream, &samples.segments, &samples.counts, MARCHED, capacity);
        let counts = samples.counts.raw().clone();
        samples.rays.count_by(capacity, &counts, MARCHED, 1);
        samples.intervals.count_by(capacity, &counts, MARCHED, 1);
        samples.spheres.count_by(capacity, &counts, MARCHED, 1);
        let binds = [
            rays,
            stream.sure.bind(),
            samples.segments.bind(),
            grid,
            samples.rays.bind(),
            samples.intervals.bind(),
            samples.spheres.bind(),
            proxy,
        ];
        self.gpu.dispatch(&self.kernels.fill, &binds, &params, items);
    }

    /// Marks the visible samples that have a colour of their own; the other visible samples share these colours.
    fn share(
        &self,
        stages: &Stages<WgpuBackend>,
        tile: &mut Tile<'_, WgpuBackend>,
        field_context: &Context,
        radiance: &Buffer<Radiance>,
    ) {
        let Stages { renderer, field, .. } = stages;
        let Tile { stream, samples, .. } = tile;
        let count = samples.segments.known_len().unwrap_or(0);
        stream.old_segments.resize(count);
        stream.marks.resize(samples.spheres.most());
        let params = ShareParams {
            count: count as u32,
            // WGSL cannot express infinity.
            max_depth: renderer.policy.pruning.max_depth.min(f32::MAX),
            min_weight: renderer.policy.pruning.min_weight,
            shared_weight: self.rule.shared_weight,
            reach: self.rule.reach,
            outputs: field.outputs() as u32,
            geometry: field.geometry() as u32,
        };
        let binds = [
            samples.segments.bind(),
            stream.sure.bind(),
            radiance.bind(),
            samples.intervals.bind(),
            stream.old_segments.bind(),
            stream.marks.bind(),
            field_context.outputs().bind(),
        ];
        self.gpu.dispatch(&self.kernels.share, &binds, &params, Size::Items(count as u64));
    }
}
