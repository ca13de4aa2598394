//! The tests that every backend must pass, written against the traits. Each test takes a function that creates a fresh
//! backend, so testing a new backend takes one more line.

pub mod cones;
pub mod contraction;
pub mod distortion;
pub mod drawing;
pub mod exchange;
pub mod exposure;
pub mod gradients;
pub mod hybrid;
pub mod looking;
pub mod losses;
pub mod marching;
pub mod masks;
pub mod poses;
pub mod probes;
pub mod projections;
pub mod pyramid;
pub mod sampling;
pub mod scenes;
pub mod seeing;
pub mod stages;
pub mod training;
pub mod units;

use trimip_core::{
    Backend, Config, Encoder, Field, Layout, Result, ViewSet,
    engine::{
        backend::Stages,
        batch::{Interval, Ray, Samples, Segment, Sphere, Tile, Workspace},
    },
};

/// A backend, the stages of a configuration with uploaded parameters, and a workspace.
pub struct Bench<B: Backend> {
    /// The device.
    pub backend: B,
    /// Stages of the configuration.
    pub stages: Stages<B>,
    /// Buffers of one batch.
    pub workspace: Workspace<B>,
    /// The parameters on the device.
    pub parameters: B::Buffer<f32>,
}

impl<B: Backend> Bench<B> {
    /// Creates the stages and uploads the parameters.
    ///
    /// # Errors
    /// When the backend refuses the configuration.
    pub fn new(backend: B, config: &Config, views: Option<ViewSet>, parameters: &[f32]) -> Result<Self> {
        assert_eq!(parameters.len(), Layout::new(config).len(), "one value per parameter");
        let mut stages = backend.stages(config, views)?;
        let mut buffer = backend.zeros(parameters.len());
        backend.write(&mut buffer, parameters);
        backend.install(|| {
            stages.encoder.refresh(&buffer);
            stages.field.refresh(&buffer);
        });
        let workspace = Workspace::new(&backend, &stages.field);
        Ok(Self { backend, stages, workspace, parameters: buffer })
    }

    /// Places `spheres` as the samples of one ray.
    pub fn place(&mut self, spheres: &[Sphere]) {
        self.place_on(&[Ray::default()], &vec![Interval::default(); spheres.len()], spheres);
    }

    /// Places `spheres` as the samples of `rays`, an equal number on each.
    pub fn place_on(&mut self, on: &[Ray], at: &[Interval], spheres: &[Sphere]) {
        let (total, count) = (spheres.len() as u32, spheres.len() / on.len());
        assert_eq!(count * on.len(), spheres.len(), "the same number of samples on every ray");
        let Samples { segments, rays, intervals, spheres: buffer, counts } = &mut self.workspace.samples;
        let segment = |ray: usize| Segment { start: (ray * count) as u32, count: count as u32 };
        self.workspace.rays.place(&self.backend, on);
        self.backend.write(intervals, at);
        self.backend.write(segments, &(0..on.len()).map(segment).collect::<Vec<_>>());
        self.backend.write(rays, &(0..total).map(|i| i / count as u32).collect::<Vec<_>>());
        self.backend.write(buffer, spheres);
        self.backend.write(counts, &[[total, total]]);
    }

    /// Returns the features of the placed samples, in rows of the encoder's stride.
    pub fn features(&mut self) -> Vec<f32> {
        let Self { backend, stages, workspace, parameters } = self;
        let (rays, samples) = (&workspace.rays, &workspace.samples);
        let tile = &mut Tile { stream: &mut workspace.stream, parameters, rays, samples };
        stages.encoder.forward(tile, &mut workspace.encoder_context, &mut workspace.features);
        backend.read(&workspace.features)
    }
}

/// Converts parameters to f64 for the reference.
pub fn wide(parameters: &[f32]) -> Vec<f64> {
    parameters.iter().map(|&x| x.into()).collect()
}
