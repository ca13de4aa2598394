//! Ray generation on the GPU: views, pixels and scales are stored on the device.

use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Parts, Text};
use crate::gpu::{Binds, Buffer, GRID, Gpu, Kernel, Size, lock};
use crate::projections::PROJECTIONS;
use crate::settings::{Photographs, WgpuConfig};
use crate::shaders::{RANDOM, RAY, TARGET};
use crate::workspace::{Stream, WgpuBackend};
use std::ops::Range;
use std::sync::{Arc, Mutex};
use trimip_core::engine::backend::Sampler;
use trimip_core::engine::batch::Rays;
use trimip_core::engine::error_map::{CellErrors, ErrorMap, Grid, MOST_ERROR, UNIT, per_pixel};
use trimip_core::engine::policy::SamplerPolicy;
use trimip_core::engine::ray_allocation::RayAllocation;
use trimip_core::geometry::lens::MOST_ROUNDS;
use trimip_core::math::rng::Sequence;
use trimip_core::scene::cones::PixelPattern;
use trimip_core::scene::depths::KnownDepth;
use trimip_core::scene::views::Alpha;
use trimip_core::{Camera, Config, Error, Result, Scale, View, ViewSet};

/// Maximum number of threads that look up a step's pixels on the host.
const MOST_THREADS: usize = 8;

/// Maximum number of scales of a data set.
const MOST_SCALES: usize = 8;

/// Number of words of a cell's errors.
const WORDS_OF_CELL: usize = 4;

/// Number of cones along a side that denotes the quincunx on the device. No grid has as many cones along a side.
const QUINCUNX: u32 = 0x100;

shared! {
    /// A camera, and the position of its pixels among all pixels.
    struct GpuView as View {
        /// Rows of the camera-to-world rotation, each followed by a component of the origin.
        pose: [[f32; 4]; 3],
        /// fx, fy, cx, cy.
        intrinsics: [f32; 4],
        /// Radius of the pixel's disc on the plane at distance 1.
        disc: f32,
        width: u32,
        /// Index of the view's first pixel.
        offset: u32,
        /// 0 for a pinhole, otherwise one more than the camera model's index in its registry.
        lens: u32,
        /// Coefficients of the lens, with the letters of [`trimip_core::geometry::lens`]: k1 to k4; d1 to d3 and the domain;
        /// p1, p2, s1, s2.
        radial: [f32; 4],
        denominator: [f32; 4],
        shift: [f32; 4],
        /// First cell of the view in the error map, the view's numbers of columns and rows of cells, and the view's
        /// height in pixels.
        cells: [u32; 4],
    }

    /// Parameters of ray generation.
    struct Params as Params {
        draws: [u32; 4],
        background_draws: [u32; 4],
        background: [f32; 3],
        /// Fraction of the pixels that get a random background.
        random_background: f32,
        /// Number of pixels of the step; index of the first pixel and number of pixels of this tile.
        total: u32,
        first: u32,
        count: u32,
        scales: u32,
        /// Meaning of alpha, see [`meaning`].
        alpha: u32,
        /// 1 if `pixels` holds only the drawn pixels, in the order of the rays.
        streamed: u32,
        /// Index within the step of the tile's first cone.
        first_cone: u32,
        /// Number of known depths.
        depths: u32,
        /// Number of cells of the error map, in each component.
        cells: [u32; 4],
        /// For each scale: the pixels of the step from this index on belong to this scale or to a coarser one.
        begins: [u32; MOST_SCALES],
        /// For each scale: loss weight of a pixel, cones of a pixel ([`side_of`]), and edge exponent of the
        /// photographs.
        weights: [f32; MOST_SCALES],
        sides: [u32; MOST_SCALES],
        exponents: [f32; MOST_SCALES],
        /// For each scale: first pixel and number of pixels, first view and number of views, and [`per_pixel`].
        first_pixels: [u32; MOST_SCALES],
        pixels: [u32; MOST_SCALES],
        first_views: [u32; MOST_SCALES],
        views: [u32; MOST_SCALES],
        per_pixel: [f32; MOST_SCALES],
    }
}

/// Shader source: cameras and the cones of their pixels.
pub const CAMERA: Source = Parts(&[
    RAY,
    Source::of::<GpuView>(),
    Source::whole("MOST_ROUNDS", MOST_ROUNDS),
    Source::real("EPSILON", f32::EPSILON),
    Source::whole("QUINCUNX", QUINCUNX),
    Text(include_str!("shaders/camera.wgsl")),
    Text(PROJECTIONS),
]);

