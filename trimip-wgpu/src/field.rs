//! Density and colour networks on the GPU, layer by layer. The activations of a step stay on the device. Widths are
//! padded to multiples of 16 with zero weights.

use crate::backend::{Known, Lane, WgpuBackend};
use crate::buffer::Buffer;
use crate::device::{Bind, GROUP, Gpu, Size};
use crate::kernel::{
    COLOR_GRADIENTS, COLOR_INPUTS, COLORS, DENSITIES, DENSITY_GRADIENT, Kernel, PACK, PACK_HALF, REDUCE,
};
use crate::products::{Finish, GRADIENT_SCALE, Matrices, accumulate, multiply, multiplying, tile};
use crate::rows::Rows;
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use trimip_core::batch::{Deposit, Radiance, Rays, Samples};
use trimip_core::config::Precision;
use trimip_core::params::{Slot, color_layers, harmonics};
use trimip_core::{Config, Field, Layout};

/// Number of chunks of a weight gradient, each over a run of samples; the chunks are added in order.
pub const CHUNKS: u32 = 64;

/// Parameters of the kernels between the networks.
#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct FieldParams {
    counter: u32,
    /// Width of the colour network's input.
    width: u32,
    /// Number of spherical harmonics of a direction, number of geometry features, and width of the density network's
    /// output.
    harmonics: u32,
    geometry: u32,
    outputs: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct WeightParams {
    start: u32,
    inputs: u32,
    outputs: u32,
    k: u32,
    n: u32,
    chunks: u32,
    scale: f32,
}

/// Padded width of a matrix on the device.
pub fn padded(width: usize) -> usize {
    width.next_multiple_of(16)
}

/// The matrices of one layer.
struct Layer {
    slot: Slot,
    k: usize,
    n: usize,
    /// The matrix and its transpose, in words of one f32 or two f16.
    forward: Buffer<u32>,
    backward: Buffer<u32>,
    matrices: Option<Matrices>,
    /// Number of factors that f16 cannot hold, over all layers.
    overflows: wgpu::Buffer,
}

impl Layer {
    fn new(gpu: &Arc<Gpu>, slot: &Slot, matrices: Option<Matrices>, overflows: &Buffer<u32>) -> Self {
        let [k, n] = [slot.shape[0], slot.shape[1]].map(padded);
        let words = if matrices.is_some() { k * n / 2 } else { k * n };
        Self {
            slot: slot.clone(),
            k,
            n,
            forward: Buffer::zeros(gpu, words),
            backward: Buffer::zeros(gpu, words),
            matrices,
            overflows: overflows.raw().clone(),
        }
    }

    /// The bindings of a product or weight gradient, plus the overflow counter if the layer uses cooperative
    /// matrices.
    fn with_overflows<'a>(&'a self, binds: &[Bind<'a>]) -> Vec<Bind<'a>> {
        let own = self.matrices.map(|_| Bind { buffer: &self.overflows, offset: 0, size: None });
        binds.iter().copied().chain(own).collect()
    }

    fn params(&self) -> WeightParams {
        WeightParams {
            start: self.slot.range.start as u32,
            inputs: self.slot.shape[0] as u32,
            outputs: self.slot.shape[1] as u32,
            k: self.k as u32,
            n: self.n as u32,
            chunks: CHUNKS,
            scale: if self.matrices.is_some() { (GRADIENT_SCALE as f32).recip() } else { 1.0 },
        }
    }

    /// The product with the matrix, or with its transpose if a `scale` for gradients is given.
    fn product(&self, finish: Finish, scale: Option<u32>) -> Kernel {
        let (k, n) = if scale.is_some() { (self.n, self.k) } else { (self.k, self.n) };
        multiply(k, n, finish, self.matrices, scale.unwrap_or(1))
    }

    /// Workgroups per chunk of the weight gradient.
    fn tiles(&self) -> u64 {
        let side = |width: usize| width / (16 * tile(width) as usize);
        match self.matrices {
            None => (side(self.k) * side(self.n)) as u64,
            Some(matrices) => matrices.tiles(self.k, self.n).into(),
        }
    }
}

/// A ReLU network without biases.
struct Mlp {
    layers: Vec<Layer>,
}

/// Activations of a network: hidden layers after their ReLU, then the output.
type Activations = Vec<Buffer<f32>>;

impl Mlp {
    /// Runs rows through the network.
    fn forward(&self, gpu: &Gpu, rows: &Rows, input: &Buffer<f32>, activations: &mut Activations) {
        for (i, layer) in self.layers.iter().enumerate() {
            let (before, after) = activations.split_at_mut(i);
            let input = before.last().unwrap_or(input);
            rows.size(&mut after[0], layer.n);
            let finish = if i + 1 == self.layers.len() { Finish::Store } else { Finish::Relu };
            let binds = [input.bind(), layer.forward.bind(), after[0].bind(), rows.bind()];
            let size = multiplying(rows, layer.k, layer.n, layer.matrices);
            let binds = layer.with_overflows(&binds);
            gpu.dispatch(&layer.product(finish, None), &binds, &rows.counter, size);
        }
    }

