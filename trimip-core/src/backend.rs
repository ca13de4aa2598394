//! The traits a backend implements. A stage takes a whole span of rays from one batch to the next and knows no
//! neighbour; its first argument is the lane on which the work is issued (scratch of a worker on a CPU, a command
//! encoder on a GPU). Nothing here returns a value that lives on the device: a GPU records a step and reads nothing back.

use crate::{
    Camera, Config, Pixel, Result, ViewSet,
    batch::{Deposit, Radiance, Rays, Samples, StepSums, Workspace},
    model::Assets,
};
use bytemuck::Pod;
use std::ops::Range;

/// A device: it owns buffers, runs work over spans, and names its implementations of the stages.
pub trait Backend: Sized + Send + Sync + 'static {
    /// A flat array on the device.
    type Buffer<T: Pod + Send + Sync>: Send + Sync;
    /// Where the work of one span is issued.
    type Lane: Send;
    /// Losses and counts of a step as they accumulate on the device.
    type Sums: Default + Send;
    /// Sums on their way to the host.
    type Receipt: Send;
    /// Tri-mip encoding.
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
    /// Photometric loss.
    type Loss: Loss<Self>;

    /// Steps between a step and the use of its sums, at most [`crate::checkpoint::MOST_PENDING`]: a device that computes
    /// one step while the host records the next is behind by some.
    const LAG: usize = 0;

    /// Rays of a picture that are rendered before somebody is told how far it is: rows of about this many pixels.
    const RAYS_OF_A_BAND: u32 = 1 << 15;

    /// Name in configurations: "cpu", "wgpu".
    fn name(&self) -> &'static str;

    /// Builds the stages of a configuration; without `views` they render and do not train.
    fn stages(&self, config: &Config, views: Option<ViewSet>) -> Result<Stages<Self>>;

    /// A lane of its own.
    fn lane(&self) -> Self::Lane;

    /// A buffer of `length` zeros.
    fn zeros<T: Pod + Send + Sync>(&self, length: usize) -> Self::Buffer<T>;

    /// Replaces the buffer's values. With [`Backend::read`] the only door to a buffer.
    fn write<T: Pod + Send + Sync>(&self, buffer: &mut Self::Buffer<T>, values: &[T]);

    /// Copies the buffer's values out; waits for the device.
    fn read<T: Pod + Send + Sync>(&self, buffer: &Self::Buffer<T>) -> Vec<T>;

    /// As [`Backend::read`], without blocking: the future is pending while the device works.
    fn read_async<T: Pod + Send + Sync>(&self, buffer: &Self::Buffer<T>) -> impl Future<Output = Vec<T>> {
        async { self.read(buffer) }
    }

    /// Runs `work` with the device's workers at hand; whole-array work inside uses them.
    fn install<R: Send>(&self, work: impl FnOnce() -> R + Send) -> R;

    /// Runs `work` over spans of about `per_span` of a step's `rays`. Spans that share a deposit follow each other in
    /// order, and which spans share one depends on `rays`, `per_span` and the number of deposits alone: the sums have
    /// the same bits for any number of workers. A GPU takes all rays as one span.
    fn train_spans(
        &self,
        field: &Self::Field,
        rays: u32,
        per_span: u32,
        deposits: &mut [Deposit<Self>],
        work: &TrainWork<'_, Self>,
    );

    /// Runs `work` over spans of `0..count` and gathers `result` of each into `out`, in order.
    fn map_spans<T: Pod + Send + Sync>(
        &self,
        field: &Self::Field,
        count: u32,
        per_span: u32,
        out: &mut Self::Buffer<T>,
        work: &(dyn Fn(&mut Workspace<Self>, Range<u32>) + Sync),
        result: &(dyn Fn(&Workspace<Self>) -> &Self::Buffer<T> + Sync),
    );

    /// As [`Backend::map_spans`], without blocking: the future is pending while the device works.
    fn map_spans_async<T: Pod + Send + Sync>(
        &self,
        field: &Self::Field,
        count: u32,
        per_span: u32,
        out: &mut Self::Buffer<T>,
        work: &(dyn Fn(&mut Workspace<Self>, Range<u32>) + Sync),
        result: &(dyn Fn(&Workspace<Self>) -> &Self::Buffer<T> + Sync),
    ) -> impl Future<Output = ()> {
        async move { self.install(|| self.map_spans(field, count, per_span, out, work, result)) }
    }

    /// From the complete gradient of this machine's rays ([`Stages::flush`]) to new parameters, with all that derives from
    /// them. Where the sum of the weights is zero nothing moves. A backend may pass over what its own rays did not touch,
    /// if the parameters get the same bits as from [`Backend::update_all`].
    fn update(
        &self,
        stages: &mut Stages<Self>,
        parameters: &mut Self::Buffer<f32>,
        gradient: &Self::Buffer<f32>,
        deposits: &[Deposit<Self>],
        learning_rate: f64,
        step: u64,
    ) {
        self.update_all(stages, parameters, gradient, deposits, learning_rate, step);
    }

    /// As [`Backend::update`], for a gradient that may differ from zero anywhere.
    fn update_all(
        &self,
        stages: &mut Stages<Self>,
        parameters: &mut Self::Buffer<f32>,
        gradient: &Self::Buffer<f32>,
        deposits: &[Deposit<Self>],
        learning_rate: f64,
        step: u64,
    ) {
        stages.optimizer.step(parameters, gradient, deposits, learning_rate, step);
        stages.encoder.refresh(parameters);
        stages.field.refresh(parameters);
    }

    /// Sum of the weights of the step's rays over all deposits, by which the optimiser divides the gradient; waits for the
    /// device.
    fn weight(&self, deposits: &[Deposit<Self>]) -> f64;

    /// Makes `weight` the sum of the weights over all deposits.
    fn set_weight(&self, deposits: &mut [Deposit<Self>], weight: f64);

    /// Number of deposits that suits steps of `samples` samples: 1 where a step is one span.
    fn deposits(&self, samples: u32) -> usize;

    /// Sends the step's sums, joined, on their way to the host.
    fn post(&self, deposits: &[Deposit<Self>]) -> Self::Receipt;

    /// Hands the recorded work to the device. A backend that works at once has nothing to hand over.
    fn submit(&self) {}

    /// The sums that were posted; waits for them and for nothing behind them.
    ///
    /// # Errors
    /// When the device failed.
    fn redeem(&self, receipt: Self::Receipt) -> Result<StepSums>;

    /// Samples that a ray may have: a driver in software ends every loop after some.
    fn longest_ray(&self) -> usize {
        usize::MAX
    }

    /// The device that stands behind the name, for whoever reads a figure: model, driver, instructions.
    fn device_name(&self) -> String;

    /// Settings that this device takes otherwise than they read, one line each.
    fn notes(&self, _config: &Config) -> Vec<String> {
        Vec::new()
    }

    /// Whether the device still works: once it has failed, what [`Backend::read`] gives is not the model.
    ///
    /// # Errors
    /// When the device failed at any time before.
    fn health(&self) -> Result<()> {
        Ok(())
    }
}

