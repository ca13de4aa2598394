//! The traits of the stages. Each stage maps one batch of a whole tile of rays to the next, independently of the other
//! stages. Its first argument is the [`Tile`] that it works on, or only the stream on which the work is issued (a
//! worker's scratch memory on a CPU, a command encoder on a GPU). No stage returns a value that lives on the device: a
//! GPU records a whole step and reads nothing back. The host's decisions for a stage are its
//! [`policy`](crate::engine::policy).

use crate::{
    Backend, Camera, Pixel, Result,
    engine::{
        backend::evaluate_visible_samples,
        batch::{
            Displaced, FieldBackward, FieldDraw, PartialGradients, Radiance, Rays, SampleDraw, Samples, Tile,
            Update, Workspace,
        },
        error_map::{CellErrors, ErrorMap},
        policy::{OptimizerPolicy, RendererPolicy, SamplerPolicy},
        proxy::Guide,
        ray_allocation::{RayAllocation, ScaleWeights},
    },
    field::{model::Assets, params::ActiveRange},
};
use std::ops::Range;

/// The stages of one model.
pub struct Stages<B: Backend> {
    /// Maps spheres to features.
    pub encoder: B::Encoder,
    /// Maps features to density and colour.
    pub field: B::Field,
    /// Maps rays to samples, and samples to pixels.
    pub renderer: B::Renderer,
    /// Maps gradients to new parameters.
    pub optimizer: B::Optimizer,
    /// Generates rays.
    pub sampler: B::Sampler,
    /// Restricts where samples are placed.
    pub occupancy: B::Occupancy,
    /// Maps pixels to the loss.
    pub loss: B::Loss,
    /// Maps gradients of features to those of poses; `None` unless training refines poses.
    pub poses: Option<B::Poses>,
}

impl<B: Backend> Stages<B> {
    /// Encodes the samples of a workspace and evaluates their density. `parameters` is flat.
    pub fn density(&self, parameters: &B::Buffer<f32>, workspace: &mut Workspace<B>) {
        let Workspace { stream, rays, samples, encoder_context, features, field_context, radiance, .. } =
            workspace;
        let tile = &mut Tile { stream, parameters, rays, samples };
        self.encoder.forward(tile, encoder_context, features);
        self.field.density(tile, features, field_context, radiance);
    }

    /// Sums the partial gradients into one gradient of all parameters, not yet divided by the sum of the weights, and
    /// empties the partial gradients. `parameters` and `gradient` are flat.
    pub fn reduce(
        &mut self,
        partials: &mut [PartialGradients<B>],
        parameters: &B::Buffer<f32>,
        gradient: &mut B::Buffer<f32>,
    ) {
        self.field.reduce(partials, gradient);
        self.encoder.reduce(partials, parameters, gradient);
    }
}

/// Maps samples to features. A sample is a sphere on the axis of a cone. The encoder also gets the sample's ray and
/// interval, which complete its geometry; it may use a Gaussian along the cone instead, or several points inside it.
pub trait Encoder<B: Backend>: Send + Sync {
    /// Feature gradients of some tiles, with the places they belong to.
    type Gradient: Send;

    /// Creates an empty gradient.
    fn gradient(&self) -> Self::Gradient;

    /// Switches to the parameters that are in use at growth stage `stage` ([`crate::field::encoders::Definition::stage`]).
    /// The parameters change before this call, and a refresh follows it.
    fn grow(&mut self, stage: u32);

    /// Rebuilds data derived from the parameters (flat), such as mip levels. Called once per change of the parameters.
    fn refresh(&mut self, parameters: &B::Buffer<f32>);

