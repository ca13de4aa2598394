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
use trimip_core::engine::policy::SamplerPolicy;
use trimip_core::engine::ray_allocation::RayAllocation;
use trimip_core::geometry::lens::MOST_ROUNDS;
use trimip_core::math::rng::Sequence;
use trimip_core::scene::cones::PixelPattern;
use trimip_core::scene::depths::KnownDepth;
use trimip_core::scene::views::Alpha;
use trimip_core::{Camera, Config, Error, Result, ViewSet};

/// Maximum number of threads that look up a step's pixels on the host.
const MOST_THREADS: usize = 8;

/// Maximum number of scales of a data set.
const MOST_SCALES: usize = 8;

/// Cones along a side that stand for the quincunx on the device. No grid has as many.
const QUINCUNX: u32 = 0x100;

shared! {
    /// A camera and the place of its pixels.
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
        /// 0 for a pinhole, otherwise one more than the camera model's place in its registry.
        lens: u32,
        /// The lens, with the letters of [`trimip_core::geometry::lens`]: k1 to k4; d1 to d3 and the domain; p1, p2, s1, s2.
        radial: [f32; 4],
        denominator: [f32; 4],
        shift: [f32; 4],
    }

    /// A scale of the training views.
    struct GpuScale as Scale {
        first_pixel: u32,
        pixels: u32,
        first_view: u32,
        views: u32,
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
        /// What alpha is, see [`meaning`].
        alpha: u32,
        /// 1 if `pixels` holds only the drawn pixels, in the order of the rays.
        streamed: u32,
        /// Index within the step of the tile's first cone.
        first_cone: u32,
        /// Number of known depths.
        depths: u32,
        /// Pixels of the step from this index on belong to this scale or a coarser one.
        begins: [u32; MOST_SCALES],
        /// By scale: loss weight of a pixel, its cones ([`side_of`]), edge exponent of its photographs.
        weights: [f32; MOST_SCALES],
        sides: [u32; MOST_SCALES],
        exponents: [f32; MOST_SCALES],
    }
}

/// Cameras and the cones of their pixels.
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

const DRAW: Source = Text(include_str!("shaders/draw.wgsl"));
const RAYS: [Source; 8] = [
    GRID,
    RANDOM,
    CAMERA,
    TARGET,
    Source::of::<GpuScale>(),
    Source::of::<Params>(),
    DRAW,
    Text(include_str!("shaders/rays.wgsl")),
];
const KNOWN_DEPTHS: [Source; 8] = [
    GRID,
    RANDOM,
    TARGET,
    Source::of::<GpuScale>(),
    Source::of::<Params>(),
    Source::of::<KnownDepth>(),
    DRAW,
    Text(include_str!("shaders/known_depths.wgsl")),
];
const PHOTOGRAPHS_NONE: Source = Text(include_str!("shaders/photographs_none.wgsl"));
const PHOTOGRAPHS_KEPT: Source = Text(include_str!("shaders/photographs_kept.wgsl"));

/// The kernel that generates the rays of a training step.
fn training_rays() -> Kernel {
    Kernel::new(
        "training_rays",
        &RAYS,
        &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read), (5, Write), (6, Write)],
    )
}

kernels! {
    /// The kernels of ray generation.
    pub struct Kernels {
        camera_rays: Kernel::new("camera_rays", &RAYS, &[(0, Read), (1, Write), (2, Parameters), (6, Write)])
            .and(&[PHOTOGRAPHS_NONE], &[]),
        training_rays: training_rays().and(&[PHOTOGRAPHS_NONE], &[]),
        /// The same, and each pixel keeps the number of its photograph.
        training_rays_exposed: training_rays().and(&[PHOTOGRAPHS_KEPT], &[(7, Write), (8, Read)]),
        /// Gives targets their known depths.
        known_depths: Kernel::new("known_depths", &KNOWN_DEPTHS, &[(2, Parameters), (4, Read), (5, Write), (9, Read)]),
    }
}

impl GpuView {
    fn new(camera: &Camera, offset: usize) -> Self {
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
        }
    }
}

