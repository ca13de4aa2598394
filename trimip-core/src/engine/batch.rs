//! The batches that flow from stage to stage, each in its device's buffers. Samples are packed: the samples of a ray
//! are consecutive, front to back, and a [`Segment`] holds their range.

pub use crate::engine::step_result::{CameraSums, MOST_PENDING, StepResult, StepSums};
pub use crate::geometry::elements::{Interval, Radiance, Ray, Segment, Sphere, Target};

use crate::{
    Backend, Field, Pixel,
    engine::{backend::Encoder, ranks::Rank, ray_allocation::RayAllocation},
    math::rng::{Draws, unit},
};

/// Cones of a tile. The cones of a pixel are consecutive.
pub struct Rays<B: Backend> {
    /// One per cone.
    pub rays: B::Buffer<Ray>,
    /// One per pixel: the range of its cones.
    pub groups: B::Buffer<Segment>,
    /// One per pixel in training; empty otherwise.
    pub targets: B::Buffer<Target>,
    /// One per pixel in training with `loss.exposure` or refined poses: the number of its photograph, see
    /// [`exposure`](crate::engine::exposure). Empty otherwise.
    pub photographs: B::Buffer<u32>,
    /// Index of the tile's first ray within the step. The random numbers of a ray are derived from its index.
    pub first: u32,
}

impl<B: Backend> Rays<B> {
    /// Creates an empty batch.
    pub fn new(backend: &B) -> Self {
        Self {
            rays: backend.zeros(0),
            groups: backend.zeros(0),
            targets: backend.zeros(0),
            photographs: backend.zeros(0),
            first: 0,
        }
    }

    /// Replaces all rays with `rays`, one cone per pixel, without targets.
    pub fn place(&mut self, backend: &B, rays: &[Ray]) {
        let group = |start: usize| Segment { start: start as u32, count: 1 };
        backend.write(&mut self.rays, rays);
        backend.write(&mut self.groups, &(0..rays.len()).map(group).collect::<Vec<_>>());
        backend.write(&mut self.targets, &[]);
        backend.write(&mut self.photographs, &[]);
        self.first = 0;
    }
}

/// Samples of a tile. Together with the tile's rays, they hold the full geometry: ray, direction, distance, length,
/// radius.
pub struct Samples<B: Backend> {
    /// One per ray.
    pub segments: B::Buffer<Segment>,
    /// One per sample: the index of its ray within the tile.
    pub rays: B::Buffer<u32>,
    /// One per sample.
    pub intervals: B::Buffer<Interval>,
    /// One per sample.
    pub spheres: B::Buffer<Sphere>,
    /// One pair: the number of marched samples and the number of kept samples.
    pub counts: B::Buffer<[u32; 2]>,
}

/// The arguments that the stages of a tile of rays share: the stream on which they issue their work, and the arrays that
/// all of them read.
pub struct Tile<'a, B: Backend> {
    /// The stream on which the work is issued.
    pub stream: &'a mut B::Stream,
    /// All parameters, flat.
    pub parameters: &'a B::Buffer<f32>,
    /// The cones of the tile.
    pub rays: &'a Rays<B>,
    /// The samples along these cones.
    pub samples: &'a Samples<B>,
}

/// The arrays of a field's backward pass.
pub struct FieldBackward<'a, B: Backend> {
    /// Encoded samples, [samples, stride].
    pub features: &'a B::Buffer<f32>,
    /// Density and colour of each sample.
    pub radiance: &'a B::Buffer<Radiance>,
    /// Gradient of `radiance`.
    pub radiance_gradients: &'a B::Buffer<Radiance>,
    /// Receives the gradient of `features`, of the same shape.
    pub feature_gradients: &'a mut B::Buffer<f32>,
}

/// The rule by which a step draws the samples that have a backward pass. A sample's probability is proportional to the
/// norm of its gradient, and at most 1. The gradient of a drawn sample is divided by its probability, so that the
/// expected gradient is unchanged.
#[derive(Clone, Copy, Debug)]
pub struct SampleDraw {
    /// The random numbers of the step, one per ray.
    pub draws: Draws,
    /// Smallest norm of the gradient with respect to a sample's logits (density and colour) at which the sample is
    /// drawn with certainty.
    pub threshold: f32,
}

impl SampleDraw {
    /// Returns the random number of ray `index` of a step, in [0, 1).
    #[inline]
    pub fn first(&self, index: u32) -> f32 {
        unit(self.draws.bits(index)[0])
    }

    /// Returns the probability of drawing a sample whose gradient has this norm.
    #[inline]
    pub fn probability(&self, norm: f32) -> f32 {
        // A NaN gradient has the probability 1 and is rejected later.
        if norm < self.threshold { norm / self.threshold } else { 1.0 }
    }
}

/// The arrays of a field's draw of samples.
pub struct FieldDraw<'a, B: Backend> {
    /// Density and colour of each sample.
    pub radiance: &'a B::Buffer<Radiance>,
    /// Gradient of `radiance`. The draw divides the gradient of each drawn sample by the sample's probability.
    pub radiance_gradients: &'a mut B::Buffer<Radiance>,
    /// Receives one value per sample: 1 if it is drawn, otherwise 0.
    pub marks: &'a mut B::Buffer<u32>,
}

