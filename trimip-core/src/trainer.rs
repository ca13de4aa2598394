//! The training step and the rendering of a view, written once over the traits: any backend's model is a [`Session`].

use crate::{
    Aabb, Backend, Camera, Config, Encoder, Error, Field, Frame, Layout, Optimizer, Pixel, Renderer, Result,
    Session, StepReport, ViewSet,
    adamw::learning_rate,
    backend::{Loss, Occupancy, Sampler, Stages},
    batch::{Deposit, Radiance, StepSums, Workspace},
    checkpoint::{Checkpoint, MOST_PENDING, OCCUPANCY_DENSITY, TrainState},
    config::FilePrecision,
    metrics::psnr_of_error,
    model::{Model, OCCUPANCY},
    run::progress,
    tensors::{Tensor, TensorFile},
    tri_mip::{Pyramid, grow},
};
use glam::DVec3;
use std::collections::VecDeque;
use std::sync::Arc;

/// Marched samples that a span aims at: what its activations leave of a core's L2.
const SAMPLES_PER_SPAN: f32 = 512.0;

/// Rays of a span at most, so that a view of empty pixels still makes many spans.
const MAX_RAYS_PER_SPAN: u32 = 256;

/// Occupancy cells of a span.
const CELLS_PER_SPAN: u32 = 512;

/// A model on a backend.
pub struct Trainer<B: Backend> {
    backend: Arc<B>,
    config: Config,
    /// Centre of the scene's box: the origin of what the stages see.
    centre: DVec3,
    layout: Layout,
    stages: Stages<B>,
    parameters: B::Buffer<f32>,
    gradient: B::Buffer<f32>,
    deposits: Vec<Deposit<B>>,
    probes: B::Buffer<Radiance>,
    frame: B::Buffer<Pixel>,
    state: TrainState,
    /// Gradients left out before the optimiser began to count.
    left_out_before: u64,
    /// Sums of the last steps that are not used yet, oldest first.
    pending: VecDeque<Pending<B>>,
}

/// Sums of a step that no later one has used.
struct Pending<B: Backend> {
    /// The marching step then, in uniform steps.
    scale: f64,
    sums: Arrival<B>,
}

/// Sums of a step.
enum Arrival<B: Backend> {
    /// On their way from the device.
    Posted(B::Receipt),
    /// Read and counted, because a checkpoint was taken since.
    Counted(StepSums),
}

impl<B: Backend> Trainer<B> {
    /// A fresh model, to be trained on `views`.
    pub fn new(backend: B, config: &Config, views: ViewSet) -> Result<Self> {
        if views.pixels.is_empty() {
            return Err(Error::input("training views", "no pixels", "name a data set with training images"));
        }
        Self::build(backend, config, Some(views))
    }

    /// A finished model, to render.
    pub fn from_model(backend: B, model: &Model) -> Result<Self> {
        let mut trainer = Self::build(backend, &model.config, None)?;
        trainer.restore_model("model", &model.file, None)?;
        trainer.stages.renderer.follow(1.0);
        Ok(trainer)
    }

    fn build(backend: B, config: &Config, views: Option<ViewSet>) -> Result<Self> {
        let training = views.is_some();
        let (centred, centre) = config.centred();
        let layout = Layout::new(&centred);
        let views = views.map(|mut views| {
            views.views.iter_mut().for_each(|view| view.camera.origin -= centre);
            views
        });
        let stages = backend.stages(&centred, views)?;
        let mut parameters = backend.zeros(layout.len());
        backend.write(&mut parameters, &layout.initial(config));
        let deposits = if training { backend.deposits(config.train.samples_per_step) } else { 0 };
        let deposits = (0..deposits)
            .map(|_| Deposit {
                field: stages.field.gradient(),
                encoder: stages.encoder.gradient(),
                sums: B::Sums::default(),
            })
            .collect();
        let mut trainer = Self {
            gradient: backend.zeros(if training { layout.len() } else { 0 }),
            probes: backend.zeros(0),
            frame: backend.zeros(0),
            state: TrainState {
                // The first rays meet a grid whose cells are occupied by chance, about every second one.
                rays_per_step: (config.train.samples_per_step / 256).max(16),
                marched_per_ray: 128.0,
                ..TrainState::default()
            },
            backend: Arc::new(backend),
            config: config.clone(),
            centre,
            layout,
            stages,
            parameters,
            deposits,
            left_out_before: 0,
            pending: VecDeque::new(),
        };
        if training {
            trainer.halve(config.encoder.halvings.at(0.0) as u32);
        }
        trainer.refresh();
        Ok(trainer)
    }

