//! A network on the GPU, layer by layer, each layer a product of matrices. Widths are padded to multiples of 16 with zero
//! weights. Biases, and an input that joins again, are written before the product of a layer, which is added to them.

use crate::buffer::Buffer;
use crate::device::{Bind, GROUP, Gpu, Size};
use crate::kernel::{PACK, PACK_HALF, REDUCE, SPREAD_BIASES, SUM_ROWS};
use crate::products::{Finish, GRADIENT_SCALE, Matrices, accumulate, multiply, multiplying, tile};
use crate::rows::{BLOCK, Rows};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;
use trimip_core::Layout;
use trimip_core::networks::Network;

/// Number of chunks of a weight gradient, each over a run of samples; the chunks are added in order.
pub const CHUNKS: u32 = 64;

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
        (finish, mask): (Finish, Option<&Buffer<f32>>),
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
pub const DIRECT: usize = 16;

/// A ReLU network. Without layers its output is a copy of its input.
pub struct Mlp {
    layers: Vec<Layer>,
}

/// Activations of a network: hidden layers after their ReLU, then the output.
pub type Activations = Vec<Buffer<f32>>;

/// Chunks of the gradients of a network's parts, layer by layer.
pub type Partials = Vec<Vec<Buffer<f32>>>;

/// The arrays of a backward pass.
pub struct Flow<'a> {
    /// Gradient of the network's output.
    pub by_output: &'a Buffer<f32>,
    /// The gradients above and below a layer.
    pub scratch: &'a mut [Buffer<f32>; 2],
    /// Receives the gradient of its input.
    pub by_input: &'a mut Buffer<f32>,
    /// Receive the gradients of its weights.
    pub partials: &'a Partials,
}

impl Mlp {
    /// The network `shape` with the parameters `slots`.
    pub fn new(
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

    /// True without layers.
    pub fn is_empty(&self) -> bool {
        self.layers.is_empty()
    }

    /// True if the factors of products are f16.
    pub fn is_half(&self) -> bool {
        self.layers.iter().any(|layer| layer.weights.matrices.is_some())
    }

    /// Padded widths of the activations.
    pub fn widths(&self) -> impl Iterator<Item = usize> {
        let direct = self.is_empty().then_some(DIRECT);
        self.layers.iter().map(|layer| layer.weights.n).chain(direct)
    }

    /// Empty activations.
    pub fn activations(&self, gpu: &Arc<Gpu>) -> Activations {
        self.widths().map(|_| Buffer::zeros(gpu, 0)).collect()
    }

    /// Packs the weights for products.
    pub fn pack(&self, gpu: &Gpu, parameters: &Buffer<f32>) {
        self.layers.iter().flat_map(Layer::parts).for_each(|part| part.pack(gpu, parameters));
    }

    /// Adds the chunks of gradients and writes the sums to the gradient of the parameters.
    pub fn reduce(&self, gpu: &Gpu, partials: &Partials, parameter_gradient: &Buffer<f32>) {
        for (layer, partials) in self.layers.iter().zip(partials) {
            for (part, partial) in layer.parts().zip(partials) {
                part.reduce(gpu, partial, parameter_gradient);
            }
        }
    }

    /// Chunks of the gradients of all parts.
    pub fn partials(&self, gpu: &Arc<Gpu>) -> Partials {
        let chunks = |part: &Weights| Buffer::zeros(gpu, part.k * part.n * CHUNKS as usize);
        self.layers.iter().map(|layer| layer.parts().map(chunks).collect()).collect()
    }

    /// Runs rows through the network.
    pub fn forward(&self, gpu: &Gpu, rows: &Rows, first: &Buffer<f32>, activations: &mut Activations) {
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

    /// Computes the gradient of the input and of the weights from that of the output.
    pub fn backward(
        &self,
        gpu: &Gpu,
        rows: &Rows,
        first: &Buffer<f32>,
        activations: &Activations,
        flow: Flow<'_>,
    ) {
        let Flow { by_output, scratch: [above, below], by_input, partials } = flow;
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
                joined.pull(gpu, rows, by_output, by_input, (Finish::Store, None));
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
                layer.weights.pull(gpu, rows, by_output, by_input, (finish, None));
            } else {
                rows.size(below, layer.weights.k);
                layer.weights.pull(gpu, rows, by_output, below, (Finish::Mask, Some(input)));
                above.swap(below);
            }
        }
    }
}
