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
    /// Encodes the samples of a workspace and evaluates their density. `parameters` is flat, in the order of the
    /// [`Layout`](crate::Layout). The workspace's `features` become [samples, stride], and its `radiance` gets one
    /// density per sample.
    pub fn density(&self, parameters: &B::Buffer<f32>, workspace: &mut Workspace<B>) {
        let Workspace { stream, rays, samples, encoder_context, features, field_context, radiance, .. } =
            workspace;
        let tile = &mut Tile { stream, parameters, rays, samples };
        self.encoder.forward(tile, encoder_context, features);
        self.field.density(tile, features, field_context, radiance);
    }

    /// Sums the partial gradients into one gradient of all parameters, not yet divided by the sum of the weights, and
    /// empties the partial gradients. `partials` are all sets of the step; `parameters` and `gradient` are flat, in the
    /// order of the [`Layout`](crate::Layout).
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
    /// Feature gradients of several tiles, with the data that assigns them to parameters.
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

    /// Drops all rows of `context` and `features` except the rows `kept` (ascending), whose samples survived pruning.
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
/// occupancy refreshes and pruning need not evaluate colour.
pub trait Field<B: Backend>: Send + Sync {
    /// Activations that the forward pass keeps for the backward pass.
    type Context: Send;
    /// Weight gradients of several tiles.
    type Gradient: Send;

    /// Creates an empty context.
    fn context(&self) -> Self::Context;

    /// Creates an empty gradient.
    fn gradient(&self) -> Self::Gradient;

    /// Repacks the weights of the parameters (flat). Called once per change of the parameters.
    fn refresh(&mut self, parameters: &B::Buffer<f32>);

    /// Evaluates the density of every sample, given features, [samples, stride]; `radiance` gets one value per sample.
    /// Stores geometry features and activations in `context`.
    fn density(
        &self,
        tile: &mut Tile<'_, B>,
        features: &B::Buffer<f32>,
        context: &mut Self::Context,
        radiance: &mut B::Buffer<Radiance>,
    );

    /// Drops all rows of `context` and `radiance` except the rows `kept` (ascending), whose samples survived pruning.
    fn keep(
        &self,
        stream: &mut B::Stream,
        kept: &B::Buffer<u32>,
        context: &mut Self::Context,
        radiance: &mut B::Buffer<Radiance>,
    );

    /// Evaluates the colour of every kept sample whose weight in its ray is at least `least`, and writes it to
    /// `radiance`, which has one value per sample. The other samples are black, and no gradient flows through their
    /// colours. If `least` is 0, all samples get a colour, and the segments are not read. With deferred shading
    /// ([`deferred`](crate::math::deferred)) all samples of a ray get the colour of the ray, if its opacity is at least `least`.
    fn color(
        &self,
        tile: &mut Tile<'_, B>,
        least: f32,
        context: &mut Self::Context,
        radiance: &mut B::Buffer<Radiance>,
    );

    /// Draws samples according to the norms of the gradients with respect to their logits: the derivatives with respect
    /// to density and colour, multiplied by the slopes of the activations. Marks the drawn samples, and divides their
    /// gradients by their probabilities.
    ///
    /// Along a ray, samples are drawn systematically: one is drawn wherever the running sum of the probabilities
    /// reaches a whole number. The sum begins at a random number in [0, 1), the ray's [`SampleDraw::first`].
    fn draw(
        &self,
        tile: &mut Tile<'_, B>,
        draw: &SampleDraw,
        context: &Self::Context,
        arrays: FieldDraw<'_, B>,
    );

    /// Drops all rows of `context`, `radiance` and `radiance_gradients` except the rows `drawn` (ascending). Unlike in
    /// [`keep`](Self::keep), the rows of `context` include those of colour.
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
    /// Returns the policy: steps, thresholds and background.
    fn policy(&self) -> &RendererPolicy;

    /// Returns a mutable reference to the policy.
    fn policy_mut(&mut self) -> &mut RendererPolicy;

    /// Sets the guide that chooses the samples of pictures; `None` for volume rendering.
    ///
    /// # Errors
    /// When the device cannot hold the guide.
    fn set_guide(&mut self, guide: Option<Guide>) -> Result<()>;