    /// The backend, for its counters.
    pub fn device(&self) -> &B {
        &self.backend
    }

    /// Waits for all that was recorded, and says whether the device still works.
    ///
    /// # Errors
    /// When it does not.
    pub fn health(&self) -> Result<()> {
        self.backend.read(&self.backend.zeros::<u32>(1));
        self.backend.health()
    }

    /// Names and places of the parameters.
    pub fn layout(&self) -> &Layout {
        &self.layout
    }

    /// All parameters, flat.
    pub fn parameters(&self) -> Vec<f32> {
        self.backend.read(&self.parameters)
    }

    /// Replaces all parameters.
    pub fn set_parameters(&mut self, values: &[f32]) {
        self.backend.write(&mut self.parameters, values);
        self.refresh();
    }

    /// Marks every cell of the occupancy grid as occupied.
    pub fn occupy_all(&mut self) {
        let cells = (self.config.occupancy.resolution as usize).pow(3);
        self.stages.occupancy.restore(&vec![0xff; cells.div_ceil(8)], Some(&vec![1.0; cells]));
    }

    fn count_left_out(&mut self) {
        self.state.totals.non_finite = self.left_out_before + self.stages.optimizer.non_finite();
    }

    /// Loss and gradient of the current parameters on the rays of step `step`, without moving them; the gradient is
    /// flat and divided by the sum of the weights.
    ///
    /// # Errors
    /// When the device fails.
    pub fn loss_and_gradient(&mut self, step: u64, rays: u32) -> Result<(StepSums, Vec<f32>)> {
        self.state.totals.step = step;
        let backend = Arc::clone(&self.backend);
        let receipt = backend.install(|| {
            self.gradients(rays);
            let receipt = self.backend.post(&self.deposits);
            self.stages.flush(&mut self.deposits, &mut self.gradient);
            receipt
        });
        let sums = self.backend.redeem(receipt)?;
        let gradient =
            self.backend.read(&self.gradient).iter().map(|g| (f64::from(*g) / sums.weight) as f32).collect();
        Ok((sums, gradient))
    }

    fn refresh(&mut self) {
        let Self { backend, stages, parameters, .. } = self;
        backend.install(|| {
            stages.encoder.refresh(parameters);
            stages.field.refresh(parameters);
        });
    }

    fn rays_per_span(&self) -> u32 {
        ((SAMPLES_PER_SPAN / self.state.marched_per_ray.max(1.0)) as u32).clamp(1, MAX_RAYS_PER_SPAN)
    }

    /// Forward and backward over `rays` rays; leaves the deposits full.
    fn gradients(&mut self, rays: u32) {
        let (backend, stages, parameters) = (&*self.backend, &self.stages, &self.parameters);
        let step = self.state.totals.step;
        for deposit in &mut self.deposits {
            deposit.sums = B::Sums::default();
        }
        let per_span = self.rays_per_span();
        self.backend.train_spans(
            &stages.field,
            rays,
            per_span,
            &mut self.deposits,
            &|space, deposit, range| {
                stages.sampler.training_rays(&mut space.lane, step, rays, range, &mut space.rays);
                forward(backend, stages, parameters, space, Some(step));
                let Workspace { lane, rays, samples, features, tape, radiance, pixels, .. } = space;
                stages.loss.evaluate(
                    lane,
                    rays,
                    samples,
                    pixels,
                    &mut space.pixel_gradients,
                    &mut deposit.sums,
                );
                let radiance_gradients = &mut space.radiance_gradients;
                stages.renderer.backward(
                    lane,
                    samples,
                    radiance,
                    pixels,
                    &space.pixel_gradients,
                    radiance_gradients,
                );
                let (feature_gradients, weights) = (&mut space.feature_gradients, &mut deposit.field);
                stages.field.backward(
                    lane,
                    samples,
                    features,
                    tape,
                    radiance,
                    radiance_gradients,
                    feature_gradients,
                    weights,
                );
                stages.encoder.backward(lane, samples, feature_gradients, &mut deposit.encoder);
            },
        );
    }