    /// Computes the gradient of the input from that of the output; writes weight gradients to `partials`.
    #[allow(clippy::too_many_arguments)]
    fn backward(
        &self,
        gpu: &Gpu,
        rows: &Rows,
        input: &Buffer<f32>,
        activations: &Activations,
        by_output: &Buffer<f32>,
        scratch: &mut [Buffer<f32>; 2],
        by_input: &mut Buffer<f32>,
        partials: &[Buffer<f32>],
    ) {
        let [above, below] = scratch;
        for (i, layer) in self.layers.iter().enumerate().rev() {
            let by_output = if i + 1 == self.layers.len() { by_output } else { &*above };
            let input = if i == 0 { input } else { &activations[i - 1] };
            let binds = [input.bind(), by_output.bind(), partials[i].bind(), rows.bind()];
            let groups = Size::Groups(layer.tiles() * u64::from(CHUNKS));
            let kernel = accumulate(layer.k, layer.n, CHUNKS, layer.matrices);
            gpu.dispatch(&kernel, &layer.with_overflows(&binds), &rows.counter, groups);
            let size = multiplying(rows, layer.n, layer.k, layer.matrices);
            let scale = Some(GRADIENT_SCALE);
            if i == 0 {
                rows.size(by_input, layer.k);
                let binds = [by_output.bind(), layer.backward.bind(), by_input.bind(), rows.bind()];
                let binds = layer.with_overflows(&binds);
                gpu.dispatch(&layer.product(Finish::Store, scale), &binds, &rows.counter, size);
            } else {
                rows.size(below, layer.k);
                let binds =
                    [by_output.bind(), layer.backward.bind(), below.bind(), input.bind(), rows.bind()];
                let binds = layer.with_overflows(&binds);
                gpu.dispatch(&layer.product(Finish::Mask, scale), &binds, &rows.counter, size);
                above.swap(below);
            }
        }
    }
}

/// The density and colour networks.
pub struct WgpuField {
    gpu: Arc<Gpu>,
    density: Mlp,
    color: Mlp,
    /// Width of the colour network's input: harmonics (if it uses directions), geometry features, zeros.
    width: usize,
    harmonics: usize,
    geometry: usize,
    overflows: Buffer<u32>,
    known: Arc<Known>,
}

/// Activations of a step.
pub struct Tape {
    density: Activations,
    color: Activations,
    color_input: Buffer<f32>,
    color_gradient: Buffer<f32>,
    input_gradient: Buffer<f32>,
    output_gradient: Buffer<f32>,
    scratch: [Buffer<f32>; 2],
}

impl Tape {
    /// Outputs of the density network.
    pub fn outputs(&self) -> &Buffer<f32> {
        &self.density[self.density.len() - 1]
    }
}

/// Weight gradients in chunks, for each layer of both networks.
pub struct FieldGradient {
    density: Vec<Buffer<f32>>,
    color: Vec<Buffer<f32>>,
}

impl WgpuField {
    /// Creates the networks of a configuration.
    pub fn new(gpu: &Arc<Gpu>, config: &Config, layout: &Layout, known: Arc<Known>) -> Self {
        let overflows = Buffer::zeros(gpu, 1);
        let matrices = if config.field.precision == Precision::F16 { gpu.matrices() } else { None };
        let network = |name| Mlp {
            layers: layout.network(name).map(|slot| Layer::new(gpu, slot, matrices, &overflows)).collect(),
        };
        let (width, harmonics) = (padded(color_layers(config)[0][0]), harmonics(config));
        let geometry = config.field.geometry as usize;
        let (density, color) = (network("density"), network("color"));
        Self { gpu: Arc::clone(gpu), density, color, width, harmonics, geometry, overflows, known }
    }

