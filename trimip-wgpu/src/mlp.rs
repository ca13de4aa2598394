//! A network on the GPU: each layer is a product of matrices. Widths are padded to multiples of 16 with zero weights. If
//! a layer has biases, or a skip connection from the network's input, the biases and the product of the skip connection
//! are written first. The product of the layer is then added to them.

use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Text};
use crate::gpu::{BLOCK, Bind, Binds, Buffer, GRID, GROUP, Gpu, Kernel, Matrices, Pipeline, Rows, Size};
use crate::products::{Counter, Finish, GRADIENT_SCALE, accumulate, multiply, multiplying, padded, tile};
use crate::shaders::HALF;
use std::sync::Arc;
use trimip_core::Layout;
use trimip_core::field::networks::Network;

/// Number of chunks of a weight gradient. Each chunk sums a run of samples, and the chunks are added in order.
pub const CHUNKS: u32 = 64;

shared! {
    /// Parameters of the conversion between parameters and padded matrices.
    struct WeightParams as Params {
        /// Index of the layer's first float in the parameters.
        start: u32,
        inputs: u32,
        outputs: u32,
        /// Padded shape.
        k: u32,
        n: u32,
        chunks: u32,
        /// Factor by which the sum of the chunks is multiplied.
        scale: f32,
        /// Number of leading inputs whose sum is the first output. Neither these inputs nor that output have weights.
        ones: u32,
    }

    /// Parameters of the kernels of biases.
    struct BiasParams as Params {
        counter: u32,
        width: u32,
        chunks: u32,
        /// Distance between the sums of two chunks, in floats.
        stride: u32,
    }
}

const WEIGHTS: [Source; 3] = [GRID, Source::of::<WeightParams>(), Text(include_str!("shaders/weights.wgsl"))];
const WEIGHT_FLOAT: Source = Text(include_str!("shaders/weight_float.wgsl"));
const WEIGHT_HALF: Source = Text(include_str!("shaders/weight_half.wgsl"));
const BIASES: [Source; 3] = [GRID, Source::of::<BiasParams>(), Text(include_str!("shaders/biases.wgsl"))];

kernels! {
    /// The kernels of a network, except its products.
    pub struct Kernels {
        /// Writes a layer's matrix and its transpose, in f32 or in f16.
        pack: Kernel::new("pack", &WEIGHTS, &[(0, Read), (1, Write), (2, Parameters), (3, Write)])
            .and(&[WEIGHT_FLOAT], &[]),
        pack_half: Kernel::new("pack", &WEIGHTS, &[(0, Read), (1, Write), (2, Parameters), (3, Write)])
            .and(&[HALF, WEIGHT_HALF], &[])
            .cooperative(),
        /// Adds up the chunks of a weight gradient.
        reduce: Kernel::new("reduce", &WEIGHTS, &[(0, Read), (1, Write), (2, Parameters)])
            .and(&[WEIGHT_FLOAT], &[]),
        /// Writes the biases to every row.
        spread: Kernel::new("spread", &BIASES, &[(0, Read), (2, Parameters), (3, Write), (5, Read)]),
        /// Adds up the rows of a gradient in chunks.
        sum_rows: Kernel::new("sum_rows", &BIASES, &[(0, Read), (2, Parameters), (3, Write), (5, Read)]),
    }
}

/// The products of a layer with its weights.
struct Products {
    /// Products with the matrix, and products with its transpose, one for each [`Finish`].
    forward: [Pipeline; FINISHES.len()],
    backward: [Pipeline; FINISHES.len()],
    accumulate: Pipeline,
}

/// All ways to finish a product, in order.
const FINISHES: [Finish; 5] = [Finish::Store, Finish::Relu, Finish::Mask, Finish::Add, Finish::AddRelu];

impl Products {
    fn new(gpu: &Gpu, k: usize, n: usize, matrices: Option<Matrices>) -> Self {
        Self {
            forward: FINISHES.map(|finish| gpu.pipeline(multiply(k, n, finish, matrices, 1))),
            backward: FINISHES.map(|finish| gpu.pipeline(multiply(n, k, finish, matrices, GRADIENT_SCALE))),
            accumulate: gpu.pipeline(accumulate(k, n, CHUNKS, matrices)),
        }
    }
}