/// Asks the density of every sample in an occupied cell, then drops those that cannot be seen.
pub fn see_all<B: Backend>(
    stages: &Stages<B>,
    parameters: &B::Buffer<f32>,
    space: &mut Workspace<B>,
    jitter: Option<u64>,
) {
    let Workspace { lane, rays, samples, encoding, features, tape, radiance, kept, .. } = space;
    stages.renderer.march(lane, rays, &stages.occupancy, jitter, samples);
    stages.encoder.forward(lane, parameters, rays, samples, encoding, features);
    stages.field.density(lane, samples, features, tape, radiance);
    stages.renderer.prune(lane, radiance, samples, kept);
    stages.encoder.keep(lane, kept, encoding, features);
    stages.field.keep(lane, kept, tape, radiance);
}

/// Work on one span of a training step.
pub type TrainWork<'a, B> = dyn Fn(&mut Workspace<B>, &mut Deposit<B>, Range<u32>) + Sync + 'a;

/// The stages of one model.
pub struct Stages<B: Backend> {
    /// Spheres to features.
    pub encoder: B::Encoder,
    /// Features to density and colour.
    pub field: B::Field,
    /// Rays to samples, samples to pixels.
    pub renderer: B::Renderer,
    /// Gradients to parameters.
    pub optimizer: B::Optimizer,
    /// Where rays come from.
    pub sampler: B::Sampler,
    /// Where samples may lie.
    pub occupancy: B::Occupancy,
    /// Pixels to loss.
    pub loss: B::Loss,
}

