//! A backend with the stages for a small configuration, and synthetic photographs for a case.

use super::finding::Make;
use glam::DVec3;
use trimip_core::engine::backend::Stages;
use trimip_core::engine::batch::{Interval, Radiance, Ray, Samples, Segment, Sphere, Tile, Workspace};
use trimip_core::{
    Alpha, Backend, Camera, Config, Encoder, Field, Intrinsics, Layout, Pixel, Renderer, Result, Scale, View,
    ViewSet,
};

/// Returns the configuration of a small model: 16² planes, 16 hidden units.
pub fn small() -> Config {
    let mut config = Config::default();
    (config.encoder.plane_size, config.encoder.levels) = (16, 4);
    config.field.hidden = 16;
    config.renderer.steps_per_diagonal = 64;
    config.occupancy.resolution = 16;
    (config.occupancy.warmup, config.occupancy.every) = (8, 4);
    config.train.samples_per_step = 512;
    config.train.steps = 40;
    config
}

/// A backend and its stages.
pub struct Rig<B: Backend> {
    pub backend: B,
    pub stages: Stages<B>,
    pub workspace: Workspace<B>,
    pub parameters: B::Buffer<f32>,
}

impl<B: Backend> Rig<B> {
    /// Creates the stages of a configuration with its initial parameters, for rendering.
    pub fn new(make: Make<'_, B>, config: &Config) -> Result<Self> {
        let backend = make()?;
        let layout = Layout::new(config);
        let mut stages = backend.stages(config, None)?;
        let mut parameters = backend.zeros(layout.len());
        backend.write(&mut parameters, &layout.initial(config));
        backend.install(|| {
            stages.encoder.refresh(&parameters);
            stages.field.refresh(&parameters);
        });
        let workspace = Workspace::new(&backend, &stages.field);
        Ok(Self { backend, stages, workspace, parameters })
    }

    /// Uploads rays as those of the tile.
    pub fn rays(&mut self, rays: &[Ray]) {
        self.workspace.rays.place(&self.backend, rays);
    }

    /// Composites rays with the given samples, and backpropagates the gradient `by_pixel` of every pixel to the samples.
    pub fn composite(
        &mut self,
        rays: &[Vec<(Interval, Radiance)>],
        by_pixel: [f32; 4],
    ) -> (Vec<Pixel>, Vec<Radiance>) {
        let (mut segments, mut owners, mut intervals, mut radiance) = (vec![], vec![], vec![], vec![]);
        for (owner, samples) in rays.iter().enumerate() {
            segments.push(Segment { start: intervals.len() as u32, count: samples.len() as u32 });
            for (interval, value) in samples {
                owners.push(owner as u32);
                intervals.push(*interval);
                radiance.push(*value);
            }
        }
        let total = intervals.len() as u32;
        self.rays(&vec![Ray { cosine: 1.0, ..Ray::default() }; rays.len()]);
        let Self { backend, stages, workspace, parameters } = self;
        let Samples { segments: s, rays: r, intervals: v, spheres, counts } = &mut workspace.samples;
        backend.write(s, &segments);
        backend.write(r, &owners);
        backend.write(v, &intervals);
        backend.write(spheres, &vec![Sphere::default(); intervals.len()]);
        backend.write(counts, &[[total, total]]);
        backend.write(&mut workspace.radiance, &radiance);
        let (rays, samples, radiance) = (&workspace.rays, &workspace.samples, &workspace.radiance);
        let tile = &mut Tile { stream: &mut workspace.stream, parameters, rays, samples };
        stages.renderer.composite(tile, radiance, &mut workspace.cones, &mut workspace.pixels);
        backend.write(&mut workspace.pixel_gradients, &vec![by_pixel; segments.len()]);
        let (by_pixel, gradients) = (&workspace.pixel_gradients, &mut workspace.radiance_gradients);
        stages.renderer.backward(tile, radiance, &workspace.cones, by_pixel, gradients);
        (backend.read(&workspace.pixels), backend.read(&workspace.radiance_gradients))
    }