mirror!(KnownDepth as KnownDepth { pixel: u32, distance: f32, deviation: f32 });

const VIEWS: Source = Text(include_str!("shaders/views.wgsl"));
const DRAW: Source = Text(include_str!("shaders/draw.wgsl"));
const EVENLY: Source = Text(include_str!("shaders/draw_evenly.wgsl"));
const CELLS: Source = Text(include_str!("shaders/error_cells.wgsl"));
const BY_ERROR: Source = Parts(&[CELLS, Text(include_str!("shaders/draw_by_error.wgsl"))]);
const RAYS: [Source; 8] = [
    GRID,
    RANDOM,
    CAMERA,
    TARGET,
    Source::of::<Params>(),
    DRAW,
    VIEWS,
    Text(include_str!("shaders/rays.wgsl")),
];
const KNOWN_DEPTHS: [Source; 7] = [
    GRID,
    RANDOM,
    TARGET,
    Source::of::<Params>(),
    Source::of::<KnownDepth>(),
    DRAW,
    Text(include_str!("shaders/known_depths.wgsl")),
];
const PHOTOGRAPHS_NONE: Source = Text(include_str!("shaders/photographs_none.wgsl"));
const PHOTOGRAPHS_KEPT: Source = Text(include_str!("shaders/photographs_kept.wgsl"));

const OBSERVE: [Source; 9] = [
    GRID,
    RANDOM,
    TARGET,
    Source::of::<Params>(),
    DRAW,
    CELLS,
    Source::real("UNIT", UNIT),
    Source::real("MOST_ERROR", MOST_ERROR),
    Text(include_str!("shaders/observe.wgsl")),
];

/// Returns the kernel that generates the rays of a training step. If `by_error` is true, the error map determines how
/// pixels are drawn; otherwise they are drawn evenly.
fn training_rays(by_error: bool) -> Kernel {
    let kernel = Kernel::new(
        "training_rays",
        &RAYS,
        &[(0, Read), (1, Write), (2, Parameters), (3, Read), (5, Write), (6, Write)],
    );
    if by_error { kernel.and(&[BY_ERROR], &[(10, Read)]) } else { kernel.and(&[EVENLY], &[]) }
}

/// Returns the kernel of [`training_rays`] that also stores the photograph of each pixel.
fn training_rays_exposed(by_error: bool) -> Kernel {
    training_rays(by_error).and(&[PHOTOGRAPHS_KEPT], &[(7, Write), (8, Read)])
}

/// Returns the kernel that writes known depths to targets.
fn known_depths() -> Kernel {
    Kernel::new("known_depths", &KNOWN_DEPTHS, &[(2, Parameters), (5, Write), (9, Read)])
}

kernels! {
    /// The kernels of ray generation.
    pub struct Kernels {
        camera_rays: Kernel::new("camera_rays", &RAYS, &[(0, Read), (1, Write), (2, Parameters), (6, Write)])
            .and(&[PHOTOGRAPHS_NONE, EVENLY], &[]),
        training_rays: training_rays(false).and(&[PHOTOGRAPHS_NONE], &[]),
        training_rays_exposed: training_rays_exposed(false),
        training_rays_by_error: training_rays(true).and(&[PHOTOGRAPHS_NONE], &[]),
        training_rays_exposed_by_error: training_rays_exposed(true),
        known_depths: known_depths().and(&[EVENLY], &[]),
        known_depths_by_error: known_depths().and(&[Source::of::<GpuView>(), VIEWS, BY_ERROR], &[(0, Read), (10, Read)]),
        /// Adds the errors of pixels to their cells.
        observe: Kernel::new("observe", &OBSERVE, &[(2, Parameters), (5, Read), (10, Read), (11, Read), (12, Write)]),
    }
}

impl GpuView {
    fn new(camera: &Camera, offset: usize, cells: Grid) -> Self {
        let k = &camera.intrinsics;
        let axes = camera.rotation.to_cols_array_2d();
        let origin = camera.origin.to_array();
        let lens = &k.lens;
        let ([d1, d2, d3], [p1, p2], [s1, s2]) = (lens.denominator, lens.tangential, lens.prism);
        Self {
            pose: [0, 1, 2].map(|i| [axes[0][i], axes[1][i], axes[2][i], origin[i]].map(|x| x as f32)),
            intrinsics: [k.fx, k.fy, k.cx, k.cy].map(|x| x as f32),
            disc: (std::f64::consts::PI * k.fx * k.fy).sqrt().recip() as f32,
            width: k.width,
            offset: offset as u32,
            lens: if lens.is_straight() { 0 } else { 1 + lens.model as u32 },
            radial: lens.radial.map(|k| k as f32),
            denominator: [d1, d2, d3, lens.domain()].map(|d| d as f32),
            shift: [p1, p2, s1, s2].map(|s| s as f32),
            cells: [cells.first, cells.size[0], cells.size[1], k.height],
        }
    }
}