impl<B: Backend> Stages<B> {
    /// Joins the deposits to a gradient of all parameters, not yet divided by the sum of the weights, and empties them.
    pub fn flush(
        &mut self,
        deposits: &mut [Deposit<B>],
        parameters: &B::Buffer<f32>,
        gradient: &mut B::Buffer<f32>,
    ) {
        self.field.flush(deposits, gradient);
        self.encoder.flush(deposits, parameters, gradient);
    }
}

/// Samples to features. A sample is a sphere on a cone's axis; with its ray and its interval an encoder has the whole
/// geometry and may take a Gaussian along the cone, or several points in it.
pub trait Encoder<B: Backend>: Send + Sync {
    /// What spans leave behind: feature gradients and where they belong.
    type Gradient: Send;

    /// An empty gradient.
    fn gradient(&self) -> Self::Gradient;

    /// Uses its parameters as far as they have grown at `stage` ([`crate::encoders::Definition::stage`]). The parameters
    /// change first, a refresh follows.
    fn grow(&mut self, stage: u32);

    /// Rebuilds what derives from the parameters, such as mip levels. Once per change of the parameters.
    fn refresh(&mut self, parameters: &B::Buffer<f32>);

    /// Encodes every sample: `features` becomes [samples, [`stride`](crate::encoders::stride)], and `tape` [samples, [`tape`](crate::encoders::Definition::tape)], what backward needs of the sample.
    fn forward(
        &self,
        lane: &mut B::Lane,
        parameters: &B::Buffer<f32>,
        rays: &Rays<B>,
        samples: &Samples<B>,
        tape: &mut B::Buffer<f32>,
        features: &mut B::Buffer<f32>,
    );

    /// Drops the rows of tape and features that pruning dropped.
    fn keep(
        &self,
        lane: &mut B::Lane,
        kept: &B::Buffer<u32>,
        tape: &mut B::Buffer<f32>,
        features: &mut B::Buffer<f32>,
    );

    /// Deposits the gradient of the span's features.
    #[allow(clippy::too_many_arguments)]
    fn backward(
        &self,
        lane: &mut B::Lane,
        parameters: &B::Buffer<f32>,
        rays: &Rays<B>,
        samples: &Samples<B>,
        tape: &B::Buffer<f32>,
        feature_gradients: &B::Buffer<f32>,
        gradient: &mut Self::Gradient,
    );

    /// Joins all deposits in a fixed order: overwrites the encoder's part of `parameter_gradient` and empties the
    /// deposits. Once per step, before the parameters move.
    fn flush(
        &mut self,
        deposits: &mut [Deposit<B>],
        parameters: &B::Buffer<f32>,
        parameter_gradient: &mut B::Buffer<f32>,
    );
}

/// Features to density, then colour (two small networks). Density apart from colour: occupancy and pruning
/// never pay for colour.
pub trait Field<B: Backend>: Send + Sync {
    /// Activations between forward and backward.
    type Tape: Send;
    /// Weight gradients of some spans.
    type Gradient: Send;

    /// An empty tape.
    fn tape(&self) -> Self::Tape;

    /// An empty gradient.
    fn gradient(&self) -> Self::Gradient;

    /// Repacks the weights. Once per change of the parameters.
    fn refresh(&mut self, parameters: &B::Buffer<f32>);