    /// Asks the occupancy grid's chosen cells for their density.
    fn refresh_occupancy(&mut self) {
        let step = self.state.totals.step;
        let count = self.stages.occupancy.choose(step);
        let (stages, parameters) = (&self.stages, &self.parameters);
        self.backend.map_spans(
            &stages.field,
            count,
            CELLS_PER_SPAN,
            &mut self.probes,
            &|space, range| {
                let Workspace { lane, samples, features, tape, radiance, .. } = space;
                stages.occupancy.probes(lane, step, range, samples);
                stages.encoder.forward(lane, parameters, samples, features);
                stages.field.density(lane, samples, features, tape, radiance);
            },
            &|space| &space.radiance,
        );
        self.stages.occupancy.absorb(&self.probes);
    }

    /// Lets every stage follow the schedules to `progress`; where the planes grow, moments grow along, and where the
    /// marching step shrinks, the batch has fewer rays of more samples.
    fn follow(&mut self, progress: f64) {
        self.stages.renderer.follow(progress);
        self.stages.sampler.follow(progress);
        let scale = self.config.renderer.step_scale.at(progress);
        if self.state.step_scale > 0.0 && self.state.step_scale != scale {
            let ratio = scale / self.state.step_scale;
            self.state.rays_per_step = ((f64::from(self.state.rays_per_step) * ratio) as u32).max(16);
            self.state.marched_per_ray /= ratio as f32;
        }
        self.state.step_scale = scale;
        let halvings = self.config.encoder.halvings.at(progress) as u32;
        if halvings >= self.state.halvings {
            return;
        }
        let mut values = self.parameters();
        self.grow(&mut values, halvings);
        self.backend.write(&mut self.parameters, &values);
        for moment in 0..2 {
            let mut values = self.backend.read(self.stages.optimizer.moments()[moment]);
            self.grow(&mut values, halvings);
            self.backend.write(self.stages.optimizer.moments_mut()[moment], &values);
        }
        self.halve(halvings);
        self.refresh();
    }

    /// Grows the planes at the front of `values` to `halvings` halvings.
    fn grow(&self, values: &mut [f32], halvings: u32) {
        let (config, _) = self.config.centred();
        let whole = Pyramid::new(&config.encoder, &Aabb::new(&config.scene));
        grow(values, &whole, self.state.halvings, halvings);
    }

    fn halve(&mut self, halvings: u32) {
        self.state.halvings = halvings;
        self.stages.encoder.halve(halvings);
        self.stages.optimizer.halve(halvings);
    }

    /// Scales the next step's rays so that its kept samples stay near the target (dynamic batch); `scale` is the marching
    /// step that the sums were made with.
    fn adapt_batch(&mut self, sums: &StepSums, scale: f64, progress: f64) {
        let part = self.config.train.batch_scale.at(progress);
        let target = (f64::from(self.config.train.samples_per_step) * part) as u64;
        let mut next = sums.rays * target / sums.kept.max(1) + 1;
        if scale != self.state.step_scale {
            next = (next as f64 * self.state.step_scale / scale) as u64;
        }
        // At most doubled, so that one thin batch does not make the next one enormous.
        let most = 2 * u64::from(self.state.rays_per_step);
        self.state.rays_per_step = next.min(most).clamp(16, 8 * target) as u32;
        self.state.marched_per_ray = sums.marched as f32 / sums.rays.max(1) as f32;
    }

    /// Adds the sums of a step to the totals.
    fn count(&mut self, sums: &StepSums) {
        let totals = &mut self.state.totals;
        totals.samples += sums.kept;
        totals.marched += sums.marched;
        totals.rays += sums.rays;
        totals.empty_batches += u64::from(sums.kept == 0);
    }

    /// The oldest sums that no step has used, counted, with their marching step; once there are more than the lag.
    fn oldest_sums(&mut self) -> Result<Option<(f64, StepSums)>> {
        if self.pending.len() <= B::LAG {
            return Ok(None);
        }
        let Some(Pending { scale, sums }) = self.pending.pop_front() else { return Ok(None) };
        Ok(Some((scale, self.arrived(sums)?)))
    }

    /// Waits for sums and counts them.
    fn arrived(&mut self, sums: Arrival<B>) -> Result<StepSums> {
        match sums {
            Arrival::Counted(sums) => Ok(sums),
            Arrival::Posted(receipt) => {
                let sums = self.backend.redeem(receipt)?;
                self.count(&sums);
                Ok(sums)
            }
        }
    }

    /// Reads all sums that are under way: what a checkpoint holds.
    fn settle(&mut self) -> Result<()> {
        self.state.pending = [None; MOST_PENDING];
        let first = self.state.totals.step.saturating_sub(self.pending.len() as u64);
        for (place, Pending { scale, sums }) in std::mem::take(&mut self.pending).into_iter().enumerate() {
            let sums = self.arrived(sums)?;
            finite(first + place as u64, &sums)?;
            self.pending.push_back(Pending { scale, sums: Arrival::Counted(sums) });
            self.state.pending[place] = Some((scale, sums));
        }
        Ok(())
    }

