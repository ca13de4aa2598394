//! Training, generic over backends. A model in training on any backend implements [`Session`].

mod align;
mod drawing;
mod growth;
mod probing;
pub(crate) mod rays;
mod state;
mod step;
mod sums;

pub use rays::{first_rays, most_kept};

use crate::{
    Backend, Camera, Config, Encoder, Error, Field, Frame, Layout, Query, Result, Session, StepReport,
    ViewSet, Viewer,
    config::Exposure,
    engine::{
        backend::{Loss, Occupancy, Optimizer, Sampler},
        batch::{PartialGradients, Radiance},
        checkpoint::{Checkpoint, TrainState},
        error_map::{CellErrors, ErrorMap},
        exchange::{Alone, Exchange},
        exposure::{self, Exposures},
        loaded::LoadedModel,
        poses::{Poses, Refined},
    },
    field::{encoders, model::Model},
    scene::{
        fingerprint::Fingerprint,
        hull::Hull,
        known_space::{Confinement, KnownSpace},
    },
};
use rays::{FIRST_KEPT_PER_RAY, LEAST_RAYS, first_kept_per_ray};
use std::collections::VecDeque;
use std::sync::Arc;

/// Expected marched samples per ray before the first step, when a random half of the grid's cells is occupied.
const FIRST_MARCHED_PER_RAY: f32 = 128.0;

/// A model in training on a backend.
pub struct Trainer<B: Backend> {
    loaded: LoadedModel<B>,
    gradient: B::Buffer<f32>,
    partials: Vec<PartialGradients<B>>,
    probes: B::Buffer<Radiance>,
    state: TrainState,
    /// Number of gradients that the run has left out, minus the optimiser's own counter, modulo 2^64. After a restore,
    /// the optimiser's counter may include gradients that do not belong to the run.
    left_out_before: u64,
    /// Sums of the last steps that are not yet used, oldest first.
    pending: VecDeque<sums::Pending<B>>,
    /// The error that made the parameters unusable: they hold the update of a step whose loss was not finite.
    spoilt: Option<Error>,
    exchange: Box<dyn Exchange<B>>,
    /// With `train.error_map`: the errors since the last update of the error map that were already collected from all
    /// ranks.
    errors: Vec<CellErrors>,
    /// Exposures of the photographs, with `loss.exposure`.
    exposures: Option<Exposures>,
    /// Poses of the photographs, with `train.cameras`.
    poses: Option<Poses>,
    /// False until the end of `field.direction_delay`.
    trains_directions: bool,
    /// Occupied and free space known from points of the scene, with `occupancy.seeded` or `occupancy.cleared`.
    known_space: Option<KnownSpace>,
}

impl<B: Backend> Trainer<B> {
    /// Creates an untrained model, to be trained on `views`.
    ///
    /// # Errors
    /// When the views have no pixels, or the configuration does not fit the device.
    pub fn new(backend: B, config: &Config, views: ViewSet) -> Result<Self> {
        Self::on(Arc::new(backend), config, views)
    }

    /// Creates an untrained model as [`new`](Self::new) does, on a device that is shared.
    fn on(backend: Arc<B>, config: &Config, views: ViewSet) -> Result<Self> {
        if views.pixels.is_empty() {
            return Err(Error::input(
                "training views",
                "have no pixels",
                "name a data set with training images",
            ));
        }
        ErrorMap::new(config, &views)?;
        let hull = config.occupancy.hull.then(|| Hull::of(config, &views)).flatten();
        let exposures = (config.loss.exposure == Exposure::Gain)
            .then(|| exposure::photographs(&views).into_iter().max().map_or(0, |last| last as usize + 1))
            .map(Exposures::new);
        let known_space = KnownSpace::of(config, &views);
        let poses = Poses::new(config, &views);
        let data = Some(Fingerprint::of(&views));
        let mut loaded = LoadedModel::build(backend, config, Some(views))?;
        if let Some(exposures) = &exposures {
            loaded.stages.loss.set_gains(&exposures.gains());
        }
        if let Some(Hull { bits, densities }) = hull {
            loaded.stages.occupancy.restore(&bits, Some(&densities));
        }
        let (backend, stages) = (&loaded.backend, &loaded.stages);
        let (cones, kept) = (stages.sampler.scale_weights().cones_per_pixel(), first_kept_per_ray(config));
        let partials = (0..backend.partials(config.train.samples_per_step))
            .map(|_| PartialGradients {
                field: stages.field.gradient(),
                encoder: stages.encoder.gradient(),
                sums: B::Sums::default(),
            })
            .collect();
        let mut trainer = Self {
            gradient: backend.zeros(loaded.layout.len()),
            probes: backend.zeros(0),
            state: TrainState {
                rays_per_step: ((f64::from(config.train.samples_per_step / kept) / cones) as u32)
                    .max(LEAST_RAYS),
                marched_per_ray: FIRST_MARCHED_PER_RAY * (kept / FIRST_KEPT_PER_RAY) as f32 * cones as f32,
                data,
                ..TrainState::default()
            },
            loaded,
            partials,
            left_out_before: 0,
            pending: VecDeque::new(),
            spoilt: None,
            exchange: Box::new(Alone),
            errors: Vec::new(),
            exposures,
            poses,
            trains_directions: true,
            known_space,
        };
        if trainer.known_space.is_some() {
            trainer.confine(Confinement::at(config, 0.0));
        }
        trainer.enter(encoders::of(config).stage(config, 0.0));
        trainer.loaded.refresh();
        Ok(trainer)
    }