/// Weights of some of a layer's inputs, or the layer's biases as a matrix of one row.
struct Weights {
    /// Index of the first parameter, and the shape of the parameters.
    start: usize,
    shape: [usize; 2],
    /// Number of leading inputs that have fixed weights of one instead of parameters: their sum is the first output.
    ones: usize,
    k: usize,
    n: usize,
    /// The matrix and its transpose, in words of one f32 or two f16.
    forward: Buffer<u32>,
    backward: Buffer<u32>,
    matrices: Option<Matrices>,
    products: Products,
    kernels: Arc<Kernels>,
    /// Number of factors that f16 cannot hold, over all layers.
    overflows: wgpu::Buffer,
}

impl Weights {
    /// Creates weights of the shape `shape`, whose parameters begin at index `start`.
    fn new(of: &Common<'_>, start: usize, shape: [usize; 2], ones: usize) -> Self {
        let &Common { gpu, kernels, matrices, overflows } = of;
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
            products: Products::new(gpu, k, n, matrices),
            kernels: Arc::clone(kernels),
            overflows: overflows.raw().clone(),
        }
    }

    /// Returns the binding of the overflow counter, if the layer uses cooperative matrices.
    fn overflows(&self) -> Option<Bind<'_>> {
        self.matrices.map(|_| Bind::whole(&self.overflows))
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
        let Kernels { pack, pack_half, .. } = &*self.kernels;
        let kernel = if self.matrices.is_some() { pack_half } else { pack };
        gpu.dispatch(kernel, &binds, &self.params(), Size::Items((self.k * self.n) as u64));
    }

    /// Adds up the chunks of a gradient and writes the sums to the gradient of the parameters.
    fn reduce(&self, gpu: &Gpu, partial: &Buffer<f32>, parameter_gradient: &Buffer<f32>) {
        let binds = [partial.bind(), parameter_gradient.bind()];
        let items = self.shape.iter().product::<usize>() as u64;
        gpu.dispatch(&self.kernels.reduce, &binds, &self.params(), Size::Items(items));
    }

    /// Computes the product of rows with the matrix.
    fn multiply(&self, gpu: &Gpu, rows: &Rows, input: &Buffer<f32>, out: &Buffer<f32>, finish: Finish) {
        let binds = Binds::new(input.bind()).and([self.forward.bind(), out.bind(), rows.bind()]);
        let size = multiplying(rows, self.k, self.n, self.matrices);
        let product = &self.products.forward[finish as usize];
        gpu.dispatch(product, &binds.and(self.overflows()), &Counter { counter: rows.counter }, size);
    }

    /// Computes the product of gradients with the transpose; `mask` is the mask of [`Finish::Mask`].
    fn pull(
        &self,
        gpu: &Gpu,
        rows: &Rows,
        by_output: &Buffer<f32>,
        out: &Buffer<f32>,
        (finish, mask): (Finish, Option<&Buffer<f32>>),
    ) {
        let binds = Binds::new(by_output.bind()).and([self.backward.bind(), out.bind()]);
        let binds = binds.and(mask.map(Buffer::bind)).and([rows.bind()]).and(self.overflows());
        let size = multiplying(rows, self.n, self.k, self.matrices);
        let product = &self.products.backward[finish as usize];
        gpu.dispatch(product, &binds, &Counter { counter: rows.counter }, size);
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
        let binds = Binds::new(input.bind()).and([by_output.bind(), partial.bind(), rows.bind()]);
        let groups = Size::Groups(self.tiles() * u64::from(CHUNKS));
        let params = Counter { counter: rows.counter };
        gpu.dispatch(&self.products.accumulate, &binds.and(self.overflows()), &params, groups);
    }

    /// Returns the number of workgroups per chunk of the weight gradient.
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
    /// Weights of the network's input, if this layer has a skip connection from it.
    joined: Option<Weights>,
    biases: Option<Weights>,
}

impl Layer {
    /// Iterates over all parts, in the order of their gradients.
    fn parts(&self) -> impl Iterator<Item = &Weights> {
        [&self.weights].into_iter().chain(&self.joined).chain(&self.biases)
    }
}

/// Padded width of the colour logits, and of the outputs of a field without networks.
pub const DIRECT: usize = 16;

/// The values that all layers of a network share.
struct Common<'a> {
    gpu: &'a Arc<Gpu>,
    kernels: &'a Arc<Kernels>,
    matrices: Option<Matrices>,
    overflows: &'a Buffer<u32>,
}

/// A ReLU network. A network without layers copies its input.
pub struct Mlp {
    layers: Vec<Layer>,
    kernels: Arc<Kernels>,
}

/// Activations of a network, each [rows, width] with padded widths: hidden layers after their ReLU, then the output.
pub type Activations = Vec<Buffer<f32>>;