/// The training views on the device, and the policy that draws a step's pixels from them.
pub struct WgpuSampler {
    gpu: Arc<Gpu>,
    kernels: Kernels,
    policy: SamplerPolicy,
    training: Option<Training>,
    camera: Buffer<GpuView>,
    params: Params,
}

struct Training {
    views: Buffer<GpuView>,
    /// All pixels, or only the pixels of a step's rays.
    pixels: Mutex<Buffer<u32>>,
    /// All pixels, if they stay on the host.
    host: Option<trimip_core::Pixels>,
    /// The views on the host, and the error-map cells of each view.
    on_host: Vec<View>,
    cells: Vec<Grid>,
    /// Smallest random number that draws each cell of the error map.
    starts: Buffer<u32>,
    /// Errors of each cell, which the kernel `observe` sums.
    errors: Buffer<u32>,
    /// The photograph of each view; `None` unless the run uses `loss.exposure` or refines poses.
    photographs: Option<Buffer<u32>>,
    /// Known depths, sorted by pixel.
    depths: Buffer<KnownDepth>,
}

impl WgpuSampler {
    /// Creates a sampler over `views`. Without views it generates only camera rays.
    ///
    /// # Errors
    /// When the photographs exceed the device's largest binding.
    pub fn new(gpu: &Arc<Gpu>, config: &Config, views: Option<ViewSet>) -> Result<Self> {
        let policy = SamplerPolicy::new(config, views.as_ref());
        let mut params = Params {
            background: policy.background,
            scales: policy.scales.len() as u32,
            exponents: padded(policy.exponents.iter().copied(), 0.0),
            cells: [policy.error_map().map_or(0, ErrorMap::len) as u32; 4],
            first_pixels: by_scale(&policy, |scale| scale.pixels.start as u32),
            pixels: by_scale(&policy, |scale| scale.pixels.len() as u32),
            first_views: by_scale(&policy, |scale| scale.views.start as u32),
            views: by_scale(&policy, |scale| scale.views.len() as u32),
            per_pixel: padded(policy.scales.iter().map(|scale| per_pixel(scale.pixels.len())), 0.0),
            ..Params::default()
        };
        let training = match views {
            None => None,
            Some(views) => {
                params.alpha = meaning(views.alpha);
                params.depths = views.depths.len() as u32;
                let training = Training::new(gpu, config, &policy, views)?;
                params.streamed = u32::from(training.host.is_some());
                Some(training)
            }
        };
        let kernels = Kernels::new(gpu);
        Ok(Self { gpu: Arc::clone(gpu), kernels, policy, training, camera: Buffer::zeros(gpu, 1), params })
    }
}

/// Returns the error-map cells of each view's photograph.
fn cells(policy: &SamplerPolicy, views: &ViewSet) -> Vec<Grid> {
    let Some(map) = policy.error_map() else { return vec![Grid::default(); views.views.len()] };
    views.scales.iter().flat_map(|_| map.grids()).copied().collect()
}

/// Returns a number for each scale.
fn by_scale(policy: &SamplerPolicy, of: impl Fn(&Scale) -> u32) -> [u32; MOST_SCALES] {
    padded(policy.scales.iter().map(of), 0)
}

/// Encodes the meaning of alpha for the device.
fn meaning(alpha: Alpha) -> u32 {
    match alpha {
        Alpha::Straight => 0,
        Alpha::Premultiplied => 1,
        Alpha::Kept => 2,
    }
}

/// Encodes the cones of a pixel for the device: their number along a side of a grid, or [`QUINCUNX`].
fn side_of(pattern: PixelPattern) -> u32 {
    match pattern {
        PixelPattern::Grid(side) => side,
        PixelPattern::Quincunx => QUINCUNX,
    }
}

/// Makes room for the cones of a tile's pixels; `cones` are the indices of the cones in the step.
fn make_room(rays: &mut Rays<WgpuBackend>, pixels: &Range<u32>, cones: Range<u32>) {
    rays.first = cones.start;
    rays.rays.resize(cones.len());
    rays.groups.resize(pixels.len());
}

