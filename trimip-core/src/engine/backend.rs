//! The device that a model runs on. The traits of its stages are in `stages.rs`.

pub use crate::engine::stages::{
    Encoder, Field, Loss, Occupancy, Optimizer, PoseGradients, RenderedTile, Renderer, Sampler, Stages,
};

use crate::{
    Config, Result, ViewSet,
    engine::batch::{Batch, PartialGradients, StepResult, Tiling, Update, Workspace},
};
use bytemuck::Pod;
use std::ops::Range;

/// A device: it owns buffers, runs work over tiles and names its implementations of the stages.
pub trait Backend: Sized + Send + Sync + 'static {
    /// A flat array on the device.
    type Buffer<T: Pod + Send + Sync>: Send + Sync;
    /// The stream on which the work of one tile is issued.
    type Stream: Send;
    /// Losses and counts of a step, accumulated on the device.
    type Sums: Default + Send;
    /// A pending transfer of sums to the host.
    type Receipt: Send;
    /// All encoders of the device; the configuration selects one.
    type Encoder: Encoder<Self>;
    /// Density and colour networks.
    type Field: Field<Self>;
    /// Marching, pruning, compositing.
    type Renderer: Renderer<Self>;
    /// AdamW.
    type Optimizer: Optimizer<Self>;
    /// Training rays and camera rays.
    type Sampler: Sampler<Self>;
    /// Occupancy grid.
    type Occupancy: Occupancy<Self>;
    /// The terms of the loss.
    type Loss: Loss<Self>;
    /// The gradient of the loss with respect to camera poses.
    type Poses: PoseGradients<Self>;

    /// Number of steps between a step and the use of its sums, at most [`crate::engine::batch::MOST_PENDING`]. A device
    /// that computes one step while the host records the next has a lag above 0.
    const LAG: usize = 0;

    /// Pixels rendered between two progress reports. A view is rendered in bands of rows of about this many pixels.
    const RAYS_OF_A_BAND: u32 = 1 << 15;

    /// Returns the backend's name in configurations: "cpu" or "wgpu".
    fn name(&self) -> &'static str;

    /// Builds the stages of a configuration. Without `views` they render but do not train. The box of `config` and the
    /// cameras of `views` are relative to the centre of the box.
    ///
    /// # Errors
    /// When the configuration or the views do not fit the device.
    fn stages(&self, config: &Config, views: Option<ViewSet>) -> Result<Stages<Self>>;

    /// Creates a stream.
    fn stream(&self) -> Self::Stream;

    /// Creates a buffer of `length` zeros.
    fn zeros<T: Pod + Send + Sync>(&self, length: usize) -> Self::Buffer<T>;

    /// Replaces the buffer's values; the buffer gets their length. The host accesses a buffer only through this method,
    /// [`Backend::read`], [`Backend::look`] and [`Backend::read_async`].
    fn write<T: Pod + Send + Sync>(&self, buffer: &mut Self::Buffer<T>, values: &[T]);

    /// Copies the buffer's values to the host; waits for the device.
    fn read<T: Pod + Send + Sync>(&self, buffer: &Self::Buffer<T>) -> Vec<T>;

    /// Calls `look` with the buffer's values; waits for the device. A backend whose buffers are memory of the host makes no copy.
    fn look<T: Pod + Send + Sync, R>(&self, buffer: &Self::Buffer<T>, look: impl FnOnce(&[T]) -> R) -> R {
        look(&self.read(buffer))
    }

    /// Does the same as [`Backend::read`] without blocking: the future is pending while the device works.
    fn read_async<T: Pod + Send + Sync>(&self, buffer: &Self::Buffer<T>) -> impl Future<Output = Vec<T>> {
        async { self.read(buffer) }
    }

    /// Runs `work` in the device's worker pool; operations on whole arrays inside `work` use the workers.
    fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R;

    /// Runs `work` over the pixels of a step in tiles of about `batch.per_tile` cones; `work` gets the range of a
    /// tile's pixels within the step. `partials` holds [`Backend::partials`] sets. Tiles that share a set of partial
    /// gradients run one after the other, in order. Which tiles share a set depends only on the batch and the number of
    /// sets, so the sums have the same bits for any number of workers. A GPU takes all pixels as one tile. Only the
    /// pixels of this rank's share are processed.
    fn train_tiles(
        &self,
        field: &Self::Field,
        batch: &Batch<'_>,
        partials: &mut [PartialGradients<Self>],
        work: &TrainWork<'_, Self>,
    );

    /// Runs `work` over tiles of `0..tiling.count`. `result` returns the values of a tile, one per item; `out` receives
    /// the values of all items, in order.
    fn map_tiles<T: Pod + Send + Sync>(
        &self,
        field: &Self::Field,
        tiling: Tiling,
        out: &mut Self::Buffer<T>,
        work: &(dyn Fn(&mut Workspace<Self>, Range<u32>) + Sync),
        result: &(dyn Fn(&Workspace<Self>) -> &Self::Buffer<T> + Sync),
    );

    /// Does the same as [`Backend::map_tiles`] without blocking: the future is pending while the device works.
    fn map_tiles_async<T: Pod + Send + Sync>(
        &self,
        field: &Self::Field,
        tiling: Tiling,
        out: &mut Self::Buffer<T>,
        work: &(dyn Fn(&mut Workspace<Self>, Range<u32>) + Sync),
        result: &(dyn Fn(&Workspace<Self>) -> &Self::Buffer<T> + Sync),
    ) -> impl Future<Output = ()> {
        async move { self.install(|| self.map_tiles(field, tiling, out, work, result)) }
    }

    /// Computes new parameters and everything derived from them, given the complete gradient of this machine's rays
    /// ([`Stages::reduce`]). If the sum of the weights is zero, nothing changes. A backend may skip parameters that
    /// its own rays did not touch, provided that all parameters get the same bits as from [`Backend::update_all`].
    fn update(&self, stages: &mut Stages<Self>, update: &mut Update<'_, Self>) {
        self.update_all(stages, update);
    }

    /// Does the same as [`Backend::update`] for a gradient that may be non-zero anywhere.
    fn update_all(&self, stages: &mut Stages<Self>, update: &mut Update<'_, Self>) {
        stages.optimizer.step(update);
        stages.encoder.refresh(update.parameters);
        stages.field.refresh(update.parameters);
    }

    /// Returns the sum of the weights of the step's rays over all partial gradients. The optimiser divides the gradient
    /// by this sum. Waits for the device.
    fn weight(&self, partials: &[PartialGradients<Self>]) -> f64;

    /// Sets the sum of the weights over all partial gradients to `weight`.
    fn set_weight(&self, partials: &mut [PartialGradients<Self>], weight: f64);

    /// Returns the number of sets of partial gradients for a step of `samples` samples; 1 if a step is one tile.
    fn partials(&self, samples: u32) -> usize;

    /// Adds up the step's sums over all partial gradients and starts their transfer to the host.
    fn post(&self, partials: &[PartialGradients<Self>]) -> Self::Receipt;

    /// Submits the recorded work to the device. Does nothing on a backend that executes work immediately.
    fn submit(&self) {}

    /// Returns the sums that were posted. Waits for them, but not for work recorded after them.
    ///
    /// # Errors
    /// When the device failed.
    fn redeem(&self, receipt: Self::Receipt) -> Result<StepResult>;

    /// Returns the largest number of samples that a ray may have. It is finite only on a software driver, which ends
    /// every loop after a limited number of iterations.
    fn longest_ray(&self) -> usize {
        usize::MAX
    }

    /// Returns the name of the device for reports: model, driver, instruction set.
    fn device_name(&self) -> String;

    /// Returns one line for each setting that this device cannot honour as written.
    fn notes(&self, _config: &Config) -> Vec<String> {
        Vec::new()
    }

    /// Checks that the device still works. After a failure, [`Backend::read`] returns values that are not those of the
    /// model.
    ///
    /// # Errors
    /// When the device has failed at any time.
    fn health(&self) -> Result<()> {
        Ok(())
    }
}

/// Evaluates the density of every sample in an occupied cell, then drops the samples that cannot be seen. `parameters` is
/// flat. `workspace` holds the rays and receives the kept samples with their context, features and radiance. `jitter` is
/// as in [`Renderer::march`].
pub fn evaluate_visible_samples<B: Backend>(
    stages: &Stages<B>,
    parameters: &B::Buffer<f32>,
    workspace: &mut Workspace<B>,
    jitter: Option<u64>,
) {
    let Workspace { stream, rays, samples, .. } = workspace;
    stages.renderer.march(stream, rays, &stages.occupancy, jitter, samples);
    stages.density(parameters, workspace);
    let Workspace { stream, samples, encoder_context, features, field_context, radiance, kept, .. } =
        workspace;
    stages.renderer.prune(stream, radiance, samples, kept);
    stages.encoder.keep(stream, kept, encoder_context, features);
    stages.field.keep(stream, kept, field_context, radiance);
}

/// Work on one tile of a training step.
pub type TrainWork<'a, B> = dyn Fn(&mut Workspace<B>, &mut PartialGradients<B>, Range<u32>) + Sync + 'a;
