//! Density and colour networks on the GPU, layer by layer. The activations of a step stay on the device. Widths are
//! padded to multiples of 16 with zero weights. Biases, and an input that joins again, are written before the product of a
//! layer, which is added to them. Without networks the outputs are the features: a logit of density and those of colour.

use crate::backend::{Known, Lane, WgpuBackend};
use crate::buffer::Buffer;
use crate::device::{Bind, GROUP, Gpu, Size};
use crate::kernel::{
    COLOR_GRADIENTS, COLOR_INPUTS, COLORS, DENSITIES, DENSITY_GRADIENT, DIMMING, PACK, PACK_HALF, REDUCE,
    SPREAD_BIASES, SUM_ROWS,
};
use crate::products::{Finish, GRADIENT_SCALE, Matrices, accumulate, multiply, multiplying, tile};
use crate::rows::{BLOCK, Rows};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use trimip_core::batch::{Deposit, Radiance, Rays, Samples};
use trimip_core::config::{FieldConfig, Precision, ViewEncoding};
use trimip_core::networks::{self, Network, color_network, density_network, view_width};
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
    /// Number of values of the view, number of geometry features, and width of the density network's output.
    view: u32,
    geometry: u32,
    outputs: u32,
    /// 1 if the view is coordinates with sines and cosines, 0 if it is spherical harmonics.
    frequencies_of_view: u32,
    view_frequencies: u32,
    geometry_frequencies: u32,
    /// Function of the density, its shift and its factor.
    density: u32,
    shift: f32,
    scale: f32,
    /// 1 without networks.
    direct: u32,
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
    ones: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct BiasParams {
    counter: u32,
    width: u32,
    chunks: u32,
    stride: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct DimParams {
    count: u32,
    least: f32,
}

/// Padded width of a matrix on the device.
pub fn padded(width: usize) -> usize {
    width.next_multiple_of(16)
}

/// Weights of some inputs of a layer, or its biases as a matrix of one row.
struct Weights {
    /// Index of the first parameter, and the shape of the parameters.
    start: usize,
    shape: [usize; 2],
    /// Leading inputs whose sum is the first output; they have no parameters.
    ones: usize,
    k: usize,
    n: usize,
    /// The matrix and its transpose, in words of one f32 or two f16.
    forward: Buffer<u32>,
    backward: Buffer<u32>,
    matrices: Option<Matrices>,
    /// Number of factors that f16 cannot hold, over all layers.
    overflows: wgpu::Buffer,
}

impl Weights {
    fn new(
        gpu: &Arc<Gpu>,
        start: usize,
        shape: [usize; 2],
        ones: usize,
        matrices: Option<Matrices>,
        overflows: &Buffer<u32>,
    ) -> Self {
        let [k, n] = [shape[0] + ones, shape[1] + usize::from(ones > 0)].map(padded);
        let words = if matrices.is_some() { k * n / 2 } else { k * n };
        Self {
            start,
            shape,
            ones,
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
            start: self.start as u32,
            inputs: self.shape[0] as u32,
            outputs: self.shape[1] as u32,
            k: self.k as u32,
            n: self.n as u32,
            chunks: CHUNKS,
            scale: if self.matrices.is_some() { (GRADIENT_SCALE as f32).recip() } else { 1.0 },
            ones: self.ones as u32,
        }
    }

    fn pack(&self, gpu: &Gpu, parameters: &Buffer<f32>) {
        let binds = [parameters.bind(), self.forward.bind(), self.backward.bind()];
        let kernel = if self.matrices.is_some() { &PACK_HALF } else { &PACK };
        gpu.dispatch(kernel, &binds, &self.params(), Size::Items((self.k * self.n) as u64));
    }

    /// Adds the chunks of a gradient and writes the sums to the gradient of the parameters.
    fn reduce(&self, gpu: &Gpu, partial: &Buffer<f32>, parameter_gradient: &Buffer<f32>) {
        let binds = [partial.bind(), parameter_gradient.bind()];
        let items = self.shape.iter().product::<usize>() as u64;
        gpu.dispatch(&REDUCE, &binds, &self.params(), Size::Items(items));
    }

    /// The product of rows with the matrix.
    fn multiply(&self, gpu: &Gpu, rows: &Rows, input: &Buffer<f32>, out: &Buffer<f32>, finish: Finish) {
        let binds = self.with_overflows(&[input.bind(), self.forward.bind(), out.bind(), rows.bind()]);
        let size = multiplying(rows, self.k, self.n, self.matrices);
        gpu.dispatch(&multiply(self.k, self.n, finish, self.matrices, 1), &binds, &rows.counter, size);
    }

    /// The product of gradients with the transpose; `mask` belongs to [`Finish::Mask`].
    fn pull(
        &self,
        gpu: &Gpu,
        rows: &Rows,
        by_output: &Buffer<f32>,
        out: &Buffer<f32>,
        mask: Option<&Buffer<f32>>,
        finish: Finish,
    ) {
        let mut binds = vec![by_output.bind(), self.backward.bind(), out.bind()];
        binds.extend(mask.map(Buffer::bind));
        binds.push(rows.bind());
        let size = multiplying(rows, self.n, self.k, self.matrices);
        let kernel = multiply(self.n, self.k, finish, self.matrices, GRADIENT_SCALE);
        gpu.dispatch(&kernel, &self.with_overflows(&binds), &rows.counter, size);
    }

    /// Writes the chunks of the weights' gradient.
    fn accumulate(
        &self,
        gpu: &Gpu,
        rows: &Rows,
        input: &Buffer<f32>,
        by_output: &Buffer<f32>,
        partial: &Buffer<f32>,
    ) {
        let binds = [input.bind(), by_output.bind(), partial.bind(), rows.bind()];
        let groups = Size::Groups(self.tiles() * u64::from(CHUNKS));
        let kernel = accumulate(self.k, self.n, CHUNKS, self.matrices);
        gpu.dispatch(&kernel, &self.with_overflows(&binds), &rows.counter, groups);
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

/// The parameters of one layer.
struct Layer {
    weights: Weights,
    /// Weights of the network's input, where it joins again.
    joined: Option<Weights>,
    biases: Option<Weights>,
}

impl Layer {
    /// All parts, in the order of their gradients.
    fn parts(&self) -> impl Iterator<Item = &Weights> {
        [&self.weights].into_iter().chain(&self.joined).chain(&self.biases)
    }
}

/// Padded width of the outputs without networks.
const DIRECT: usize = 16;

/// A ReLU network. Without layers its output is a copy of its input.
struct Mlp {
    layers: Vec<Layer>,
}

/// Activations of a network: hidden layers after their ReLU, then the output.
type Activations = Vec<Buffer<f32>>;

/// Chunks of the gradients of a network's parts, layer by layer.
type Partials = Vec<Vec<Buffer<f32>>>;

impl Mlp {
    /// The network `shape` with the parameters `slots`.
    fn new(
        gpu: &Arc<Gpu>,
        shape: &Network,
        layout: &Layout,
        matrices: Option<Matrices>,
        overflows: &Buffer<u32>,
    ) -> Self {
        let mut slots = layout.network(shape.name).map(|slot| slot.range.start);
        let mut next = || slots.next().unwrap_or_default();
        let layers = (0..shape.layers.len()).map(|i| {
            let ([inputs, outputs], start) = (shape.weights(i), next());
            let own = if shape.joined == Some(i) { inputs - shape.inputs() } else { inputs };
            let weights = |start, inputs| {
                Weights::new(gpu, start, [inputs, outputs], shape.summed, matrices, overflows)
            };
            Layer {
                weights: weights(start, own),
                joined: (own < inputs).then(|| weights(start + own * outputs, inputs - own)),
                biases: shape.biases.then(|| weights(next(), 1)),
            }
        });
        Self { layers: layers.collect() }
    }

    /// Chunks of the gradients of all parts.
    fn partials(&self, gpu: &Arc<Gpu>) -> Partials {
        let chunks = |part: &Weights| Buffer::zeros(gpu, part.k * part.n * CHUNKS as usize);
        self.layers.iter().map(|layer| layer.parts().map(chunks).collect()).collect()
    }

    /// Runs rows through the network.
    fn forward(&self, gpu: &Gpu, rows: &Rows, first: &Buffer<f32>, activations: &mut Activations) {
        if self.layers.is_empty() {
            // The width of the features is that of the outputs.
            let out = &mut activations[0];
            rows.size(out, DIRECT);
            let bytes = (rows.capacity.next_multiple_of(BLOCK) * DIRECT * size_of::<f32>()) as u64;
            return gpu.copy(first.raw(), 0, out.raw(), 0, bytes);
        }
        for (i, layer) in self.layers.iter().enumerate() {
            let (before, after) = activations.split_at_mut(i);
            let input = before.last().unwrap_or(first);
            let out = &mut after[0];
            rows.size(out, layer.weights.n);
            if let Some(biases) = &layer.biases {
                let binds = [biases.forward.bind(), out.bind(), rows.bind()];
                let params =
                    BiasParams { counter: rows.counter, width: biases.n as u32, chunks: 0, stride: 0 };
                gpu.dispatch(&SPREAD_BIASES, &binds, &params, rows.dispatch(biases.n as u32, GROUP));
            }
            if let Some(joined) = &layer.joined {
                let finish = if layer.biases.is_some() { Finish::Add } else { Finish::Store };
                joined.multiply(gpu, rows, first, out, finish);
            }
            let last = i + 1 == self.layers.len();
            let finish = match (layer.biases.is_some() || layer.joined.is_some(), last) {
                (false, false) => Finish::Relu,
                (false, true) => Finish::Store,
                (true, false) => Finish::AddRelu,
                (true, true) => Finish::Add,
            };
            layer.weights.multiply(gpu, rows, input, out, finish);
        }
    }

    /// Computes the gradient of the input from that of the output; writes weight gradients to `partials`.
    #[allow(clippy::too_many_arguments)]
    fn backward(
        &self,
        gpu: &Gpu,
        rows: &Rows,
        first: &Buffer<f32>,
        activations: &Activations,
        by_output: &Buffer<f32>,
        scratch: &mut [Buffer<f32>; 2],
        by_input: &mut Buffer<f32>,
        partials: &Partials,
    ) {
        let [above, below] = scratch;
        let mut joins = false;
        for (i, layer) in self.layers.iter().enumerate().rev() {
            let by_output = if i + 1 == self.layers.len() { by_output } else { &*above };
            let input = if i == 0 { first } else { &activations[i - 1] };
            let mut partials = partials[i].iter();
            let mut partial = || partials.next().unwrap_or_else(|| unreachable!("one for each part"));
            layer.weights.accumulate(gpu, rows, input, by_output, partial());
            if let Some(joined) = &layer.joined {
                joined.accumulate(gpu, rows, first, by_output, partial());
                rows.size(by_input, joined.k);
                joined.pull(gpu, rows, by_output, by_input, None, Finish::Store);
                joins = true;
            }
            if let Some(biases) = &layer.biases {
                let stride = (biases.k * biases.n) as u32;
                let params =
                    BiasParams { counter: rows.counter, width: biases.n as u32, chunks: CHUNKS, stride };
                let binds = [by_output.bind(), partial().bind(), rows.bind()];
                let items = u64::from(CHUNKS) * biases.n as u64;
                gpu.dispatch(&SUM_ROWS, &binds, &params, Size::Items(items));
            }
            if i == 0 {
                rows.size(by_input, layer.weights.k);
                let finish = if joins { Finish::Add } else { Finish::Store };
                layer.weights.pull(gpu, rows, by_output, by_input, None, finish);
            } else {
                rows.size(below, layer.weights.k);
                layer.weights.pull(gpu, rows, by_output, below, Some(input), Finish::Mask);
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
    /// True if there are no networks.
    direct: bool,
    /// Number of geometry features.
    geometry: usize,
    /// Width of the colour network's input: the view, the geometry features with their sines and cosines, zeros.
    width: usize,
    /// Number of values of the view.
    view: usize,
    config: FieldConfig,
    networks: [Network; 2],
    layout: Layout,
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

/// Weight gradients in chunks.
pub struct FieldGradient {
    density: Partials,
    color: Partials,
}

impl WgpuField {
    /// Creates the networks of a configuration.
    pub fn new(gpu: &Arc<Gpu>, config: &Config, layout: &Layout, known: Arc<Known>) -> Self {
        let overflows = Buffer::zeros(gpu, 1);
        let matrices = if config.field.precision == Precision::F16 { gpu.matrices() } else { None };
        let networks = [density_network(config), color_network(config)];
        let [density, color] =
            networks.each_ref().map(|network| Mlp::new(gpu, network, layout, matrices, &overflows));
        Self {
            gpu: Arc::clone(gpu),
            direct: density.layers.is_empty(),
            geometry: networks::geometry(config),
            width: if density.layers.is_empty() { DIRECT } else { padded(networks[1].inputs()) },
            view: view_width(config),
            density,
            color,
            config: config.field.clone(),
            networks,
            layout: layout.clone(),
            overflows,
            known,
        }
    }

    /// Width of the density network's output: a logit, geometry features, zeros.
    pub fn outputs(&self) -> usize {
        padded(1 + self.geometry())
    }

    /// Number of geometry features.
    pub fn geometry(&self) -> usize {
        self.geometry
    }

    fn layers(&self) -> impl Iterator<Item = &Layer> {
        self.density.layers.iter().chain(&self.color.layers)
    }

    fn params(&self, rows: &Rows) -> FieldParams {
        let field = &self.config;
        FieldParams {
            counter: rows.counter,
            width: self.width as u32,
            view: self.view as u32,
            geometry: self.geometry as u32,
            outputs: self.outputs() as u32,
            frequencies_of_view: u32::from(field.view == ViewEncoding::Frequencies),
            view_frequencies: field.view_frequencies,
            geometry_frequencies: if self.direct { 0 } else { field.geometry_frequencies },
            density: field.density as u32,
            shift: field.density_shift,
            scale: field.density_scale,
            direct: u32::from(self.direct),
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
        let [density, color] = self
            .networks
            .each_ref()
            .map(|network| Mlp::new(&self.gpu, network, &self.layout, None, &self.overflows));
        (self.density, self.color) = (density, color);
    }
}

impl Field<WgpuBackend> for WgpuField {
    type Tape = Tape;
    type Gradient = FieldGradient;

    fn tape(&self) -> Tape {
        let empty = || Buffer::zeros(&self.gpu, 0);
        let layers = |mlp: &Mlp| (0..mlp.layers.len().max(1)).map(|_| empty()).collect();
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
        FieldGradient { density: self.density.partials(&self.gpu), color: self.color.partials(&self.gpu) }
    }

    fn refresh(&mut self, parameters: &Buffer<f32>) {
        let halves = self.density.layers.iter().any(|layer| layer.weights.matrices.is_some());
        if halves && self.known.overflows.load(Ordering::Relaxed) > 0 {
            self.fall_back();
        }
        for part in self.layers().flat_map(Layer::parts) {
            part.pack(&self.gpu, parameters);
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
        let widths = self.density.layers.iter().map(|layer| layer.weights.n);
        let widths = widths.chain(self.direct.then_some(DIRECT));
        for (width, activations) in widths.zip(&mut tape.density) {
            lane.keep(kept, activations, width);
        }
        lane.keep(kept, radiance, 4);
    }

    fn color(
        &self,
        lane: &mut Lane,
        rays: &Rays<WgpuBackend>,
        samples: &Samples<WgpuBackend>,
        least: f32,
        tape: &mut Tape,
        radiance: &mut Buffer<Radiance>,
    ) {
        let rows = Rows::of(&samples.spheres, &mut lane.count);
        let Tape { density, color, color_input, .. } = tape;
        let outputs = &density[density.len() - 1];
        let logits = if self.direct {
            outputs
        } else {
            rows.size(color_input, self.width);
            let binds =
                [outputs.bind(), rows.bind(), rays.rays.bind(), samples.rays.bind(), color_input.bind()];
            self.gpu.dispatch(&COLOR_INPUTS, &binds, &self.params(&rows), rows.dispatch(1, GROUP));
            self.color.forward(&self.gpu, &rows, color_input, color);
            &color[color.len() - 1]
        };
        let binds = [logits.bind(), radiance.bind(), rows.bind()];
        self.gpu.dispatch(&COLORS, &binds, &self.params(&rows), rows.dispatch(1, GROUP));
        if least > 0.0 {
            // A colour of 0 has no gradient: its derivative by the logit is 0.
            let count = samples.segments.known_len().unwrap_or(0);
            let binds = [samples.segments.bind(), radiance.bind(), samples.intervals.bind()];
            let params = DimParams { count: count as u32, least };
            self.gpu.dispatch(&DIMMING, &binds, &params, Size::Items(count as u64));
        }
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
        if !self.direct {
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
        }
        let by_geometry = if self.direct { color_gradient } else { input_gradient };
        let by_output = if self.direct { &mut *feature_gradients } else { &mut *output_gradient };
        rows.size(by_output, self.outputs());
        let outputs = &density[density.len() - 1];
        let binds =
            [outputs.bind(), by_output.bind(), rows.bind(), by_geometry.bind(), radiance_gradients.bind()];
        self.gpu.dispatch(&DENSITY_GRADIENT, &binds, &self.params(&rows), rows.dispatch(1, GROUP));
        if self.direct {
            return;
        }
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
            for (layer, partials) in self.layers().zip(density.iter().chain(color)) {
                for (part, partial) in layer.parts().zip(partials) {
                    part.reduce(&self.gpu, partial, parameter_gradient);
                }
            }
        }
    }
}
