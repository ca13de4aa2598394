//! One training step: refresh of the occupancy grid, gradients, exchange between machines, update of the parameters.

use super::{
    Trainer,
    rays::{LEAST_RAYS, MOST_RAYS_PER_SAMPLE},
    sums::{Arrival, Pending, finite},
};
use crate::{
    Backend, Encoder, Field, Renderer, Result, StepReport,
    engine::{
        backend::{Loss, Occupancy, PoseGradients, RenderedTile, Sampler, Stages},
        batch::{
            Batch, FieldBackward, FieldDraw, PartialGradients, SampleDraw, StepSums, Tile, Tiling, Update,
            Workspace,
        },
        loaded::forward,
    },
    field::adamw::learning_rate,
    measures::metrics::psnr_of_error,
};

/// Target number of marched samples per tile: the activations of this many samples fit into a core's L2 cache.
const SAMPLES_PER_TILE: f32 = 512.0;

/// Maximum number of rays per tile. It limits tiles of rays through empty space, which have no samples.
const MAX_RAYS_PER_TILE: u32 = 256;

/// Number of occupancy cells per tile.
const CELLS_PER_TILE: u32 = 512;

/// Maps pixels to the loss, and propagates its gradient back to the tile's partial gradients.
fn backward<B: Backend>(
    stages: &Stages<B>,
    parameters: &B::Buffer<f32>,
    workspace: &mut Workspace<B>,
    partial: &mut PartialGradients<B>,
    draw: Option<&SampleDraw>,
) {
    let Workspace {
        stream,
        rays,
        samples,
        encoder_context,
        features,
        field_context,
        radiance,
        cones,
        pixels,
        kept,
        marks,
        ..
    } = workspace;
    let (pixel_gradients, sums) = (&mut workspace.pixel_gradients, &mut partial.sums);
    let (radiance_gradients, feature_gradients) =
        (&mut workspace.radiance_gradients, &mut workspace.feature_gradients);
    let rendered = RenderedTile { rays, samples, radiance, pixels };
    stages.loss.evaluate_pixels(stream, &rendered, pixel_gradients, sums);
    let tile = &mut Tile { stream, parameters, rays, samples };
    stages.renderer.backward(tile, radiance, cones, pixel_gradients, radiance_gradients);
    stages.loss.evaluate_rays(tile.stream, &rendered, radiance_gradients, sums);
    if let Some(draw) = draw {
        let arrays = FieldDraw { radiance, radiance_gradients, marks };
        stages.field.draw(tile, draw, field_context, arrays);
        stages.renderer.keep_drawn(stream, marks, samples, kept, sums);
        stages.encoder.keep(stream, kept, encoder_context, features);
        stages.field.keep_drawn(stream, kept, field_context, radiance, radiance_gradients);
    }
    let tile = &mut Tile { stream, parameters, rays, samples };
    let arrays = FieldBackward { features, radiance, radiance_gradients, feature_gradients };
    stages.field.backward(tile, arrays, field_context, &mut partial.field);
    stages.encoder.backward(tile, encoder_context, &workspace.feature_gradients, &mut partial.encoder);
}

/// Adds the derivatives with respect to the poses of the tile's photographs to the sums: encodes the samples on
/// displaced rays, in two forward passes of the encoder.
fn pose_gradients<B: Backend>(
    stages: &Stages<B>,
    parameters: &B::Buffer<f32>,
    workspace: &mut Workspace<B>,
    partial: &mut PartialGradients<B>,
    step: u64,
) {
    let Some(poses) = &stages.poses else { return };
    let Workspace { stream, rays, samples, feature_gradients, displaced, .. } = workspace;
    for side in [1.0, -1.0] {
        poses.displace(&mut Tile { stream, parameters, rays, samples }, step, side, displaced);
        std::mem::swap(&mut rays.rays, &mut displaced.rays);
        std::mem::swap(&mut samples.spheres, &mut displaced.spheres);
        let tile = &mut Tile { stream, parameters, rays, samples };
        stages.encoder.forward(tile, &mut displaced.encoder_context, &mut displaced.features);
        std::mem::swap(&mut rays.rays, &mut displaced.rays);
        std::mem::swap(&mut samples.spheres, &mut displaced.spheres);
        poses.compare(&mut Tile { stream, parameters, rays, samples }, side, feature_gradients, displaced);
    }
    let tile = &mut Tile { stream, parameters, rays, samples };
    poses.add(tile, step, &displaced.slopes, &mut partial.sums);
}

impl<B: Backend> Trainer<B> {
    fn cones_per_tile(&self) -> u32 {
        let cones_per_pixel = self.loaded.stages.sampler.scale_weights().cones_per_pixel() as f32;
        let marched_per_cone = self.state.marched_per_ray / cones_per_pixel;
        ((SAMPLES_PER_TILE / marched_per_cone.max(1.0)) as u32).clamp(1, MAX_RAYS_PER_TILE)
    }