/// The training views on the device, and the policy by which a step's pixels are drawn from them.
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
    /// All pixels, or only those of a step's rays.
    pixels: Mutex<Buffer<u32>>,
    /// All pixels, if they stay on the host.
    host: Option<trimip_core::Pixels>,
    scales: Buffer<GpuScale>,
    /// Index of the first pixel of each view.
    offsets: Vec<usize>,
    /// The photograph of each view, with `loss.exposure` or refined poses.
    photographs: Option<Buffer<u32>>,
    /// Sorted by pixel.
    depths: Buffer<KnownDepth>,
}

impl WgpuSampler {
    /// A sampler over `views`. Without views it generates camera rays only.
    ///
    /// # Errors
    /// When the photographs exceed the device's largest binding.
    pub fn new(gpu: &Arc<Gpu>, config: &Config, views: Option<ViewSet>) -> Result<Self> {
        let policy = SamplerPolicy::new(config, views.as_ref());
        let mut params = Params {
            background: policy.background,
            scales: policy.scales.len() as u32,
            exponents: padded(policy.exponents.iter().copied(), 0.0),
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

/// The number by which the device knows what alpha is.
fn meaning(alpha: Alpha) -> u32 {
    match alpha {
        Alpha::Straight => 0,
        Alpha::Premultiplied => 1,
        Alpha::Kept => 2,
    }
}

/// The number by which the device knows the cones of a pixel: those along a side of a grid, or [`QUINCUNX`].
fn side_of(pattern: PixelPattern) -> u32 {
    match pattern {
        PixelPattern::Grid(side) => side,
        PixelPattern::Quincunx => QUINCUNX,
    }
}

/// Makes room for the cones of the pixels of a tile, which are numbers `cones` of the step.
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
                format!("{bytes} bytes of pixels, and the device binds at most {most} at once"),
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
            scales: Buffer::zeros(gpu, 0),
            offsets: views.views.iter().map(|view| view.offset).collect(),
            photographs: (!policy.photographs.is_empty()).then(|| Buffer::zeros(gpu, 0)),
            depths: Buffer::zeros(gpu, 0),
        };
        training.place(&views.views.iter().map(|view| view.camera).collect::<Vec<_>>());
        if let Some(of_views) = &mut training.photographs {
            of_views.write(&policy.photographs);
        }
        let scales: Vec<GpuScale> = views
            .scales
            .iter()
            .map(|scale| GpuScale {
                first_pixel: scale.pixels.start as u32,
                pixels: scale.pixels.len() as u32,
                first_view: scale.views.start as u32,
                views: scale.views.len() as u32,
            })
            .collect();
        training.scales.write(&scales);
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
        let views = cameras.iter().zip(&self.offsets).map(|(camera, offset)| GpuView::new(camera, *offset));
        self.views.write(&views.collect::<Vec<_>>());
    }
}

/// Looks up the pixels `range` of a step, with the same random numbers as the device. A few threads share the work.
fn look_up(
    policy: &SamplerPolicy,
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
                    *word = u32::from_le_bytes(host[policy.pixel(step, allocation, index).1]);
                }
            });
        }
    });
    words
}

/// The values, followed by `rest`, which nothing reads.
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
            pixels.write(&look_up(policy, host, step, allocation, range.clone()));
        }
        let Training { views, scales, photographs: of_views, .. } = training;
        rays.photographs.resize(if of_views.is_some() { range.len() } else { 0 });
        let mut binds = Binds::new(views.bind()).and([
            rays.rays.bind(),
            pixels.bind(),
            scales.bind(),
            rays.targets.bind(),
            rays.groups.bind(),
        ]);
        let mut kernel = &self.kernels.training_rays;
        if let Some(of_views) = of_views {
            kernel = &self.kernels.training_rays_exposed;
            binds = binds.and([rays.photographs.bind(), of_views.bind()]);
        }
        let items = Size::Items(range.len() as u64);
        self.gpu.dispatch(kernel, &binds, &params, items);
        if policy.knows_depths() && params.depths > 0 {
            let binds = [scales.bind(), rays.targets.bind(), training.depths.bind()];
            self.gpu.dispatch(&self.kernels.known_depths, &binds, &params, items);
        }
    }

    fn camera_rays(&self, _: &mut Stream, camera: &Camera, range: Range<u32>, rays: &mut Rays<WgpuBackend>) {
        let pattern = self.policy.division.pattern(camera);
        make_room(rays, &range, 0..range.len() as u32 * pattern.count());
        rays.targets.resize(0);
        self.gpu.write(self.camera.raw(), &[GpuView::new(camera, 0)]);
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