    /// Density of every sample; leaves geometry features and activations on the tape.
    fn density(
        &self,
        lane: &mut B::Lane,
        samples: &Samples<B>,
        features: &B::Buffer<f32>,
        tape: &mut Self::Tape,
        radiance: &mut B::Buffer<Radiance>,
    );

    /// Drops the rows that pruning dropped from tape and radiance.
    fn keep(
        &self,
        lane: &mut B::Lane,
        kept: &B::Buffer<u32>,
        tape: &mut Self::Tape,
        radiance: &mut B::Buffer<Radiance>,
    );

    /// Colour of every kept sample.
    fn color(
        &self,
        lane: &mut B::Lane,
        rays: &Rays<B>,
        samples: &Samples<B>,
        tape: &mut Self::Tape,
        radiance: &mut B::Buffer<Radiance>,
    );

    /// From gradients of density and colour to gradients of features; adds to the weight gradients.
    #[allow(clippy::too_many_arguments)]
    fn backward(
        &self,
        lane: &mut B::Lane,
        samples: &Samples<B>,
        features: &B::Buffer<f32>,
        tape: &mut Self::Tape,
        radiance: &B::Buffer<Radiance>,
        radiance_gradients: &B::Buffer<Radiance>,
        feature_gradients: &mut B::Buffer<f32>,
        gradient: &mut Self::Gradient,
    );

    /// Adds all deposits in their order: overwrites the networks' part of `parameter_gradient` and empties the deposits.
    fn flush(&mut self, deposits: &mut [Deposit<B>], parameter_gradient: &mut B::Buffer<f32>);
}

/// Rays to samples and samples to pixels (cones in uniform steps; volume rendering, NeRF Eq. 3). A pixel is the mean of
/// its group of cones.
pub trait Renderer<B: Backend>: Send + Sync {
    /// Takes the assets of the model's scene: once, before it renders.
    ///
    /// # Errors
    /// When an asset that the renderer needs is missing or broken.
    fn equip(&mut self, _assets: &Assets) -> Result<()> {
        Ok(())
    }

    /// Follows the schedules of a run: the marching step at `progress` in [0, 1].
    fn follow(&mut self, progress: f64);

    /// Places samples where the grid is occupied. `jitter` names the training step that moves each ray's start by a
    /// random part of a step; `None` leaves it.
    fn march(
        &self,
        lane: &mut B::Lane,
        rays: &Rays<B>,
        occupancy: &B::Occupancy,
        jitter: Option<u64>,
        samples: &mut Samples<B>,
    );

    /// Drops samples behind the least transmittance; `kept` lists the rows that stay.
    fn prune(
        &self,
        lane: &mut B::Lane,
        radiance: &B::Buffer<Radiance>,
        samples: &mut Samples<B>,
        kept: &mut B::Buffer<u32>,
    );

    /// From rays to the density of the samples that can be seen, ready for their colour. A renderer may walk each ray
    /// front to back in pieces and stop where it is opaque, if it keeps the same samples as [`see_all`], or place samples
    /// by a rule of its own.
    fn see(
        &self,
        stages: &Stages<B>,
        parameters: &B::Buffer<f32>,
        space: &mut Workspace<B>,
        jitter: Option<u64>,
    ) {
        see_all(stages, parameters, space, jitter);
    }

    /// Composites each cone on its pixel's target's background, or on the configured one where there are no targets:
    /// `cones` becomes [rays], `pixels` [groups], the means over each group.
    fn composite(
        &self,
        lane: &mut B::Lane,
        rays: &Rays<B>,
        samples: &Samples<B>,
        radiance: &B::Buffer<Radiance>,
        cones: &mut B::Buffer<Pixel>,
        pixels: &mut B::Buffer<Pixel>,
    );