    /// Width of the density network's output: a logit, geometry features, zeros.
    pub fn outputs(&self) -> usize {
        padded(1 + self.geometry)
    }

    /// Number of geometry features.
    pub fn geometry(&self) -> usize {
        self.geometry
    }

    fn params(&self, rows: &Rows) -> FieldParams {
        FieldParams {
            counter: rows.counter,
            width: self.width as u32,
            harmonics: self.harmonics as u32,
            geometry: self.geometry as u32,
            outputs: self.outputs() as u32,
        }
    }

    /// As [`Field::keep`], but keeps no more of the tape than colours need; there is no way back.
    pub fn keep_outputs(
        &self,
        lane: &mut Lane,
        kept: &Buffer<u32>,
        tape: &mut Tape,
        radiance: &mut Buffer<Radiance>,
    ) {
        if let Some(outputs) = tape.density.last_mut() {
            lane.keep(kept, outputs, self.outputs());
        }
        lane.keep(kept, radiance, 4);
    }

    /// The counter of factors that f16 cannot hold.
    pub fn overflows(&self) -> &Buffer<u32> {
        &self.overflows
    }

    /// Switches to f32, once there was a factor that f16 cannot hold.
    fn fall_back(&mut self) {
        for layer in self.density.layers.iter_mut().chain(&mut self.color.layers) {
            *layer = Layer::new(&self.gpu, &layer.slot, None, &self.overflows);
        }
    }
}

impl Field<WgpuBackend> for WgpuField {
    type Tape = Tape;
    type Gradient = FieldGradient;

    fn tape(&self) -> Tape {
        let empty = || Buffer::zeros(&self.gpu, 0);
        let layers = |mlp: &Mlp| mlp.layers.iter().map(|_| empty()).collect();
        Tape {
            density: layers(&self.density),
            color: layers(&self.color),
            color_input: empty(),
            color_gradient: empty(),
            input_gradient: empty(),
            output_gradient: empty(),
            scratch: [empty(), empty()],
        }
    }

    fn gradient(&self) -> FieldGradient {
        let parts = |mlp: &Mlp| {
            let size = |layer: &Layer| layer.k * layer.n * CHUNKS as usize;
            mlp.layers.iter().map(|layer| Buffer::zeros(&self.gpu, size(layer))).collect()
        };
        FieldGradient { density: parts(&self.density), color: parts(&self.color) }
    }

    fn refresh(&mut self, parameters: &Buffer<f32>) {
        let halves = self.density.layers.iter().any(|layer| layer.matrices.is_some());
        if halves && self.known.overflows.load(Ordering::Relaxed) > 0 {
            self.fall_back();
        }
        for layer in self.density.layers.iter().chain(&self.color.layers) {
            let binds = [parameters.bind(), layer.forward.bind(), layer.backward.bind()];
            let kernel = if layer.matrices.is_some() { &PACK_HALF } else { &PACK };
            self.gpu.dispatch(kernel, &binds, &layer.params(), Size::Items((layer.k * layer.n) as u64));
        }
    }