    /// Encodes every sample. `features` becomes [samples, [`stride`](crate::field::encoders::stride)]. `context` becomes
    /// [samples, [`context`](crate::field::encoders::Definition::context)]: the values that the backward pass needs.
    fn forward(&self, tile: &mut Tile<'_, B>, context: &mut B::Buffer<f32>, features: &mut B::Buffer<f32>);

    /// Keeps the rows `kept` (ascending) of context and features, which survived pruning, and drops the others.
    fn keep(
        &self,
        stream: &mut B::Stream,
        kept: &B::Buffer<u32>,
        context: &mut B::Buffer<f32>,
        features: &mut B::Buffer<f32>,
    );

    /// Adds the gradient of the tile's features, [samples, stride], to the partial gradients. `context` is the output of
    /// [`forward`](Self::forward).
    fn backward(
        &self,
        tile: &mut Tile<'_, B>,
        context: &B::Buffer<f32>,
        feature_gradients: &B::Buffer<f32>,
        gradient: &mut Self::Gradient,
    );

    /// Sums all partial gradients in a fixed order, overwrites the encoder's part of `parameter_gradient` with the result
    /// and empties the partial gradients. `parameters` and `parameter_gradient` are flat. Called once per step, before
    /// the parameters are updated.
    fn reduce(
        &mut self,
        partials: &mut [PartialGradients<B>],
        parameters: &B::Buffer<f32>,
        parameter_gradient: &mut B::Buffer<f32>,
    );
}

/// Maps features to density, then to colour (two small networks). Density is evaluated separately from colour, so that
/// occupancy and pruning never pay for colour.
pub trait Field<B: Backend>: Send + Sync {
    /// Activations, kept from forward to backward.
    type Context: Send;
    /// Weight gradients of some tiles.
    type Gradient: Send;

    /// Creates an empty context.
    fn context(&self) -> Self::Context;

    /// Creates an empty gradient.
    fn gradient(&self) -> Self::Gradient;

    /// Repacks the weights of the parameters (flat). Called once per change of the parameters.
    fn refresh(&mut self, parameters: &B::Buffer<f32>);

    /// Evaluates the density of every sample, given features, [samples, stride]; `radiance` gets one value per sample.
    /// Stores geometry features and activations on the context.
    fn density(
        &self,
        tile: &mut Tile<'_, B>,
        features: &B::Buffer<f32>,
        context: &mut Self::Context,
        radiance: &mut B::Buffer<Radiance>,
    );

    /// Keeps the rows `kept` (ascending) of context and radiance, which survived pruning, and drops the others.
    fn keep(
        &self,
        stream: &mut B::Stream,
        kept: &B::Buffer<u32>,
        context: &mut Self::Context,
        radiance: &mut B::Buffer<Radiance>,
    );

    /// Evaluates the colour of every kept sample whose weight in its ray is at least `least`, and writes it to
    /// `radiance`, which has one value per sample. The others are black, and nothing flows back through their colours.
    /// With 0 all samples have a colour, and their segments are not read.
    fn color(
        &self,
        tile: &mut Tile<'_, B>,
        least: f32,
        context: &mut Self::Context,
        radiance: &mut B::Buffer<Radiance>,
    );

    /// Draws samples by the norms of the gradients of their logits: the derivatives by density and colour times the
    /// slopes of their activations. Marks the drawn samples, and divides their gradients by their probabilities.
    ///
    /// Along a ray, samples are drawn systematically: one is drawn wherever the sum of the probabilities reaches a whole
    /// number. The sum begins at a random number in [0, 1), the ray's [`SampleDraw::first`].
    fn draw(
        &self,
        tile: &mut Tile<'_, B>,
        draw: &SampleDraw,
        context: &Self::Context,
        arrays: FieldDraw<'_, B>,
    );

    /// Keeps the rows `drawn` (ascending) of context, radiance and its gradients, as [`keep`](Self::keep) does, including
    /// the context of colour.
    fn keep_drawn(
        &self,
        stream: &mut B::Stream,
        drawn: &B::Buffer<u32>,
        context: &mut Self::Context,
        radiance: &mut B::Buffer<Radiance>,
        radiance_gradients: &mut B::Buffer<Radiance>,
    );

    /// Maps gradients of density and colour to gradients of features; adds to the weight gradients. [`FieldBackward`]
    /// gives the shapes.
    fn backward(
        &self,
        tile: &mut Tile<'_, B>,
        arrays: FieldBackward<'_, B>,
        context: &mut Self::Context,
        gradient: &mut Self::Gradient,
    );

    /// Sums all partial gradients in order, overwrites the networks' part of `parameter_gradient` (flat) with the result
    /// and empties the partial gradients.
    fn reduce(&mut self, partials: &mut [PartialGradients<B>], parameter_gradient: &mut B::Buffer<f32>);
}

/// Maps rays to samples and samples to pixels (cones sampled in uniform steps; volume rendering, NeRF Eq. 3). A pixel
/// is the mean of its group of cones.
pub trait Renderer<B: Backend>: Send + Sync {
    /// Steps, thresholds and background.
    fn policy(&self) -> &RendererPolicy;