    /// Sets the assets of the model's scene. Called once, before the first view is rendered.
    ///
    /// # Errors
    /// When an asset that the renderer needs is missing or broken, or the device cannot hold the asset.
    fn set_assets(&mut self, assets: &Assets) -> Result<()> {
        let guide = self.policy().guide(assets)?;
        self.set_guide(guide)
    }

    /// Applies the schedules of a run: sets the marching step for `progress` in [0, 1].
    fn set_progress(&mut self, progress: f64) {
        self.policy_mut().set_progress(progress);
    }

    /// Returns the compositing weight below which a sample has no colour (`renderer.color_weight`).
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

    /// Drops the samples behind the point where transmittance falls below its minimum, and merges faint samples with
    /// the next sample of their ray ([`Pruning`](crate::math::compositing::Pruning)). `radiance` has one value per
    /// marched sample; `kept` receives the rows that remain, ascending.
    fn prune(
        &self,
        stream: &mut B::Stream,
        radiance: &B::Buffer<Radiance>,
        samples: &mut Samples<B>,
        kept: &mut B::Buffer<u32>,
    );

    /// Lists in `drawn` the rows of the samples that [`Field::draw`] marked, keeps these samples and drops the others.
    /// `marks` has one value per sample. In [`StepSums::drawn`](crate::engine::batch::StepSums), the number of drawn
    /// samples replaces the number of kept samples.
    fn keep_drawn(
        &self,
        stream: &mut B::Stream,
        marks: &B::Buffer<u32>,
        samples: &mut Samples<B>,
        drawn: &mut B::Buffer<u32>,
        sums: &mut B::Sums,
    );

    /// Places samples along the rays of a workspace, evaluates their densities and keeps the visible samples, ready for
    /// colour. `parameters` is flat; `jitter` is as in [`march`](Self::march). A renderer may walk each ray front to
    /// back in pieces and stop where the ray is opaque, provided that it keeps the same samples as
    /// [`evaluate_visible_samples`]. It may also place samples by a rule of its own.
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
    /// targets. `radiance` has one value per sample. `cones` gets one value per ray, and `pixels` gets one value per
    /// group: the mean of the group's cones.
    fn composite(
        &self,
        tile: &mut Tile<'_, B>,
        radiance: &B::Buffer<Radiance>,
        cones: &mut B::Buffer<Pixel>,
        pixels: &mut B::Buffer<Pixel>,
    );

    /// Maps the gradient with respect to each pixel's [r, g, b, opacity] to gradients with respect to density and
    /// colour, one value per sample like `radiance`. `cones` is the output of [`composite`](Self::composite).
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
    /// Returns the policy: the rules of the updates.
    fn policy(&self) -> &OptimizerPolicy;

    /// Returns a mutable reference to the policy.
    fn policy_mut(&mut self) -> &mut OptimizerPolicy;

    /// Performs a step. Gradients are first divided by `sums.weight` of the partial gradients.
    fn step(&mut self, update: &mut Update<'_, B>);

    /// Restricts updates to these parts of the slots, one per slot, because only a part of a growing slot is in use.
    fn restrict(&mut self, parts: &[ActiveRange]) {
        self.policy_mut().restrict(parts);
    }

    /// Returns the first and second moments, flat like the parameters.
    fn moments(&self) -> [&B::Buffer<f32>; 2];

    /// Returns mutable references to the moments, for restoring a checkpoint.
    fn moments_mut(&mut self) -> [&mut B::Buffer<f32>; 2];

    /// Returns the number of gradients that were not finite or whose square overflows f32. The parameters with these
    /// gradients were not updated, because an infinite second moment would never let its parameter move again. The
    /// number includes terms of gradients that a device left out because they were too large.
    fn non_finite(&self) -> u64;
}

/// Generates rays.
pub trait Sampler<B: Backend>: Send + Sync {
    /// Returns the policy: scales, schedules and random numbers.
    fn policy(&self) -> &SamplerPolicy;

    /// Returns a mutable reference to the policy.
    fn policy_mut(&mut self) -> &mut SamplerPolicy;

    /// Distributes the pixels of later steps among the scales, by the schedules at `progress` in [0, 1].
    fn set_progress(&mut self, progress: f64) {
        self.policy_mut().set_progress(progress);
    }

    /// Returns the balance of the scales, as of the last [`set_progress`](Self::set_progress).
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