    fn train_step(&mut self, progress: f64) -> Result<StepReport> {
        let step = self.state.totals.step;
        self.follow(progress);
        if step.is_multiple_of(u64::from(self.config.occupancy.every)) {
            self.refresh_occupancy();
        }
        self.gradients(self.state.rays_per_step);
        let posted = Arrival::Posted(self.backend.post(&self.deposits));
        self.pending.push_back(Pending { scale: self.state.step_scale, sums: posted });
        // A backend without lag is asked before anything moves.
        let early = if B::LAG == 0 { self.oldest_sums()? } else { None };
        if let Some((_, sums)) = &early
            && let Err(error) = finite(step, sums)
        {
            self.stages.flush(&mut self.deposits, &mut self.gradient);
            return Err(error);
        }
        let rate = learning_rate(&self.config.optimizer, progress);
        let Self { backend, stages, parameters, gradient, deposits, .. } = self;
        backend.update(stages, parameters, gradient, deposits, rate, step + 1);
        backend.submit();
        let late = if B::LAG > 0 { self.oldest_sums()? } else { None };
        if let Some((_, sums)) = &late {
            finite(step.saturating_sub(B::LAG as u64), sums)?;
        }
        self.state.totals.step += 1;
        let sums = early.or(late);
        if let Some((scale, sums)) = &sums {
            self.adapt_batch(sums, *scale, progress);
        }
        self.count_left_out();
        let sums = sums.map_or_else(StepSums::default, |(_, sums)| sums);
        Ok(StepReport {
            totals: self.state.totals,
            loss: sums.loss / sums.weight.max(f64::MIN_POSITIVE),
            batch_psnr: psnr_of_error(sums.squared_error / (3 * sums.rays.max(1)) as f64),
            learning_rate: rate,
            occupied: self.stages.occupancy.occupied(),
        })
    }

    fn render_view(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Frame>> {
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        let count = width.checked_mul(height).ok_or_else(|| {
            Error::input("camera", format!("{width} x {height} pixels"), "render at most 2^32 pixels at once")
        })?;
        let (backend, stages, parameters) = (&*self.backend, &self.stages, &self.parameters);
        let camera = &Camera { origin: camera.origin - self.centre, ..*camera };
        let rows = (B::RAYS_OF_A_BAND / width.max(1)).clamp(1, height.max(1));
        let mut pixels = Vec::with_capacity(count as usize);
        for first in (0..height).step_by(rows as usize) {
            if !watch(first, height) {
                return Ok(None);
            }
            let (start, count) = (first * width, rows.min(height - first) * width);
            let frame = &mut self.frame;
            backend.install(|| {
                backend.map_spans(
                    &stages.field,
                    count,
                    MAX_RAYS_PER_SPAN / 4,
                    frame,
                    &|space, range| {
                        let range = start + range.start..start + range.end;
                        stages.sampler.camera_rays(&mut space.lane, camera, range, &mut space.rays);
                        forward(backend, stages, parameters, space, None);
                    },
                    &|space| &space.pixels,
                );
            });
            pixels.extend(self.backend.read(&self.frame));
            self.backend.health()?;
        }
        Ok(Some(Frame { width, height, pixels }))
    }

    fn restore_model(&mut self, name: &str, file: &TensorFile, densities: Option<&[f32]>) -> Result<()> {
        let values = self.layout.from_tensors(file, name, "")?;
        let cells = (self.config.occupancy.resolution as usize).pow(3);
        let bits = file.u8(name, OCCUPANCY, &[cells.div_ceil(8)])?;
        self.stages.occupancy.restore(bits, densities);
        self.set_parameters(&values);
        Ok(())
    }

    fn tensors(&self, values: &[f32]) -> TensorFile {
        let mut file = TensorFile::default();
        self.layout.to_tensors(values, "", &mut file);
        let bits = self.stages.occupancy.bits();
        file.tensors.insert(OCCUPANCY.into(), Tensor::u8(&[bits.len()], bits));
        file
    }
}

/// Refuses the sums of a step that are not finite.
fn finite(step: u64, sums: &StepSums) -> Result<()> {
    if sums.non_finite == 0 && sums.loss.is_finite() {
        return Ok(());
    }
    Err(Error::run(format!(
        "step {step}: {} of {} pixels are not finite (loss {}); lower optimizer.learning_rate",
        sums.non_finite, sums.rays, sums.loss
    )))
}

/// Rays to pixels: the part that training and rendering share.
fn forward<B: Backend>(
    backend: &B,
    stages: &Stages<B>,
    parameters: &B::Buffer<f32>,
    space: &mut Workspace<B>,
    jitter: Option<u64>,
) {
    backend.see(stages, parameters, space, jitter);
    let Workspace { lane, rays, samples, tape, radiance, pixels, .. } = space;
    stages.field.color(lane, rays, samples, tape, radiance);
    stages.renderer.composite(lane, rays, samples, radiance, pixels);
}

impl<B: Backend> Session for Trainer<B> {
    fn backend(&self) -> &str {
        self.backend.name()
    }