    /// The policy, mutable.
    fn policy_mut(&mut self) -> &mut RendererPolicy;

    /// Sets the guide that chooses the samples of pictures; `None` for volume rendering.
    ///
    /// # Errors
    /// When the device cannot hold it.
    fn set_guide(&mut self, guide: Option<Guide>) -> Result<()>;

    /// Sets the assets of the model's scene. Called once, before the first view is rendered.
    ///
    /// # Errors
    /// When an asset that the renderer needs is missing or broken, or the device cannot hold it.
    fn set_assets(&mut self, assets: &Assets) -> Result<()> {
        let guide = self.policy().guide(assets)?;
        self.set_guide(guide)
    }

    /// Applies the schedules of a run: sets the marching step for `progress` in [0, 1].
    fn set_progress(&mut self, progress: f64) {
        self.policy_mut().set_progress(progress);
    }

    /// Weight of a sample in its ray below which it has no colour (`renderer.color_weight`).
    fn color_weight(&self) -> f32 {
        self.policy().color_weight()
    }

    /// Places samples in occupied cells: `samples` gets one segment per ray. `jitter` is the number of the training step;
    /// it selects the random offset, a fraction of a marching step, by which each ray's start is moved. `None` disables
    /// the offset.
    fn march(
        &self,
        stream: &mut B::Stream,
        rays: &Rays<B>,
        occupancy: &B::Occupancy,
        jitter: Option<u64>,
        samples: &mut Samples<B>,
    );

    /// Drops samples behind the least transmittance, and merges faint samples with the next sample of their ray
    /// ([`Pruning`](crate::math::compositing::Pruning)). `radiance` has one value per marched sample; `kept` receives the
    /// rows that remain, ascending.
    fn prune(
        &self,
        stream: &mut B::Stream,
        radiance: &B::Buffer<Radiance>,
        samples: &mut Samples<B>,
        kept: &mut B::Buffer<u32>,
    );

    /// Lists in `drawn` the rows of the samples that [`Field::draw`] marked, keeps these samples and drops the others.
    /// `marks` has one value per sample. The number of drawn samples replaces that of the kept ones in
    /// [`StepSums::drawn`](crate::engine::batch::StepSums).
    fn keep_drawn(
        &self,
        stream: &mut B::Stream,
        marks: &B::Buffer<u32>,
        samples: &mut Samples<B>,
        drawn: &mut B::Buffer<u32>,
        sums: &mut B::Sums,
    );

    /// Maps the rays of a workspace to the density of their visible samples, ready for colour. `parameters` is flat,
    /// `jitter` as in [`march`](Self::march). A renderer may walk each ray front to back in pieces and stop where it is
    /// opaque, provided that it keeps the same samples as [`evaluate_visible_samples`]. It may also place samples by a
    /// rule of its own.
    fn visibility_pass(
        &self,
        stages: &Stages<B>,
        parameters: &B::Buffer<f32>,
        workspace: &mut Workspace<B>,
        jitter: Option<u64>,
    ) {
        evaluate_visible_samples(stages, parameters, workspace, jitter);
    }

    /// Composites each cone on the background of its pixel's target, or on the configured background if there are no
    /// targets. `radiance` has one value per sample. `cones` gets one value per ray, `pixels` one per group, the mean of
    /// its cones.
    fn composite(
        &self,
        tile: &mut Tile<'_, B>,
        radiance: &B::Buffer<Radiance>,
        cones: &mut B::Buffer<Pixel>,
        pixels: &mut B::Buffer<Pixel>,
    );

    /// Maps gradients of pixels, [r, g, b, opacity] of each, to gradients of density and colour, one per sample like
    /// `radiance`. `cones` is the output of [`composite`](Self::composite).
    fn backward(
        &self,
        tile: &mut Tile<'_, B>,
        radiance: &B::Buffer<Radiance>,
        cones: &B::Buffer<Pixel>,
        pixel_gradients: &B::Buffer<[f32; 4]>,
        radiance_gradients: &mut B::Buffer<Radiance>,
    );
}

/// Maps gradients to new parameters (AdamW, Loshchilov and Hutter 2019).
pub trait Optimizer<B: Backend>: Send + Sync {
    /// The rules of the updates.
    fn policy(&self) -> &OptimizerPolicy;