    fn density(
        &self,
        lane: &mut Lane,
        samples: &Samples<WgpuBackend>,
        features: &Buffer<f32>,
        tape: &mut Tape,
        radiance: &mut Buffer<Radiance>,
    ) {
        let rows = Rows::of(&samples.spheres, &mut lane.count);
        self.density.forward(&self.gpu, &rows, features, &mut tape.density);
        rows.size(radiance, 1);
        let outputs = &tape.density[tape.density.len() - 1];
        let binds = [outputs.bind(), radiance.bind(), rows.bind()];
        self.gpu.dispatch(&DENSITIES, &binds, &self.params(&rows), rows.dispatch(1, GROUP));
    }

    fn keep(&self, lane: &mut Lane, kept: &Buffer<u32>, tape: &mut Tape, radiance: &mut Buffer<Radiance>) {
        for (layer, activations) in self.density.layers.iter().zip(&mut tape.density) {
            lane.keep(kept, activations, layer.n);
        }
        lane.keep(kept, radiance, 4);
    }

    fn color(
        &self,
        lane: &mut Lane,
        rays: &Rays<WgpuBackend>,
        samples: &Samples<WgpuBackend>,
        tape: &mut Tape,
        radiance: &mut Buffer<Radiance>,
    ) {
        let rows = Rows::of(&samples.spheres, &mut lane.count);
        let Tape { density, color, color_input, .. } = tape;
        rows.size(color_input, self.width);
        let outputs = &density[density.len() - 1];
        let binds = [outputs.bind(), rows.bind(), rays.rays.bind(), samples.rays.bind(), color_input.bind()];
        self.gpu.dispatch(&COLOR_INPUTS, &binds, &self.params(&rows), rows.dispatch(1, GROUP));
        self.color.forward(&self.gpu, &rows, color_input, color);
        let binds = [color[color.len() - 1].bind(), radiance.bind(), rows.bind()];
        self.gpu.dispatch(&COLORS, &binds, &self.params(&rows), rows.dispatch(1, GROUP));
    }

    fn backward(
        &self,
        lane: &mut Lane,
        samples: &Samples<WgpuBackend>,
        features: &Buffer<f32>,
        tape: &mut Tape,
        radiance: &Buffer<Radiance>,
        radiance_gradients: &Buffer<Radiance>,
        feature_gradients: &mut Buffer<f32>,
        gradient: &mut FieldGradient,
    ) {
        let rows = Rows::of(&samples.spheres, &mut lane.count);
        let Tape { density, color, color_input, color_gradient, input_gradient, output_gradient, scratch } =
            tape;
        rows.size(color_gradient, 16);
        let binds = [radiance.bind(), rows.bind(), color_gradient.bind(), radiance_gradients.bind()];
        self.gpu.dispatch(&COLOR_GRADIENTS, &binds, &self.params(&rows), rows.dispatch(1, GROUP));
        self.color.backward(
            &self.gpu,
            &rows,
            color_input,
            color,
            color_gradient,
            scratch,
            input_gradient,
            &gradient.color,
        );
        rows.size(output_gradient, self.outputs());
        let outputs = &density[density.len() - 1];
        let binds = [
            outputs.bind(),
            output_gradient.bind(),
            rows.bind(),
            input_gradient.bind(),
            radiance_gradients.bind(),
        ];
        self.gpu.dispatch(&DENSITY_GRADIENT, &binds, &self.params(&rows), rows.dispatch(1, GROUP));
        self.density.backward(
            &self.gpu,
            &rows,
            features,
            density,
            output_gradient,
            scratch,
            feature_gradients,
            &gradient.density,
        );
    }

    fn flush(&mut self, deposits: &mut [Deposit<WgpuBackend>], parameter_gradient: &mut Buffer<f32>) {
        // A step is one span and has one deposit; the next step overwrites its chunks.
        for deposit in deposits {
            let FieldGradient { density, color } = &deposit.field;
            let layers = self.density.layers.iter().chain(&self.color.layers);
            for (layer, partial) in layers.zip(density.iter().chain(color)) {
                let binds = [partial.bind(), parameter_gradient.bind()];
                let items = layer.slot.range.len() as u64;
                self.gpu.dispatch(&REDUCE, &binds, &layer.params(), Size::Items(items));
            }
        }
    }
}
