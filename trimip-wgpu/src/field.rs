//! Density and colour networks on the GPU. The activations of a step stay on the device. If the field has no networks, the encoder's
//! features are the logits of density and colour.

use crate::deferred::{Deferred, RayColors};
use crate::field_params::{FieldParams, PARAMS};
use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Parts, Text};
use crate::gpu::{Buffer, GRID, GROUP, Gpu, Kernel, Rows, Size};
use crate::mlp::{Activations, DIRECT, Flow, Mlp, Partials};
use crate::products::padded;
use crate::shaders::{ACTIVATION, COMPOSITING, HARMONICS, RANDOM, RAY, VORONOI};
use crate::workspace::{Capacity, DeviceCounters, Stream, WgpuBackend};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use trimip_core::config::Precision;
use trimip_core::engine::batch::{
    FieldBackward, FieldDraw, PartialGradients, Radiance, Rays, SampleDraw, Samples, Tile,
};
use trimip_core::engine::policy::FieldPolicy;
use trimip_core::{Config, Field, Layout};

shared! {
    /// Parameters of the kernel that blackens samples of little weight.
    struct DimParams as Params {
        /// Number of rays.
        count: u32,
        /// Minimum weight of a sample with a colour.
        least: f32,
    }
}

shared! {
    /// Parameters of the kernel that draws samples for the backward pass.
    struct DrawParams as Params {
        draws: [u32; 4],
        threshold: f32,
        /// Number of rays, and the index of the first ray within the step.
        count: u32,
        first: u32,
        /// Width of the density network's output; its first value is the logit.
        outputs: u32,
        /// Activation function of the density, with its shift and its factor.
        density: u32,
        shift: f32,
        scale: f32,
        /// 1 if the field has no networks; colours are then clamped, otherwise they are sigmoids.
        direct: u32,
    }
}

/// Shader source: the operations before and after the two networks.
pub const FIELD: Source = Parts(&[
    GRID,
    RAY,
    PARAMS,
    ACTIVATION,
    HARMONICS,
    VORONOI,
    Source::whole("DIRECT", DIRECT as u32),
    Text(include_str!("shaders/field.wgsl")),
]);

const DENSITY_GRADIENTS: [Source; 4] =
    [GRID, PARAMS, ACTIVATION, Text(include_str!("shaders/density_gradients.wgsl"))];

const DIM: [Source; 4] =
    [GRID, COMPOSITING, Source::of::<DimParams>(), Text(include_str!("shaders/dim.wgsl"))];

const DRAW: [Source; 5] =
    [GRID, RANDOM, ACTIVATION, Source::of::<DrawParams>(), Text(include_str!("shaders/draw_samples.wgsl"))];

kernels! {
    /// The kernels of a field, except those of its networks.
    pub struct Kernels {
        densities: Kernel::new("densities", &[FIELD], &[(0, Read), (1, Write), (2, Parameters), (3, Read)]),
        color_inputs: Kernel::new(
            "color_inputs",
            &[FIELD],
            &[(0, Read), (2, Parameters), (3, Read), (4, Read), (5, Read), (6, Write)],
        ),
        colors: Kernel::new("colors", &[FIELD], &[(0, Read), (1, Write), (2, Parameters), (3, Read)]),
        dim: Kernel::new("dim", &DIM, &[(0, Read), (1, Write), (2, Parameters), (3, Read)]),
        draw: Kernel::new(
            "draw",
            &DRAW,
            &[(0, Read), (1, Read), (2, Parameters), (3, Read), (4, Write), (5, Write)],
        ),
        color_gradients: Kernel::new(
            "color_gradients",
            &[FIELD],
            &[(1, Write), (2, Parameters), (3, Read), (6, Write), (7, Read)],
        ),
        density_gradients: Kernel::new(
            "density_gradients",
            &DENSITY_GRADIENTS,
            &[(0, Read), (1, Write), (2, Parameters), (3, Read), (4, Read), (5, Read)],
        ),
    }
}

/// The density and colour networks.
pub struct WgpuField {
    gpu: Arc<Gpu>,
    kernels: Kernels,
    policy: FieldPolicy,
    density: Mlp,
    color: Mlp,
    /// Deferred shading, if it is enabled.
    deferred: Option<Deferred>,
    /// Width of the colour network's input: the encoded view direction, the geometry features with their sines and
    /// cosines, and padding.
    width: usize,
    layout: Layout,
    overflows: Buffer<u32>,
    counters: Arc<DeviceCounters>,
}