/// Chunks of the gradients of a network's parts, layer by layer: [[`CHUNKS`], inputs, outputs] for each part, with
/// padded widths.
pub type Partials = Vec<Vec<Buffer<f32>>>;

/// The arrays of a backward pass.
pub struct Flow<'a> {
    /// Gradient of the network's output.
    pub by_output: &'a Buffer<f32>,
    /// Gradients of a layer's outputs and of its inputs.
    pub scratch: &'a mut [Buffer<f32>; 2],
    /// Receives the gradient of the network's input.
    pub by_input: &'a mut Buffer<f32>,
    /// Receive the gradients of the network's weights.
    pub partials: &'a Partials,
}

impl Mlp {
    /// Creates the network `shape`; `layout` determines where its parameters lie. `overflows`, one number, counts the
    /// factors that f16 cannot hold.
    pub fn new(
        gpu: &Arc<Gpu>,
        shape: &Network,
        layout: &Layout,
        matrices: Option<Matrices>,
        overflows: &Buffer<u32>,
    ) -> Self {
        let kernels = Arc::new(Kernels::new(gpu));
        let of = Common { gpu, kernels: &kernels, matrices, overflows };
        let mut slots = layout.network(shape.name).map(|slot| slot.range.start);
        let mut next = || slots.next().unwrap_or_default();
        let layers = (0..shape.layers.len()).map(|i| {
            let ([inputs, outputs], start) = (shape.weights(i), next());
            let own = if shape.joined == Some(i) { inputs - shape.inputs() } else { inputs };
            let weights = |start, inputs| Weights::new(&of, start, [inputs, outputs], shape.summed);
            Layer {
                weights: weights(start, own),
                joined: (own < inputs).then(|| weights(start + own * outputs, inputs - own)),
                biases: shape.biases.then(|| weights(next(), 1)),
            }
        });
        Self { layers: layers.collect(), kernels }
    }

    /// Returns true if the network has no layers.
    pub fn is_empty(&self) -> bool {
        self.layers.is_empty()
    }

    /// Returns true if the factors of products are f16.
    pub fn is_half(&self) -> bool {
        self.layers.iter().any(|layer| layer.weights.matrices.is_some())
    }

    /// Returns the padded widths of the activations.
    pub fn widths(&self) -> impl Iterator<Item = usize> {
        let direct = self.is_empty().then_some(DIRECT);
        self.layers.iter().map(|layer| layer.weights.n).chain(direct)
    }

    /// Creates empty activations.
    pub fn activations(&self, gpu: &Arc<Gpu>) -> Activations {
        self.widths().map(|_| Buffer::zeros(gpu, 0)).collect()
    }

    /// Packs the weights for products. `parameters` is flat, in the order of the layout.
    pub fn pack(&self, gpu: &Gpu, parameters: &Buffer<f32>) {
        self.layers.iter().flat_map(Layer::parts).for_each(|part| part.pack(gpu, parameters));
    }

    /// Adds up the chunks of gradients and writes the sums to the gradient of the parameters, which is flat, in the
    /// order of the layout.
    pub fn reduce(&self, gpu: &Gpu, partials: &Partials, parameter_gradient: &Buffer<f32>) {
        for (layer, partials) in self.layers.iter().zip(partials) {
            for (part, partial) in layer.parts().zip(partials) {
                part.reduce(gpu, partial, parameter_gradient);
            }
        }
    }

    /// Creates the chunks of the gradients of all parts.
    pub fn partials(&self, gpu: &Arc<Gpu>) -> Partials {
        let chunks = |part: &Weights| Buffer::zeros(gpu, part.k * part.n * CHUNKS as usize);
        self.layers.iter().map(|layer| layer.parts().map(chunks).collect()).collect()
    }

    /// Runs rows through the network. `first` is its input, [rows, inputs] with a padded width.
    pub fn forward(&self, gpu: &Gpu, rows: &Rows, first: &Buffer<f32>, activations: &mut Activations) {
        if self.layers.is_empty() {
            // Features and outputs have the same width.
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
                gpu.dispatch(&self.kernels.spread, &binds, &params, rows.dispatch(biases.n as u32, GROUP));
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

    /// Computes the gradients of the input and of the weights from the gradient of the output.
    ///
    /// Shapes, with padded widths:
    /// - `first`: [rows, inputs], the input of [`forward`](Self::forward)
    /// - `activations`: [rows, outputs] of each layer, from [`forward`](Self::forward)
    /// - `flow`: `by_output` is [rows, outputs], and `by_input` becomes [rows, inputs]
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
                gpu.dispatch(&self.kernels.sum_rows, &binds, &params, Size::Items(items));
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