    fn device_name(&self) -> String {
        self.backend.device_name()
    }

    fn notes(&self) -> Vec<String> {
        self.backend.notes(&self.config)
    }

    fn step(&mut self, progress: f64) -> Result<StepReport> {
        let backend = Arc::clone(&self.backend);
        backend.install(|| self.train_step(progress))
    }

    fn render(&mut self, camera: &Camera) -> Result<Frame> {
        let frame = self.render_view(camera, &mut |_, _| true)?;
        // Nobody gave the view up.
        frame.ok_or_else(|| Error::run("a view was not rendered"))
    }

    fn render_watched(
        &mut self,
        camera: &Camera,
        watch: &mut dyn FnMut(u32, u32) -> bool,
    ) -> Result<Option<Frame>> {
        self.render_view(camera, watch)
    }

    fn model(&mut self) -> Result<Model> {
        let mut values = self.parameters();
        // A model's planes have their full size, whatever they have grown to in training.
        self.grow(&mut values, 0);
        let tensors = self.tensors(&values);
        self.backend.health()?;
        Ok(Model::new(self.config.clone(), tensors))
    }

    fn finish(&mut self) -> Result<Model> {
        let model = self.model()?.rounded();
        // What follows renders as the file does: by the end of the schedule, also where no step came so far.
        self.stages.renderer.follow(1.0);
        if model.config.file.planes != FilePrecision::F32 {
            // The model's planes have their full size, also where the run ended before they had grown to it.
            self.halve(0);
            self.restore_model("model", &model.file, None)?;
        }
        Ok(model)
    }

    fn checkpoint(&mut self) -> Result<Checkpoint> {
        self.settle()?;
        let mut file = self.tensors(&self.parameters());
        for (suffix, moments) in [".m", ".v"].into_iter().zip(self.stages.optimizer.moments()) {
            self.layout.to_tensors(&self.backend.read(moments), suffix, &mut file);
        }
        // A device's count is as new as its moments.
        self.count_left_out();
        let densities = self.stages.occupancy.densities();
        file.tensors.insert(OCCUPANCY_DENSITY.into(), Tensor::f32(&[densities.len()], densities));
        self.backend.health()?;
        Ok(Checkpoint { config: self.config.clone(), state: self.state, file })
    }

    fn restore(&mut self, checkpoint: &Checkpoint) -> Result<()> {
        let name = "checkpoint";
        let cells = (self.config.occupancy.resolution as usize).pow(3);
        let densities = checkpoint.file.f32(name, OCCUPANCY_DENSITY, &[cells])?;
        let first = self.layout.from_tensors(&checkpoint.file, name, ".m")?;
        let second = self.layout.from_tensors(&checkpoint.file, name, ".v")?;
        self.restore_model(name, &checkpoint.file, Some(densities))?;
        for (buffer, values) in self.stages.optimizer.moments_mut().into_iter().zip([first, second]) {
            self.backend.write(buffer, &values);
        }
        self.state = checkpoint.state;
        self.left_out_before =
            self.state.totals.non_finite.saturating_sub(self.stages.optimizer.non_finite());
        let counted = |(scale, sums)| Pending { scale, sums: Arrival::Counted(sums) };
        self.pending = self.state.pending.into_iter().flatten().map(counted).collect();
        self.halve(self.state.halvings);
        self.refresh();
        let progress = progress(&self.config, &self.state.totals);
        // A backend with less lag than the one that stopped has used these by now.
        while self.pending.len() > B::LAG {
            let Some((scale, sums)) = self.oldest_sums()? else { break };
            self.adapt_batch(&sums, scale, progress);
        }
        self.stages.renderer.follow(progress);
        self.stages.sampler.follow(progress);
        Ok(())
    }
}