/// Activations of a step.
pub struct Context {
    density: Activations,
    color: Activations,
    color_input: Buffer<f32>,
    color_gradient: Buffer<f32>,
    input_gradient: Buffer<f32>,
    output_gradient: Buffer<f32>,
    scratch: [Buffer<f32>; 2],
    /// The rays' colours with deferred shading.
    rays: RayColors,
}

impl Context {
    /// Returns the outputs of the density network, [samples, [`outputs`](WgpuField::outputs)].
    pub fn outputs(&self) -> &Buffer<f32> {
        &self.density[self.density.len() - 1]
    }
}

/// Weight gradients of both networks, in chunks.
pub struct FieldGradient {
    density: Partials,
    color: Partials,
}

impl WgpuField {
    /// Creates the networks of a configuration.
    pub fn new(gpu: &Arc<Gpu>, config: &Config, layout: &Layout, counters: Arc<DeviceCounters>) -> Self {
        let overflows = Buffer::zeros(gpu, 1);
        let matrices = if config.field.precision == Precision::F16 { gpu.matrices() } else { None };
        let policy = FieldPolicy::new(config);
        let [density, color] = [&policy.density, &policy.color]
            .map(|network| Mlp::new(gpu, network, layout, matrices, &overflows));
        Self {
            gpu: Arc::clone(gpu),
            kernels: Kernels::new(gpu),
            deferred: config.field.deferred.then(|| Deferred::new(gpu)),
            width: if policy.is_direct() { DIRECT } else { padded(policy.color.inputs()) },
            policy,
            density,
            color,
            layout: layout.clone(),
            overflows,
            counters,
        }
    }

    /// Returns the width of the density network's output: the logit, the geometry features, and padding.
    pub fn outputs(&self) -> usize {
        padded(1 + self.geometry())
    }

    /// Returns the number of geometry features.
    pub fn geometry(&self) -> usize {
        self.policy.geometry
    }

    fn params(&self, rows: &Rows) -> FieldParams {
        let field = &self.policy.settings;
        FieldParams {
            counter: rows.counter,
            width: self.width as u32,
            view: self.policy.view as u32,
            geometry: self.geometry() as u32,
            outputs: self.outputs() as u32,
            encoding: field.view as u32,
            sharpness: field.view_sharpness,
            view_frequencies: field.view_frequencies,
            geometry_frequencies: self.policy.geometry_frequencies(),
            density: field.density as u32,
            shift: field.density_shift,
            scale: field.density_scale,
            direct: u32::from(self.policy.is_direct()),
            deferred: u32::from(self.deferred.is_some()),
            rays: 0,
            least: 0.0,
        }
    }

    /// Writes the input of the colour network for each row, and runs the rows through it. `outputs` are those of the density
    /// network, or their means along rays with deferred shading.
    fn logits<'a>(
        &self,
        rows: &Rows,
        (rays, samples): (&Rays<WgpuBackend>, &Samples<WgpuBackend>),
        outputs: &Buffer<f32>,
        color_input: &mut Buffer<f32>,
        color: &'a mut Activations,
    ) -> &'a Buffer<f32> {
        rows.size(color_input, self.width);
        let binds = [outputs.bind(), rows.bind(), rays.rays.bind(), samples.rays.bind(), color_input.bind()];
        self.gpu.dispatch(&self.kernels.color_inputs, &binds, &self.params(rows), rows.dispatch(1, GROUP));
        self.color.forward(&self.gpu, rows, color_input, color);
        &color[color.len() - 1]
    }

    /// Computes the gradients of the colour logits, [samples, [`DIRECT`]].
    fn color_gradients(
        &self,
        rows: &Rows,
        (radiance, radiance_gradients): (&Buffer<Radiance>, &Buffer<Radiance>),
        by_logits: &mut Buffer<f32>,
    ) {
        rows.size(by_logits, DIRECT);
        let binds = [radiance.bind(), rows.bind(), by_logits.bind(), radiance_gradients.bind()];
        self.gpu.dispatch(&self.kernels.color_gradients, &binds, &self.params(rows), rows.dispatch(1, GROUP));
    }

    /// Runs the colour network backward, from the gradients of its logits to those of its input.
    fn pull_color(&self, rows: &Rows, context: &mut Context, gradient: &FieldGradient) {
        let Context { color, color_input, color_gradient, input_gradient, scratch, .. } = context;
        let flow =
            Flow { by_output: color_gradient, scratch, by_input: input_gradient, partials: &gradient.color };
        self.color.backward(&self.gpu, rows, color_input, color, flow);
    }

    /// Computes the gradients of the density network's outputs from those of the geometry features and of the densities.
    fn density_gradients(
        &self,
        rows: &Rows,
        (outputs, by_outputs): (&Buffer<f32>, &mut Buffer<f32>),
        (by_geometry, radiance_gradients): (&Buffer<f32>, &Buffer<Radiance>),
    ) {
        rows.size(by_outputs, self.outputs());
        let binds =
            [outputs.bind(), by_outputs.bind(), rows.bind(), by_geometry.bind(), radiance_gradients.bind()];
        self.gpu.dispatch(
            &self.kernels.density_gradients,
            &binds,
            &self.params(rows),
            rows.dispatch(1, GROUP),
        );
    }

    /// Keeps rows as [`Field::keep`] does, but only of the part of the context that colours need. A backward pass is
    /// not possible afterwards.
    pub fn keep_outputs(
        &self,
        stream: &mut Stream,
        kept: &Buffer<u32>,
        context: &mut Context,
        radiance: &mut Buffer<Radiance>,
    ) {
        if let Some(outputs) = context.density.last_mut() {
            stream.keep(kept, outputs, self.outputs());
        }
        stream.keep(kept, radiance, 4);
    }

    /// Returns the counter of factors that f16 cannot hold, one number.
    pub fn overflows(&self) -> &Buffer<u32> {
        &self.overflows
    }

    /// Switches to f32, after a factor has occurred that f16 cannot hold.
    fn fall_back(&mut self) {
        let [density, color] = [&self.policy.density, &self.policy.color]
            .map(|network| Mlp::new(&self.gpu, network, &self.layout, None, &self.overflows));
        (self.density, self.color) = (density, color);
    }
}