impl Training {
    fn new(gpu: &Arc<Gpu>, config: &Config, policy: &SamplerPolicy, views: ViewSet) -> Result<Self> {
        let photographs = config.section::<WgpuConfig>()?.photographs;
        let most = gpu.limits().max_storage_buffer_binding_size;
        let bytes = 4 * views.pixels.len() as u64;
        if bytes > most && photographs == Photographs::Device {
            return Err(Error::input(
                "wgpu.photographs = \"device\"",
                format!("{bytes} bytes of pixels, but the device binds at most {most} at once"),
                "use \"auto\" or \"host\", which sends each step's pixels",
            ));
        }
        let streamed = photographs == Photographs::Host || bytes > most;
        if views.scales.len() > MOST_SCALES {
            return Err(Error::input(
                "data.scales",
                format!("{} scales", views.scales.len()),
                format!("use at most {MOST_SCALES} on the GPU"),
            ));
        }
        if size_of_val(&views.depths[..]) as u64 > most {
            return Err(Error::input(
                "plan.depth",
                format!(
                    "{} pixels of known depth are more than the device binds at once",
                    views.depths.len()
                ),
                "set data.scales to fewer scales, or use a model of fewer points",
            ));
        }
        let mut training = Self {
            views: Buffer::zeros(gpu, 0),
            pixels: Mutex::new(Buffer::zeros(gpu, 0)),
            host: None,
            cells: cells(policy, &views),
            on_host: views.views.clone(),
            starts: Buffer::zeros(gpu, 0),
            errors: Buffer::zeros(gpu, WORDS_OF_CELL * policy.error_map().map_or(0, ErrorMap::len)),
            photographs: (!policy.photographs.is_empty()).then(|| Buffer::zeros(gpu, 0)),
            depths: Buffer::zeros(gpu, 0),
        };
        training.place(&views.views.iter().map(|view| view.camera).collect::<Vec<_>>());
        if let Some(of_views) = &mut training.photographs {
            of_views.write(&policy.photographs);
        }
        if let Some(map) = policy.error_map() {
            training.starts.write(map.starts());
        }
        training.depths.write(&views.depths);
        if streamed {
            training.host = Some(views.pixels);
        } else {
            lock(&training.pixels).write(bytemuck::cast_slice(&views.pixels));
        }
        Ok(training)
    }

    /// Writes the cameras of all views.
    fn place(&mut self, cameras: &[Camera]) {
        let views = cameras.iter().zip(&self.on_host).zip(&self.cells);
        let views = views.map(|((camera, view), cells)| GpuView::new(camera, view.offset, *cells));
        self.views.write(&views.collect::<Vec<_>>());
    }
}

/// Looks up the pixels `range` of a step on a few threads. It draws them with the same random numbers as the device.
fn look_up(
    policy: &SamplerPolicy,
    views: &[View],
    host: &[[u8; 4]],
    step: u64,
    allocation: &RayAllocation,
    range: Range<u32>,
) -> Vec<u32> {
    let threads = std::thread::available_parallelism().map_or(1, usize::from).min(MOST_THREADS);
    let part = range.len().div_ceil(threads).max(1);
    let mut words = vec![0; range.len()];
    std::thread::scope(|scope| {
        for (words, first) in words.chunks_mut(part).zip(range.step_by(part)) {
            scope.spawn(move || {
                for (word, index) in words.iter_mut().zip(first..) {
                    *word = u32::from_le_bytes(host[policy.pixel(views, step, allocation, index).pixel]);
                }
            });
        }
    });
    words
}

/// Pads the values with `rest`, which no kernel reads.
fn padded<T: Copy>(values: impl Iterator<Item = T>, rest: T) -> [T; MOST_SCALES] {
    let mut all = [rest; MOST_SCALES];
    all.iter_mut().zip(values).for_each(|(place, value)| *place = value);
    all
}

impl Sampler<WgpuBackend> for WgpuSampler {
    fn policy(&self) -> &SamplerPolicy {
        &self.policy
    }

    fn policy_mut(&mut self) -> &mut SamplerPolicy {
        &mut self.policy
    }

    fn set_cameras(&mut self, cameras: &[Camera]) {
        if let Some(training) = &mut self.training {
            training.place(cameras);
        }
    }