    /// The policy, mutable.
    fn policy_mut(&mut self) -> &mut OptimizerPolicy;

    /// Performs a step. Gradients are first divided by `sums.weight` of the partial gradients.
    fn step(&mut self, update: &mut Update<'_, B>);

    /// Restricts updates to these parts of the slots, one per slot. Only a part of a growing slot is in use.
    fn restrict(&mut self, parts: &[ActiveRange]) {
        self.policy_mut().restrict(parts);
    }

    /// First and second moments, flat as the parameters.
    fn moments(&self) -> [&B::Buffer<f32>; 2];

    /// The moments, mutable, to restore a checkpoint.
    fn moments_mut(&mut self) -> [&mut B::Buffer<f32>; 2];

    /// Number of gradients that were not finite or whose square overflows f32. Their parameters were not updated, because
    /// a second moment that is infinite once would never let its parameter move again. The number includes terms of
    /// gradients that a device left out because of their size.
    fn non_finite(&self) -> u64;
}

/// Generates rays.
pub trait Sampler<B: Backend>: Send + Sync {
    /// Scales, schedules and random numbers.
    fn policy(&self) -> &SamplerPolicy;

    /// The policy, mutable.
    fn policy_mut(&mut self) -> &mut SamplerPolicy;

    /// Distributes the pixels of later steps among the scales, by the schedules at `progress` in [0, 1].
    fn set_progress(&mut self, progress: f64) {
        self.policy_mut().set_progress(progress);
    }

    /// The balance of the scales, by the last [`set_progress`](Self::set_progress).
    fn scale_weights(&self) -> &ScaleWeights {
        self.policy().scale_weights()
    }

    /// Replaces the cameras of the training views, one per view, relative to the centre of the box. Does nothing without
    /// views.
    fn set_cameras(&mut self, cameras: &[Camera]);

    /// Generates the cones, groups and targets of the pixels `range` of a training step. `allocation` assigns a scale to
    /// each pixel; within a scale, pixels are drawn uniformly, or by the error map.
    fn training_rays(
        &self,
        stream: &mut B::Stream,
        step: u64,
        allocation: &RayAllocation,
        range: Range<u32>,
        rays: &mut Rays<B>,
    );

    /// Adds the errors of the pixels `range` of a training step to their cells of the error map, if there is one. `rays`
    /// are the rays of these pixels, and `pixel_gradients`, one per pixel, the output of [`Loss::evaluate_pixels`].
    fn observe(
        &self,
        stream: &mut B::Stream,
        step: u64,
        range: Range<u32>,
        rays: &Rays<B>,
        pixel_gradients: &B::Buffer<[f32; 4]>,
    );

    /// Returns and clears the sums of [`observe`](Self::observe), one per cell. Waits for the device.
    fn take_errors(&mut self) -> Vec<CellErrors>;

    /// Sets another error map of the same photographs, by which the pixels of later steps are drawn.
    fn set_error_map(&mut self, map: ErrorMap);

    /// Generates the cones of the pixels `range` of a camera, row by row, without targets. The camera is relative to the
    /// centre of the box.
    fn camera_rays(&self, stream: &mut B::Stream, camera: &Camera, range: Range<u32>, rays: &mut Rays<B>);
}

/// The occupancy grid (instant-ngp, Appendix C).
pub trait Occupancy<B: Backend>: Send + Sync {
    /// Selects the cells to refresh at `step`; returns their number.
    fn select(&mut self, step: u64) -> u32;

    /// Generates one random point in each of the selected cells `range`, with a radius that fits the cell. Each point is
    /// the only sample of its own ray, which has a random direction: `rays` and `samples` get one value per cell.
    fn probes(
        &self,
        stream: &mut B::Stream,
        step: u64,
        range: Range<u32>,
        rays: &mut Rays<B>,
        samples: &mut Samples<B>,
    );

    /// Updates densities and bits by the densities in `radiance`, one per selected cell, in order.
    fn update(&mut self, radiance: &B::Buffer<Radiance>);

    /// Fraction of cells that are occupied.
    fn occupied(&self) -> f64;