/// All buffers of a tile, from its rays to its gradients; the next tile reuses them.
pub struct Workspace<B: Backend> {
    /// The stream on which the tile's work is issued.
    pub stream: B::Stream,
    /// Rays.
    pub rays: Rays<B>,
    /// Samples along the rays.
    pub samples: Samples<B>,
    /// Values that the encoder keeps from the forward pass for the backward pass, [samples,
    /// [`context`](crate::field::encoders::Definition::context)].
    pub encoder_context: B::Buffer<f32>,
    /// Encoded samples, [samples, stride].
    pub features: B::Buffer<f32>,
    /// Gradient of the features, of the same shape.
    pub feature_gradients: B::Buffer<f32>,
    /// Values that the field keeps from the forward pass for the backward pass.
    pub field_context: <B::Field as Field<B>>::Context,
    /// Density and colour of each sample.
    pub radiance: B::Buffer<Radiance>,
    /// Gradient of `radiance`.
    pub radiance_gradients: B::Buffer<Radiance>,
    /// Row indices of the samples that pruning kept, later of the samples that were drawn; ascending.
    pub kept: B::Buffer<u32>,
    /// If samples are drawn: one value per sample, 1 if it is drawn, otherwise 0.
    pub marks: B::Buffer<u32>,
    /// Composited cones, one per ray.
    pub cones: B::Buffer<Pixel>,
    /// One per pixel: the mean of its cones.
    pub pixels: B::Buffer<Pixel>,
    /// Gradient with respect to each pixel's [r, g, b, opacity].
    pub pixel_gradients: B::Buffer<[f32; 4]>,
    /// The samples on displaced rays.
    pub displaced: Displaced<B>,
}

impl<B: Backend> Workspace<B> {
    /// Creates an empty workspace.
    pub fn new(backend: &B, field: &B::Field) -> Self {
        Self {
            stream: backend.stream(),
            rays: Rays::new(backend),
            samples: Samples {
                segments: backend.zeros(0),
                rays: backend.zeros(0),
                intervals: backend.zeros(0),
                spheres: backend.zeros(0),
                counts: backend.zeros(1),
            },
            encoder_context: backend.zeros(0),
            features: backend.zeros(0),
            feature_gradients: backend.zeros(0),
            field_context: field.context(),
            radiance: backend.zeros(0),
            radiance_gradients: backend.zeros(0),
            kept: backend.zeros(0),
            marks: backend.zeros(0),
            cones: backend.zeros(0),
            pixels: backend.zeros(0),
            pixel_gradients: backend.zeros(0),
            displaced: Displaced::new(backend),
        }
    }
}

/// The samples of a tile on displaced rays, for the gradient with respect to poses; empty unless poses are refined.
pub struct Displaced<B: Backend> {
    /// One per cone.
    pub rays: B::Buffer<Ray>,
    /// One per sample.
    pub spheres: B::Buffer<Sphere>,
    /// The encoder's context of the displaced samples.
    pub encoder_context: B::Buffer<f32>,
    /// Encoded samples, [samples, stride].
    pub features: B::Buffer<f32>,
    /// One per sample: Σ feature · gradient on one side of the ray minus this sum on the opposite side
    /// ([`PoseGradients::compare`](crate::engine::backend::PoseGradients::compare)).
    pub slopes: B::Buffer<f32>,
}

impl<B: Backend> Displaced<B> {
    /// Creates an empty batch.
    pub fn new(backend: &B) -> Self {
        Self {
            rays: backend.zeros(0),
            spheres: backend.zeros(0),
            encoder_context: backend.zeros(0),
            features: backend.zeros(0),
            slopes: backend.zeros(0),
        }
    }
}

/// Gradients and sums of the tiles that share this set. The sets are kept until the end of the step, then added up in a
/// fixed order.
pub struct PartialGradients<B: Backend> {
    /// Gradients of the networks.
    pub field: <B::Field as Field<B>>::Gradient,
    /// Gradients of features, to be scattered to texels.
    pub encoder: <B::Encoder as Encoder<B>>::Gradient,
    /// Losses and counts.
    pub sums: B::Sums,
}

/// The pixels of a training step that a rank works on, and how they are cut into tiles.
#[derive(Clone, Copy, Debug)]
pub struct Batch<'a> {
    /// The pixels of the whole step, of all ranks.
    pub allocation: &'a RayAllocation,
    /// This rank, which works on its share of the pixels.
    pub this_rank: Rank,
    /// Approximate number of cones per tile.
    pub per_tile: u32,
}

/// Items that are processed in tiles.
#[derive(Clone, Copy, Debug)]
pub struct Tiling {
    /// Number of items.
    pub count: u32,
    /// Number of items per tile.
    pub per_tile: u32,
}

/// The arrays from which a step computes new parameters.
pub struct Update<'a, B: Backend> {
    /// All parameters, flat; the update overwrites them with the new values.
    pub parameters: &'a mut B::Buffer<f32>,
    /// The gradient of all parameters, flat, not yet divided by the sum of the weights.
    pub gradient: &'a mut B::Buffer<f32>,
    /// The step's partial gradients, which hold the sum of the weights.
    pub partials: &'a mut [PartialGradients<B>],
    /// Learning rate of the networks.
    pub learning_rate: f64,
    /// Number of the step, counted from 1.
    pub step: u64,
}