    /// Adds the errors of the pixels `range` of a training step to their cells of the error map, if there is one.
    /// `rays` are the rays of these pixels, and `pixel_gradients`, one per pixel, is the output of
    /// [`Loss::evaluate_pixels`].
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

    /// Sets another error map of the same photographs, which later steps use to draw their pixels.
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

    /// Updates the densities and bits of the selected cells with the densities in `radiance`, one per cell, in order.
    fn update(&mut self, radiance: &B::Buffer<Radiance>);

    /// Returns the fraction of the cells that are occupied.
    fn occupied(&self) -> f64;

    /// Returns the running maximum of density·step for each cell, in cell order;
    /// [`OUTSIDE`](crate::geometry::occupancy::OUTSIDE) for cells that cannot be occupied.
    fn densities(&self) -> Vec<f32>;

    /// Returns one bit per cell, in cell order, lowest bit first.
    fn bits(&self) -> Vec<u8>;

    /// Restores the values of [`Occupancy::bits`] and, for training, of [`Occupancy::densities`].
    fn restore(&mut self, bits: &[u8], densities: Option<&[f32]>);
}

/// The arrays of a tile that the loss reads after the forward pass.
pub struct RenderedTile<'a, B: Backend> {
    /// The rays with the targets of their pixels.
    pub rays: &'a Rays<B>,
    /// The kept samples along the rays.
    pub samples: &'a Samples<B>,
    /// Density and colour of each sample.
    pub radiance: &'a B::Buffer<Radiance>,
    /// The composited pixels.
    pub pixels: &'a B::Buffer<Pixel>,
}

/// Maps pixels and the weights of their samples to the loss: the sum of the registered terms
/// ([`losses`](crate::field::losses)) that the configuration enables.
pub trait Loss<B: Backend>: Send + Sync {
    /// Sets the gains (RGB) of all photographs, indexed by the numbers in [`Rays::photographs`]. An adjustment
    /// multiplies rendered colours by the gains before the comparison. Initially there are no gains, and rendered
    /// colours are compared as they are.
    fn set_gains(&mut self, gains: &[[f32; 3]]);

    /// Applies the schedules of the terms' weights at `progress` in [0, 1]; initially the progress is 0.
    fn set_progress(&mut self, progress: f64);

    /// Evaluates the photometric term and the terms of pixels. Writes their gradient with respect to each pixel's [r,
    /// g, b, opacity], weighted by area but not yet divided by the sum of the weights, and adds the values of the terms
    /// to `sums`. With gains it also adds the derivatives with respect to the log-gains.
    fn evaluate_pixels(
        &self,
        stream: &mut B::Stream,
        tile: &RenderedTile<'_, B>,
        pixel_gradients: &mut B::Buffer<[f32; 4]>,
        sums: &mut B::Sums,
    );

    /// Adds the terms of rays (the mean over the cones of a pixel, weighted by area) to the sums, and adds their
    /// gradients to those of the densities in `radiance_gradients`, which has one value per sample and was written by
    /// [`Renderer::backward`]. Called once after [`evaluate_pixels`](Self::evaluate_pixels).
    fn evaluate_rays(
        &self,
        stream: &mut B::Stream,
        tile: &RenderedTile<'_, B>,
        radiance_gradients: &mut B::Buffer<Radiance>,
        sums: &mut B::Sums,
    );
}

/// Maps gradients of features to derivatives of the loss with respect to motions of cameras.
///
/// Each ray is displaced, with all of its samples, perpendicular to its direction: by plus and by minus its radius,
/// along a random perpendicular. The difference of a sample's features between the two sides, multiplied by the
/// gradient of the loss with respect to the features and divided by the sample's width, is the mean slope of the loss
/// over this width. The random perpendicular covers only one of the two dimensions across the ray, so the slope is
/// doubled; other steps cover the other dimension. Motion along a ray changes no picture. The gradient neglects how
/// another direction, radius or placement of samples changes density and colour.
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

    /// Adds the derivatives with respect to the photographs' cameras
    /// ([`StepResult::cameras`](crate::engine::batch::StepResult::cameras)) to the sums. `slopes` has one value per
    /// sample, see [`compare`](Self::compare).
    fn add(&self, tile: &mut Tile<'_, B>, step: u64, slopes: &B::Buffer<f32>, sums: &mut B::Sums);
}