    /// Marches rays. Returns the sample distances of each ray, and the spheres of all samples.
    pub fn march(&mut self, rays: &[Ray]) -> (Vec<Vec<f32>>, Vec<Sphere>) {
        self.rays(rays);
        let Self { backend, stages, workspace, .. } = self;
        stages.renderer.march(
            &mut workspace.stream,
            &workspace.rays,
            &stages.occupancy,
            None,
            &mut workspace.samples,
        );
        let intervals = backend.read(&workspace.samples.intervals);
        let of = |s: &Segment| {
            intervals[s.start as usize..(s.start + s.count) as usize].iter().map(|i| i.t).collect()
        };
        let distances = backend.read(&workspace.samples.segments).iter().map(of).collect();
        (distances, backend.read(&workspace.samples.spheres))
    }

    /// Returns the features of spheres, 48 per sphere.
    pub fn features(&mut self, spheres: &[Sphere]) -> Vec<f32> {
        let count = spheres.len() as u32;
        let Self { backend, stages, workspace, parameters } = self;
        workspace.rays.place(backend, &[Ray::default()]);
        let Samples { segments, rays, intervals, spheres: buffer, counts } = &mut workspace.samples;
        backend.write(intervals, &vec![Interval::default(); spheres.len()]);
        backend.write(segments, &[Segment { start: 0, count }]);
        backend.write(rays, &vec![0; spheres.len()]);
        backend.write(buffer, spheres);
        backend.write(counts, &[[count, count]]);
        let (rays, samples) = (&workspace.rays, &workspace.samples);
        let tile = &mut Tile { stream: &mut workspace.stream, parameters, rays, samples };
        stages.encoder.forward(tile, &mut workspace.encoder_context, &mut workspace.features);
        backend.read(&workspace.features)
    }
}

/// Returns a square camera of `size` pixels per side on a circle around the box.
pub fn camera(size: u32, i: u32) -> Camera {
    let angle = f64::from(i);
    let origin = DVec3::new(4.0 * angle.cos(), 4.0 * angle.sin(), 1.0);
    Camera::look_at(Intrinsics::from_angle(size, size, 0.7), origin, DVec3::ZERO, DVec3::Z)
}

/// Returns a pseudo-random colour.
pub fn hash(view: usize, x: usize, y: usize) -> [u8; 4] {
    let mut word = (view * 7919 + x * 104_729 + y * 1_299_709 + 17) as u32;
    word = (word ^ (word >> 15)).wrapping_mul(0x2c1b_3c6d);
    word = (word ^ (word >> 12)).wrapping_mul(0x297a_2d39);
    (word ^ (word >> 15)).to_le_bytes()
}

/// Returns photographs of `cameras` at `scales` scales; `pixel(view, x, y)` returns straight RGBA at every scale.
pub fn photographs(
    cameras: &[Camera],
    scales: u32,
    pixel: impl Fn(usize, usize, usize) -> [u8; 4],
) -> ViewSet {
    let mut set = ViewSet {
        views: vec![],
        pixels: Default::default(),
        alpha: Alpha::Straight,
        scales: vec![],
        depths: Vec::new(),
    };
    for level in 0..scales {
        let (first_view, first_pixel) = (set.views.len(), set.pixels.len());
        for (i, camera) in cameras.iter().enumerate() {
            let intrinsics = camera.intrinsics.reduced(level);
            let offset = set.pixels.len();
            let name = format!("view {i}");
            set.views.push(View { name, camera: Camera { intrinsics, ..*camera }, offset });
            let (width, height) = (intrinsics.width as usize, intrinsics.height as usize);
            set.pixels.extend((0..width * height).map(|p| pixel(i, p % width, p / width)));
        }
        set.scales.push(Scale {
            factor: 1 << level,
            weight: 4_f32.powi(level as i32),
            views: first_view..set.views.len(),
            pixels: first_pixel..set.pixels.len(),
        });
    }
    set
}