    /// Makes the trainer train together with other ranks: every later step has the pixels of all ranks.
    pub fn exchange_by(&mut self, exchange: Box<dyn Exchange<B>>) {
        self.exchange = exchange;
    }

    /// Returns the log-gains (RGB) of each training photograph minus their mean, indexed by the numbers of
    /// [`exposure::photographs`]; empty without `loss.exposure`.
    pub fn log_gains(&self) -> Vec<[f64; 3]> {
        self.exposures.as_ref().map(Exposures::log_gains).unwrap_or_default()
    }

    /// Returns the backend, so that its counters can be read.
    pub fn device(&self) -> &B {
        self.loaded.device()
    }

    /// Waits for all recorded work and checks that the device still works.
    ///
    /// # Errors
    /// When the device has failed.
    pub fn health(&self) -> Result<()> {
        let backend = self.device();
        backend.read(&backend.zeros::<u32>(1));
        backend.health()
    }

    /// Returns the names and ranges of the parameters.
    pub fn layout(&self) -> &Layout {
        self.loaded.layout()
    }

    /// Returns all parameters as one flat array in the order of the [`layout`](Self::layout), padding included.
    pub fn parameters(&self) -> Vec<f32> {
        self.loaded.parameters()
    }

    /// Replaces all parameters with `values`, in the form of [`parameters`](Self::parameters).
    pub fn set_parameters(&mut self, values: &[f32]) {
        self.loaded.set_parameters(values);
    }

    /// Marks every cell of the occupancy grid as occupied.
    pub fn occupy_all(&mut self) {
        self.loaded.occupy_all();
    }

    fn count_left_out(&mut self) {
        self.state.totals.non_finite =
            self.left_out_before.wrapping_add(self.loaded.stages.optimizer.non_finite());
    }
}

impl<B: Backend> Viewer for Trainer<B> {
    fn backend(&self) -> &str {
        self.loaded.backend()
    }

    fn device_name(&self) -> String {
        self.loaded.device_name()
    }

    fn notes(&self) -> Vec<String> {
        self.loaded.notes()
    }

    fn render(&mut self, camera: &Camera) -> Result<Frame> {
        self.loaded.render(camera)
    }

    fn render_watched(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Frame>> {
        self.loaded.render_watched(camera, watch)
    }

    fn query(&mut self, queries: &[Query]) -> Result<Vec<Radiance>> {
        self.loaded.query(queries)
    }

    fn densities(&mut self, queries: &[Query]) -> Result<Vec<f32>> {
        self.loaded.densities(queries)
    }

    fn features(&mut self, queries: &[Query]) -> Result<Vec<f32>> {
        self.loaded.features(queries)
    }

    fn samples(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Vec<u32>>> {
        self.loaded.samples(camera, watch)
    }
}

impl<B: Backend> Session for Trainer<B> {
    fn step(&mut self, progress: f64) -> Result<StepReport> {
        let backend = Arc::clone(&self.loaded.backend);
        backend.install(|| self.train_step(progress))
    }

    fn model(&mut self) -> Result<Model> {
        self.full_model()
    }

    fn finish(&mut self) -> Result<Model> {
        self.finished_model()
    }

    fn checkpoint(&mut self) -> Result<Checkpoint> {
        self.save_state()
    }

    fn join_checkpoint(&mut self) -> Result<()> {
        self.gather()
    }

    fn restore(&mut self, checkpoint: &Checkpoint) -> Result<()> {
        self.load_state(checkpoint)
    }

    fn refined(&self) -> Option<Refined> {
        let (_, centre) = self.loaded.config.centred();
        self.poses.as_ref().map(|poses| poses.refined(centre))
    }

    fn align(&mut self, views: ViewSet) -> Result<Vec<Camera>> {
        self.aligned(views)
    }
}