impl Field<WgpuBackend> for WgpuField {
    type Context = Context;
    type Gradient = FieldGradient;

    fn context(&self) -> Context {
        let empty = || Buffer::zeros(&self.gpu, 0);
        Context {
            density: self.density.activations(&self.gpu),
            color: self.color.activations(&self.gpu),
            color_input: empty(),
            color_gradient: empty(),
            input_gradient: empty(),
            output_gradient: empty(),
            scratch: [empty(), empty()],
            rays: RayColors::new(&self.gpu),
        }
    }

    fn gradient(&self) -> FieldGradient {
        FieldGradient { density: self.density.partials(&self.gpu), color: self.color.partials(&self.gpu) }
    }

    fn refresh(&mut self, parameters: &Buffer<f32>) {
        if self.density.is_half() && self.counters.overflows.load(Ordering::Relaxed) > 0 {
            self.fall_back();
        }
        self.density.pack(&self.gpu, parameters);
        self.color.pack(&self.gpu, parameters);
    }

    fn density(
        &self,
        tile: &mut Tile<'_, WgpuBackend>,
        features: &Buffer<f32>,
        context: &mut Context,
        radiance: &mut Buffer<Radiance>,
    ) {
        let rows = Rows::of(&tile.samples.spheres, &mut tile.stream.count);
        self.density.forward(&self.gpu, &rows, features, &mut context.density);
        rows.size(radiance, 1);
        let outputs = &context.density[context.density.len() - 1];
        let binds = [outputs.bind(), radiance.bind(), rows.bind()];
        self.gpu.dispatch(&self.kernels.densities, &binds, &self.params(&rows), rows.dispatch(1, GROUP));
    }

    fn keep(
        &self,
        stream: &mut Stream,
        kept: &Buffer<u32>,
        context: &mut Context,
        radiance: &mut Buffer<Radiance>,
    ) {
        for (width, activations) in self.density.widths().zip(&mut context.density) {
            stream.keep(kept, activations, width);
        }
        stream.keep(kept, radiance, 4);
    }

    fn color(
        &self,
        tile: &mut Tile<'_, WgpuBackend>,
        least: f32,
        context: &mut Context,
        radiance: &mut Buffer<Radiance>,
    ) {
        let Tile { stream, rays, samples, .. } = tile;
        let rows = Rows::of(&samples.spheres, &mut stream.count);
        let Context { density, color, color_input, rays: colors, .. } = context;
        let outputs = &density[density.len() - 1];
        if let Some(deferred) = &self.deferred {
            let params = FieldParams { least, ..self.params(&rows) };
            let of_rays = deferred.mean(samples, &params, (outputs, radiance), colors);
            let logits = self.logits(&of_rays, (rays, samples), colors.means(), color_input, color);
            return deferred.colors(samples, &params, logits, radiance, colors);
        }
        let logits = if self.policy.is_direct() {
            outputs
        } else {
            self.logits(&rows, (rays, samples), outputs, color_input, color)
        };
        let binds = [logits.bind(), radiance.bind(), rows.bind()];
        self.gpu.dispatch(&self.kernels.colors, &binds, &self.params(&rows), rows.dispatch(1, GROUP));
        if least > 0.0 {
            // A colour of 0 has no gradient, because its derivative with respect to the logit is 0.
            let count = samples.segments.known_len().unwrap_or(0);
            let binds = [samples.segments.bind(), radiance.bind(), samples.intervals.bind()];
            let params = DimParams { count: count as u32, least };
            self.gpu.dispatch(&self.kernels.dim, &binds, &params, Size::Items(count as u64));
        }
    }

