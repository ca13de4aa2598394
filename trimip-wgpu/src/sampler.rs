//! Where rays come from on the GPU: views, pixels and scales live on the device.

use crate::backend::{Lane, WgpuBackend};
use crate::buffer::Buffer;
use crate::device::{Gpu, Size};
use crate::kernel::{CAMERA_RAYS, TRAINING_RAYS};
use bytemuck::{Pod, Zeroable};
use std::ops::Range;
use std::sync::Arc;
use trimip_core::backend::Sampler;
use trimip_core::balance::Balance;
use trimip_core::batch::Rays;
use trimip_core::config::TrainBackground;
use trimip_core::rng::{Random, Stream};
use trimip_core::schedule::Schedule;
use trimip_core::views::Alpha;
use trimip_core::{Camera, Config, Error, Result, Scale, ViewSet};

/// Scales that a set may have.
const MOST_SCALES: usize = 8;

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct GpuView {
    pose: [[f32; 4]; 3],
    intrinsics: [f32; 4],
    disc: f32,
    width: u32,
    offset: u32,
    padding: u32,
}

impl GpuView {
    fn new(camera: &Camera, offset: usize) -> Self {
        let k = &camera.intrinsics;
        let axes = camera.rotation.to_cols_array_2d();
        let origin = camera.origin.to_array();
        Self {
            pose: [0, 1, 2].map(|i| [axes[0][i], axes[1][i], axes[2][i], origin[i]].map(|x| x as f32)),
            intrinsics: [k.fx, k.fy, k.cx, k.cy].map(|x| x as f32),
            disc: (std::f64::consts::PI * k.fx * k.fy).sqrt().recip() as f32,
            width: k.width,
            offset: offset as u32,
            padding: 0,
        }
    }
}

#[repr(C)]
#[derive(Clone, Copy, Default, Pod, Zeroable)]
struct GpuScale {
    first_pixel: u32,
    pixels: u32,
    first_view: u32,
    views: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Default, Pod, Zeroable)]
struct Params {
    draws: [u32; 4],
    background_draws: [u32; 4],
    background: [f32; 3],
    random_background: u32,
    total: u32,
    first: u32,
    count: u32,
    scales: u32,
    premultiplied: u32,
    padding: [u32; 3],
    begins: [u32; MOST_SCALES],
    weights: [f32; MOST_SCALES],
}

/// Training views on the device, and how rays are shared among their scales.
pub struct WgpuSampler {
    gpu: Arc<Gpu>,
    schedule: Schedule,
    training: Option<Training>,
    camera: Buffer<GpuView>,
    random: Random,
    params: Params,
}

struct Training {
    views: Buffer<GpuView>,
    pixels: Buffer<u32>,
    scales: Buffer<GpuScale>,
    /// The scales as the host knows them.
    shared: Vec<Scale>,
    balance: Balance,
}

impl WgpuSampler {
    /// A sampler over `views`; without them it makes camera rays only.
    ///
    /// # Errors
    /// When the photographs do not fit into a binding of the device.
    pub fn new(gpu: &Arc<Gpu>, config: &Config, views: Option<ViewSet>) -> Result<Self> {
        let mut params = Params { background: config.data.background, ..Params::default() };
        let training = match views {
            None => None,
            Some(views) => {
                params.random_background = u32::from(config.train.background == TrainBackground::Random);
                params.premultiplied = u32::from(views.alpha == Alpha::Premultiplied);
                params.scales = views.scales.len() as u32;
                Some(Training::new(gpu, &views)?)
            }
        };
        let random = Random::new(config.seed);
        let schedule = config.train.scale_balance.clone();
        let mut sampler =
            Self { gpu: Arc::clone(gpu), schedule, training, camera: Buffer::zeros(gpu, 1), random, params };
        sampler.follow(0.0);
        Ok(sampler)
    }
}

impl Training {
    fn new(gpu: &Arc<Gpu>, views: &ViewSet) -> Result<Self> {
        let most = gpu.limits().max_storage_buffer_binding_size;
        let bytes = 4 * views.pixels.len() as u64;
        if bytes > most {
            return Err(Error::input(
                "training views",
                format!("{bytes} bytes of pixels, and the device binds at most {most} at once"),
                "train on fewer or smaller photographs, or use backend = \"cpu\"",
            ));
        }
        if views.scales.len() > MOST_SCALES {
            return Err(Error::input(
                "data.scales",
                format!("{} scales", views.scales.len()),
                format!("use at most {MOST_SCALES} on the GPU"),
            ));
        }
        let mut training = Self {
            views: Buffer::zeros(gpu, 0),
            pixels: Buffer::zeros(gpu, 0),
            scales: Buffer::zeros(gpu, 0),
            shared: views.scales.clone(),
            balance: Balance::default(),
        };
        let table: Vec<GpuView> = views.views.iter().map(|v| GpuView::new(&v.camera, v.offset)).collect();
        training.views.write(&table);
        training.pixels.write(bytemuck::cast_slice(&views.pixels));
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
        Ok(training)
    }
}

/// The values in front of others that nothing reads.
fn padded<T: Copy>(values: impl Iterator<Item = T>, rest: T) -> [T; MOST_SCALES] {
    let mut all = [rest; MOST_SCALES];
    all.iter_mut().zip(values).for_each(|(place, value)| *place = value);
    all
}

impl Sampler<WgpuBackend> for WgpuSampler {
    fn follow(&mut self, progress: f64) {
        if let Some(training) = &mut self.training {
            training.balance = Balance::new(&training.shared, self.schedule.at(progress));
        }
    }

    fn training_rays(
        &self,
        _: &mut Lane,
        step: u64,
        total: u32,
        range: Range<u32>,
        rays: &mut Rays<WgpuBackend>,
    ) {
        rays.first = range.start;
        rays.rays.resize(range.len());
        rays.targets.resize(range.len());
        let Some(training) = &self.training else {
            rays.rays.resize(0);
            rays.targets.resize(0);
            return;
        };
        let params = Params {
            draws: self.random.at(Stream::Pixel, step).words(),
            background_draws: self.random.at(Stream::Background, step).words(),
            total,
            first: range.start,
            count: range.len() as u32,
            begins: padded(training.balance.begins(total), u32::MAX),
            weights: padded(training.balance.weights().iter().copied(), 0.0),
            ..self.params
        };
        let Training { views, pixels, scales, .. } = training;
        let binds = [views.bind(), rays.rays.bind(), pixels.bind(), scales.bind(), rays.targets.bind()];
        self.gpu.dispatch(&TRAINING_RAYS, &binds, &params, Size::Items(range.len() as u64));
    }

    fn camera_rays(&self, _: &mut Lane, camera: &Camera, range: Range<u32>, rays: &mut Rays<WgpuBackend>) {
        rays.first = range.start;
        rays.targets.resize(0);
        rays.rays.resize(range.len());
        self.gpu.write(self.camera.raw(), &[GpuView::new(camera, 0)]);
        let params = Params { first: range.start, count: range.len() as u32, ..self.params };
        let binds = [self.camera.bind(), rays.rays.bind()];
        self.gpu.dispatch(&CAMERA_RAYS, &binds, &params, Size::Items(range.len() as u64));
    }
}