    /// Running maximum of density·step per cell, in cell order; [`OUTSIDE`](crate::geometry::occupancy::OUTSIDE) for
    /// cells that cannot be occupied.
    fn densities(&self) -> Vec<f32>;

    /// One bit per cell, in cell order, lowest bit first.
    fn bits(&self) -> Vec<u8>;

    /// Restores the values of [`Occupancy::bits`] and, for training, of [`Occupancy::densities`].
    fn restore(&mut self, bits: &[u8], densities: Option<&[f32]>);
}

/// The arrays of a tile that the loss reads after the forward pass.
pub struct RenderedTile<'a, B: Backend> {
    /// The rays with the targets of their pixels.
    pub rays: &'a Rays<B>,
    /// The kept samples along them.
    pub samples: &'a Samples<B>,
    /// Density and colour of each sample.
    pub radiance: &'a B::Buffer<Radiance>,
    /// The composited pixels.
    pub pixels: &'a B::Buffer<Pixel>,
}

/// Maps pixels and the weights of their samples to the loss: the sum of the registered terms
/// ([`losses`](crate::field::losses)) that the configuration enables.
pub trait Loss<B: Backend>: Send + Sync {
    /// Sets the gains (RGB) of each photograph, by the numbers in [`Rays::photographs`]. An adjustment applies them to
    /// rendered colours before the comparison. Initially there are none, and rendered colours are compared as they are.
    fn set_gains(&mut self, gains: &[[f32; 3]]);

    /// Applies the schedules of the terms' weights at `progress` in [0, 1]; initially it is 0.
    fn set_progress(&mut self, progress: f64);

    /// Evaluates the photometric term and the terms of pixels. Writes their gradient with respect to each pixel's [r, g,
    /// b, opacity], weighted by area but not yet divided by the sum of the weights, and adds to the sums. With gains it
    /// also adds the derivatives by the log-gains.
    fn evaluate_pixels(
        &self,
        stream: &mut B::Stream,
        tile: &RenderedTile<'_, B>,
        pixel_gradients: &mut B::Buffer<[f32; 4]>,
        sums: &mut B::Sums,
    );

    /// Adds the terms of rays (the mean over the cones of a pixel, weighted by area) to the sums, and their gradients to
    /// the densities' in `radiance_gradients`, which has one value per sample and was written by [`Renderer::backward`].
    /// Called once after [`evaluate_pixels`](Self::evaluate_pixels).
    fn evaluate_rays(
        &self,
        stream: &mut B::Stream,
        tile: &RenderedTile<'_, B>,
        radiance_gradients: &mut B::Buffer<Radiance>,
        sums: &mut B::Sums,
    );
}

/// Maps gradients of features to derivatives of the loss by motions of cameras.
///
/// Each ray is displaced, with all of its samples, by its own radius across its direction: to a random side and to the
/// opposite one. The difference of a sample's features on both sides, times the gradient of the features and divided by
/// the sample's width, is the mean slope of the loss over this width. A random direction covers one of the two dimensions
/// across a ray; other steps cover the other one, so the slope counts twice. Motion along a ray changes no picture.
/// Changes of density and colour by another direction, radius or placement of samples are neglected.
pub trait PoseGradients<B: Backend>: Send + Sync {
    /// Moves all rays of a tile and their samples by `side` (1 or −1) times their radius along the random direction of
    /// each ray. `displaced.rays` gets one ray per cone, `displaced.spheres` one sphere per sample.
    fn displace(&self, tile: &mut Tile<'_, B>, step: u64, side: f32, displaced: &mut Displaced<B>);

    /// Writes Σ feature · gradient of each displaced sample to `displaced.slopes` for `side` = 1, and subtracts it for
    /// `side` = −1. `feature_gradients` is [samples, stride].
    fn compare(
        &self,
        tile: &mut Tile<'_, B>,
        side: f32,
        feature_gradients: &B::Buffer<f32>,
        displaced: &mut Displaced<B>,
    );

    /// Adds the derivatives by the photographs' cameras
    /// ([`StepResult::cameras`](crate::engine::batch::StepResult::cameras)) to the sums. `slopes` has one value per
    /// sample, see [`compare`](Self::compare).
    fn add(&self, tile: &mut Tile<'_, B>, step: u64, slopes: &B::Buffer<f32>, sums: &mut B::Sums);
}
