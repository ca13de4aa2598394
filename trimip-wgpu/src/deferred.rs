//! Deferred shading on the GPU: the colour network runs once per ray, on the mean of its samples' geometry features
//! ([`trimip_core::math::deferred`]).

use crate::field_params::{FieldParams, PARAMS};
use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Parts, Text};
use crate::gpu::{Bind, Buffer, GRID, Gpu, Kernel, Pipeline, Rows, Size};
use crate::mlp::DIRECT;
use crate::shaders::{ACTIVATION, COMPOSITING};
use crate::workspace::WgpuBackend;
use std::sync::Arc;
use trimip_core::engine::batch::{Radiance, Samples};
use trimip_core::math::deferred::LEAST_OPACITY;

const DEFERRED: [Source; 5] = [
    GRID,
    COMPOSITING,
    ACTIVATION,
    PARAMS,
    Parts(&[
        Source::whole("DIRECT", DIRECT as u32),
        Source::real("LEAST_OPACITY", LEAST_OPACITY as f32),
        Text(include_str!("shaders/deferred.wgsl")),
    ]),
];

kernels! {
    /// The kernels of deferred shading.
    pub struct Kernels {
        mean_outputs: Kernel::new(
            "mean_outputs",
            &DEFERRED,
            &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read), (5, Write), (6, Write), (7, Write)],
        ),
        ray_colors: Kernel::new(
            "ray_colors",
            &DEFERRED,
            &[(0, Read), (1, Write), (2, Parameters), (3, Read), (6, Write)],
        ),
        ray_color_gradients: Kernel::new(
            "ray_color_gradients",
            &DEFERRED,
            &[(1, Write), (2, Parameters), (3, Read), (8, Read), (9, Write)],
        ),
        spread_gradients: Kernel::new(
            "spread_gradients",
            &DEFERRED,
            &[
                (0, Read),
                (2, Parameters),
                (3, Read),
                (4, Read),
                (5, Write),
                (6, Write),
                (8, Read),
                (9, Write),
                (10, Write),
            ],
        ),
    }
}

/// The arrays of the rays of a tile.
pub struct RayColors {
    /// Fraction of each sample in the mean of its ray.
    fractions: Buffer<f32>,
    /// Opacity of each ray, or 0 if the ray has no colour, then the mean of its geometry features: [rays,
    /// [`outputs`](crate::field::WgpuField::outputs)].
    means: Buffer<f32>,
    /// Number of rays.
    count: Buffer<u32>,
}

impl RayColors {
    /// Creates empty arrays.
    pub fn new(gpu: &Arc<Gpu>) -> Self {
        Self { fractions: Buffer::zeros(gpu, 0), means: Buffer::zeros(gpu, 0), count: Buffer::zeros(gpu, 1) }
    }

    /// Returns the rows of the colour network, one for each ray of `samples`.
    pub fn rows(&self, samples: &Samples<WgpuBackend>) -> Rows {
        let capacity = samples.segments.known_len().unwrap_or(0);
        Rows { counts: self.count.raw().clone(), counter: 0, capacity }
    }

    /// Returns the means.
    pub fn means(&self) -> &Buffer<f32> {
        &self.means
    }
}

/// Deferred shading for one field.
pub struct Deferred {
    gpu: Arc<Gpu>,
    kernels: Kernels,
}

impl Deferred {
    /// Finds the kernels of a device.
    pub fn new(gpu: &Arc<Gpu>) -> Self {
        Self { gpu: Arc::clone(gpu), kernels: Kernels::new(gpu) }
    }

    /// Runs a kernel with one invocation per ray.
    fn per_ray<const N: usize>(
        &self,
        kernel: &Pipeline,
        binds: &[Bind<'_>; N],
        field: &FieldParams,
        samples: &Samples<WgpuBackend>,
    ) {
        let count = samples.segments.known_len().unwrap_or(0);
        let params = FieldParams { rays: count as u32, ..*field };
        self.gpu.dispatch(kernel, binds, &params, Size::Items(count as u64));
    }

    /// Computes the mean of the density network's `outputs` along each ray. Returns the rows of the colour network, one for
    /// each ray.
    pub fn mean(
        &self,
        samples: &Samples<WgpuBackend>,
        field: &FieldParams,
        (outputs, radiance): (&Buffer<f32>, &Buffer<Radiance>),
        colors: &mut RayColors,
    ) -> Rows {
        colors.fractions.reserve(radiance.most());
        let rows = colors.rows(samples);
        rows.size(&mut colors.means, field.outputs as usize);
        let binds = [
            outputs.bind(),
            radiance.bind(),
            samples.segments.bind(),
            samples.intervals.bind(),
            colors.fractions.bind(),
            colors.means.bind(),
            colors.count.bind(),
        ];
        self.per_ray(&self.kernels.mean_outputs, &binds, field, samples);
        rows
    }

    /// Writes the colour of each ray to all of its samples. `logits` are the outputs of the colour network.
    pub fn colors(
        &self,
        samples: &Samples<WgpuBackend>,
        field: &FieldParams,
        logits: &Buffer<f32>,
        radiance: &Buffer<Radiance>,
        colors: &RayColors,
    ) {
        let binds = [logits.bind(), radiance.bind(), samples.segments.bind(), colors.means.bind()];
        self.per_ray(&self.kernels.ray_colors, &binds, field, samples);
    }

    /// Computes the gradients of the colour logits of each ray.
    pub fn color_gradients(
        &self,
        samples: &Samples<WgpuBackend>,
        field: &FieldParams,
        (radiance, radiance_gradients): (&Buffer<Radiance>, &Buffer<Radiance>),
        by_logits: &Buffer<f32>,
    ) {
        let binds = [radiance.bind(), samples.segments.bind(), radiance_gradients.bind(), by_logits.bind()];
        self.per_ray(&self.kernels.ray_color_gradients, &binds, field, samples);
    }

    /// Spreads the gradients of the colour network's input, `by_inputs`, over the samples of each ray, and computes the
    /// gradients of all outputs of the density network.
    pub fn spread(
        &self,
        samples: &Samples<WgpuBackend>,
        field: &FieldParams,
        colors: &RayColors,
        (outputs, by_outputs): (&Buffer<f32>, &Buffer<f32>),
        (radiance_gradients, by_inputs): (&Buffer<Radiance>, &Buffer<f32>),
    ) {
        let binds = [
            outputs.bind(),
            samples.segments.bind(),
            samples.intervals.bind(),
            colors.fractions.bind(),
            colors.means.bind(),
            radiance_gradients.bind(),
            by_outputs.bind(),
            by_inputs.bind(),
        ];
        self.per_ray(&self.kernels.spread_gradients, &binds, field, samples);
    }
}