    /// From gradients of pixels to gradients of density and colour. `cones` are those that
    /// [`composite`](Self::composite) gave.
    #[allow(clippy::too_many_arguments)]
    fn backward(
        &self,
        lane: &mut B::Lane,
        rays: &Rays<B>,
        samples: &Samples<B>,
        radiance: &B::Buffer<Radiance>,
        cones: &B::Buffer<Pixel>,
        pixel_gradients: &B::Buffer<[f32; 4]>,
        radiance_gradients: &mut B::Buffer<Radiance>,
    );
}

/// Gradients to parameters (AdamW, Loshchilov and Hutter 2019).
pub trait Optimizer<B: Backend>: Send + Sync {
    /// One step of number `step` (from 1) at the networks' learning rate; gradients are divided by `sums.weight` of the
    /// deposits first.
    fn step(
        &mut self,
        parameters: &mut B::Buffer<f32>,
        gradient: &B::Buffer<f32>,
        deposits: &[Deposit<B>],
        learning_rate: f64,
        step: u64,
    );

    /// Moves these parts of the slots alone, one for each slot: a slot that grows is in use in part.
    fn restrict(&mut self, parts: &[Range<usize>]);

    /// First and second moments.
    fn moments(&self) -> [&B::Buffer<f32>; 2];

    /// The same, to restore a checkpoint.
    fn moments_mut(&mut self) -> [&mut B::Buffer<f32>; 2];

    /// Gradients met whose square is beyond f32, or that were not finite: their parameters were left as they were. A
    /// second moment once infinite would keep its parameter from ever moving again. Also terms of gradients that a device
    /// left out for their size.
    fn non_finite(&self) -> u64;
}

/// Where rays come from.
pub trait Sampler<B: Backend>: Send + Sync {
    /// Shares the rays of later steps among the scales as the schedule says at `progress` in [0, 1]; see [`Balance`](crate::balance::Balance).
    fn follow(&mut self, progress: f64);

    /// Cones of the pixels `range` of a training step that has `total` pixels: each scale gets its share, pixels uniform.
    fn training_rays(&self, lane: &mut B::Lane, step: u64, total: u32, range: Range<u32>, rays: &mut Rays<B>);

    /// Cones of the pixels `range` of a camera, row by row.
    fn camera_rays(&self, lane: &mut B::Lane, camera: &Camera, range: Range<u32>, rays: &mut Rays<B>);
}

/// The occupancy grid (instant-ngp, Appendix C).
pub trait Occupancy<B: Backend>: Send + Sync {
    /// Chooses the cells that a refresh at `step` asks; returns their number.
    fn choose(&mut self, step: u64) -> u32;

    /// One random point in each of the chosen cells `range`, with a radius that fits the cell: a sample of a ray of its
    /// own, which comes from a random direction.
    fn probes(
        &self,
        lane: &mut B::Lane,
        step: u64,
        range: Range<u32>,
        rays: &mut Rays<B>,
        samples: &mut Samples<B>,
    );

    /// Takes the densities of all chosen cells and renews the bits.
    fn absorb(&mut self, radiance: &B::Buffer<Radiance>);

    /// Share of occupied cells.
    fn occupied(&self) -> f64;

    /// Running maximum of density·step per cell.
    fn densities(&self) -> Vec<f32>;

    /// One bit per cell, cell order, lowest bit first.
    fn bits(&self) -> Vec<u8>;

    /// Restores what [`Occupancy::bits`] and (for training) [`Occupancy::densities`] gave.
    fn restore(&mut self, bits: &[u8], densities: Option<&[f32]>);
}

/// Pixels to loss (smooth-L1, weighted by area).
pub trait Loss<B: Backend>: Send + Sync {
    /// Area-weighted smooth-L1 of each pixel, its gradient with respect to the pixel (not yet divided by the sum of the
    /// weights), and the sums.
    fn evaluate(
        &self,
        lane: &mut B::Lane,
        rays: &Rays<B>,
        samples: &Samples<B>,
        pixels: &B::Buffer<Pixel>,
        pixel_gradients: &mut B::Buffer<[f32; 4]>,
        sums: &mut B::Sums,
    );
}