    fn draw(
        &self,
        tile: &mut Tile<'_, WgpuBackend>,
        draw: &SampleDraw,
        context: &Context,
        arrays: FieldDraw<'_, WgpuBackend>,
    ) {
        let FieldDraw { radiance, radiance_gradients, marks } = arrays;
        let Tile { rays, samples, .. } = tile;
        let count = samples.segments.known_len().unwrap_or(0);
        marks.reserve(radiance.most());
        let field = &self.policy.settings;
        let params = DrawParams {
            draws: draw.draws.words(),
            threshold: draw.threshold,
            count: count as u32,
            first: rays.first,
            outputs: self.outputs() as u32,
            density: field.density as u32,
            shift: field.density_shift,
            scale: field.density_scale,
            direct: u32::from(self.policy.is_direct()),
        };
        let binds = [
            context.outputs().bind(),
            radiance.bind(),
            samples.segments.bind(),
            radiance_gradients.bind(),
            marks.bind(),
        ];
        self.gpu.dispatch(&self.kernels.draw, &binds, &params, Size::Items(count as u64));
    }

    fn keep_drawn(
        &self,
        stream: &mut Stream,
        drawn: &Buffer<u32>,
        context: &mut Context,
        radiance: &mut Buffer<Radiance>,
        radiance_gradients: &mut Buffer<Radiance>,
    ) {
        self.keep(stream, drawn, context, radiance);
        stream.keep_in(Capacity::Kept, drawn, radiance_gradients, 4);
        if !self.policy.is_direct() {
            stream.keep_in(Capacity::Kept, drawn, &mut context.color_input, self.width);
            for (width, activations) in self.color.widths().zip(&mut context.color) {
                stream.keep_in(Capacity::Kept, drawn, activations, width);
            }
        }
    }

    fn backward(
        &self,
        tile: &mut Tile<'_, WgpuBackend>,
        arrays: FieldBackward<'_, WgpuBackend>,
        context: &mut Context,
        gradient: &mut FieldGradient,
    ) {
        let Tile { stream, samples, .. } = tile;
        let FieldBackward { features, radiance, radiance_gradients, feature_gradients } = arrays;
        let rows = Rows::of(&samples.spheres, &mut stream.count);
        if self.policy.is_direct() {
            self.color_gradients(&rows, (radiance, radiance_gradients), &mut context.color_gradient);
            let Context { density, color_gradient, .. } = context;
            let outputs = (&density[density.len() - 1], feature_gradients);
            return self.density_gradients(&rows, outputs, (color_gradient, radiance_gradients));
        }
        if let Some(deferred) = &self.deferred {
            let params = self.params(&rows);
            let of_rays = context.rays.rows(samples);
            of_rays.size(&mut context.color_gradient, DIRECT);
            let colors = (radiance, radiance_gradients);
            deferred.color_gradients(samples, &params, colors, &context.color_gradient);
            self.pull_color(&of_rays, context, gradient);
            let Context { density, rays, input_gradient, output_gradient, .. } = context;
            rows.size(output_gradient, self.outputs());
            let outputs = (&density[density.len() - 1], &*output_gradient);
            deferred.spread(samples, &params, rays, outputs, (radiance_gradients, input_gradient));
        } else {
            self.color_gradients(&rows, (radiance, radiance_gradients), &mut context.color_gradient);
            self.pull_color(&rows, context, gradient);
            let Context { density, input_gradient, output_gradient, .. } = context;
            let outputs = (&density[density.len() - 1], output_gradient);
            self.density_gradients(&rows, outputs, (input_gradient, radiance_gradients));
        }
        let Context { density, output_gradient, scratch, .. } = context;
        let flow = Flow {
            by_output: output_gradient,
            scratch,
            by_input: feature_gradients,
            partials: &gradient.density,
        };
        self.density.backward(&self.gpu, &rows, features, density, flow);
    }

    fn reduce(
        &mut self,
        partials: &mut [PartialGradients<WgpuBackend>],
        parameter_gradient: &mut Buffer<f32>,
    ) {
        // A step is one tile and has one set of partial gradients; the next step overwrites its chunks.
        for partial in partials {
            let FieldGradient { density, color } = &partial.field;
            self.density.reduce(&self.gpu, density, parameter_gradient);
            self.color.reduce(&self.gpu, color, parameter_gradient);
        }
    }
}