    /// Runs the forward and backward passes over `pixels` pixels; the partial gradients then hold the gradients.
    /// Without a draw, all samples have a backward pass.
    pub(super) fn gradients(&mut self, pixels: u32, draw: Option<&SampleDraw>) {
        let step = self.state.totals.step;
        for partial in &mut self.partials {
            partial.sums = B::Sums::default();
        }
        let (backend, stages, parameters) =
            (&*self.loaded.backend, &self.loaded.stages, &self.loaded.parameters);
        let allocation = stages.sampler.scale_weights().allocate(pixels);
        let batch = Batch {
            allocation: &allocation,
            this_rank: self.exchange.rank(),
            per_tile: self.cones_per_tile(),
        };
        backend.train_tiles(&stages.field, &batch, &mut self.partials, &|workspace, partial, range| {
            stages.sampler.training_rays(
                &mut workspace.stream,
                step,
                &allocation,
                range.clone(),
                &mut workspace.rays,
            );
            forward(stages, parameters, workspace, Some(step));
            backward(stages, parameters, workspace, partial, draw);
            pose_gradients(stages, parameters, workspace, partial, step);
            let Workspace { stream, rays, pixel_gradients, .. } = workspace;
            stages.sampler.observe(stream, step, range, rays, pixel_gradients);
        });
    }

    /// Refreshes the occupancy grid with the densities of the cells that it selects.
    fn refresh_occupancy(&mut self) {
        let step = self.state.totals.step;
        let count = self.loaded.stages.occupancy.select(step);
        let (stages, parameters) = (&self.loaded.stages, &self.loaded.parameters);
        self.loaded.backend.map_tiles(
            &stages.field,
            Tiling { count, per_tile: CELLS_PER_TILE },
            &mut self.probes,
            &|workspace, range| {
                let Workspace { stream, rays, samples, .. } = workspace;
                stages.occupancy.probes(stream, step, range, rays, samples);
                stages.density(parameters, workspace);
            },
            &|workspace| &workspace.radiance,
        );
        self.loaded.stages.occupancy.update(&self.probes);
    }

    /// Adapts the number of pixels so that the next step keeps about the target number of samples (dynamic batch).
    /// `spacing` is the spacing of the step that had these sums, see
    /// [`TrainState`](crate::engine::checkpoint::TrainState).
    pub(super) fn adapt_batch(&mut self, sums: &StepSums, spacing: f64, progress: f64) {
        let train = &self.loaded.config.train;
        let target = (f64::from(train.samples_per_step) * train.batch_scale.at(progress)) as u64;
        let mut next = sums.rays * target / sums.kept.max(1) + 1;
        if spacing != self.state.spacing {
            next = (next as f64 * self.state.spacing / spacing) as u64;
        }
        // The number at most doubles, so that one batch with few samples does not make the next batch huge.
        let most = 2 * u64::from(self.state.rays_per_step);
        let cones_per_pixel = self.loaded.stages.sampler.scale_weights().cones_per_pixel();
        let limit =
            (((MOST_RAYS_PER_SAMPLE * target) as f64 / cones_per_pixel) as u64).max(LEAST_RAYS.into());
        self.state.rays_per_step = next.min(most).clamp(LEAST_RAYS.into(), limit) as u32;
        self.state.marched_per_ray = sums.marched as f32 / sums.rays.max(1) as f32;
        self.adapt_draw(sums, progress);
    }

    /// Computes new parameters from the partial gradients of all ranks.
    fn update(&mut self, rate: f64, step: u64) -> Result<()> {
        let Self { loaded, gradient, partials, exchange, .. } = self;
        let (backend, stages, parameters) = (&*loaded.backend, &mut loaded.stages, &mut loaded.parameters);
        stages.reduce(partials, parameters, gradient);
        let update = &mut Update { parameters, gradient, partials, learning_rate: rate, step };
        exchange.update(backend, stages, update)
    }

    pub(super) fn train_step(&mut self, progress: f64) -> Result<StepReport> {
        self.expect_usable()?;
        let step = self.state.totals.step;
        self.set_progress(progress)?;
        self.follow_confinement(progress);
        if step.is_multiple_of(u64::from(self.loaded.config.occupancy.every)) {
            self.refresh_occupancy();
            self.follow_errors(progress)?;
        }
        self.gradients(self.state.rays_per_step, self.draw(step).as_ref());
        self.exchange.partials(&self.loaded.backend, &mut self.loaded.stages, &mut self.partials)?;
        let posted = Arrival::Posted(self.device().post(&self.partials));
        self.pending.push_back(Pending { spacing: self.state.spacing, sums: posted });
        // Without lag, the sums are read before any parameter changes.
        let early = if B::LAG == 0 { self.oldest_sums()? } else { None };
        if let Some((_, sums)) = &early
            && let Err(error) = finite(step, sums)
        {
            self.loaded.stages.reduce(&mut self.partials, &self.loaded.parameters, &mut self.gradient);
            return Err(error);
        }
        let rate = learning_rate(&self.loaded.config, progress);
        self.update(rate, step + 1 - self.state.moments_since)?;
        self.device().submit();
        let late = if B::LAG > 0 { self.oldest_sums()? } else { None };
        if let Some((_, sums)) = &late {
            self.expect_finite(step.saturating_sub(B::LAG as u64), sums)?;
        }
        self.state.totals.step += 1;
        let sums = early.or(late);
        if let Some((spacing, sums)) = &sums {
            self.adapt_batch(sums, *spacing, progress);
        }
        self.adapt_photographs(rate, progress);
        self.count_left_out();
        let sums = sums.map_or_else(StepSums::default, |(_, sums)| sums);
        Ok(StepReport {
            totals: self.state.totals,
            loss: sums.loss / sums.weight.max(f64::MIN_POSITIVE),
            batch_psnr: psnr_of_error(sums.squared_error / (3 * sums.rays.max(1)) as f64),
            learning_rate: rate,
            occupied: self.loaded.stages.occupancy.occupied(),
        })
    }
}