    fn training_rays(
        &self,
        _: &mut Stream,
        step: u64,
        allocation: &RayAllocation,
        range: Range<u32>,
        rays: &mut Rays<WgpuBackend>,
    ) {
        let Some(training) = &self.training else {
            make_room(rays, &(0..0), 0..0);
            rays.targets.resize(0);
            return;
        };
        let policy = &self.policy;
        let first_cone = allocation.cones_before(range.start);
        make_room(rays, &range, first_cone..allocation.cones_before(range.end));
        rays.targets.resize(range.len());
        let params = Params {
            draws: policy.random.at(Sequence::Pixel, step).words(),
            background_draws: policy.random.at(Sequence::Background, step).words(),
            random_background: policy.random_background(),
            total: allocation.pixels(),
            first: range.start,
            count: range.len() as u32,
            first_cone,
            begins: padded(allocation.begins().iter().copied(), allocation.pixels()),
            weights: padded(policy.scale_weights().weights().iter().copied(), 0.0),
            sides: padded(allocation.patterns().iter().copied().map(side_of), 1),
            ..self.params
        };
        let mut pixels = lock(&training.pixels);
        if let Some(host) = &training.host {
            pixels.write(&look_up(policy, &training.on_host, host, step, allocation, range.clone()));
        }
        let Training { views, photographs: of_views, starts, .. } = training;
        let by_error = policy.error_map().is_some();
        rays.photographs.resize(if of_views.is_some() { range.len() } else { 0 });
        let mut binds = Binds::new(views.bind()).and([
            rays.rays.bind(),
            pixels.bind(),
            rays.targets.bind(),
            rays.groups.bind(),
        ]);
        if let Some(of_views) = of_views {
            binds = binds.and([rays.photographs.bind(), of_views.bind()]);
        }
        binds = binds.and(by_error.then(|| starts.bind()));
        let kernel = match (of_views.is_some(), by_error) {
            (false, false) => &self.kernels.training_rays,
            (true, false) => &self.kernels.training_rays_exposed,
            (false, true) => &self.kernels.training_rays_by_error,
            (true, true) => &self.kernels.training_rays_exposed_by_error,
        };
        let items = Size::Items(range.len() as u64);
        self.gpu.dispatch(kernel, &binds, &params, items);
        if policy.knows_depths() && params.depths > 0 {
            let (targets, depths) = (rays.targets.bind(), training.depths.bind());
            if by_error {
                let binds = [views.bind(), targets, depths, starts.bind()];
                self.gpu.dispatch(&self.kernels.known_depths_by_error, &binds, &params, items);
            } else {
                self.gpu.dispatch(&self.kernels.known_depths, &[targets, depths], &params, items);
            }
        }
    }

    fn observe(
        &self,
        _: &mut Stream,
        step: u64,
        range: Range<u32>,
        rays: &Rays<WgpuBackend>,
        pixel_gradients: &Buffer<[f32; 4]>,
    ) {
        let (Some(training), Some(_)) = (&self.training, self.policy.error_map()) else { return };
        let params = Params {
            draws: self.policy.random.at(Sequence::Pixel, step).words(),
            first: range.start,
            count: range.len() as u32,
            ..self.params
        };
        let Training { starts, errors, .. } = training;
        let binds = [rays.targets.bind(), starts.bind(), pixel_gradients.bind(), errors.bind()];
        self.gpu.dispatch(&self.kernels.observe, &binds, &params, Size::Items(range.len() as u64));
    }

    fn take_errors(&mut self) -> Vec<CellErrors> {
        let Some(training) = &mut self.training else { return Vec::new() };
        let words = training.errors.read();
        training.errors.write(&vec![0; words.len()]);
        words
            .as_chunks()
            .0
            .iter()
            .map(|&[low, high, count, _]: &[u32; WORDS_OF_CELL]| {
                [u64::from(high) << 32 | u64::from(low), count.into()]
            })
            .collect()
    }

    fn set_error_map(&mut self, map: ErrorMap) {
        if let Some(training) = &mut self.training {
            training.starts.write(map.starts());
        }
        self.policy.set_error_map(map);
    }

    fn camera_rays(&self, _: &mut Stream, camera: &Camera, range: Range<u32>, rays: &mut Rays<WgpuBackend>) {
        let pattern = self.policy.division.pattern(camera);
        make_room(rays, &range, 0..range.len() as u32 * pattern.count());
        rays.targets.resize(0);
        self.gpu.write(self.camera.raw(), &[GpuView::new(camera, 0, Grid::default())]);
        let params = Params {
            first: range.start,
            count: range.len() as u32,
            sides: [side_of(pattern); MOST_SCALES],
            ..self.params
        };
        let binds = [self.camera.bind(), rays.rays.bind(), rays.groups.bind()];
        self.gpu.dispatch(&self.kernels.camera_rays, &binds, &params, Size::Items(range.len() as u64));
    }
}
