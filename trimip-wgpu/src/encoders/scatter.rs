//! Adds up the gradients of an encoder's parameters. Every sample adds to a few parameters, in one of three ways.

use super::{FeatureGradients, whole};
use crate::gpu::Access::{self, Parameters, Write};
use crate::gpu::Source::{self, Parts, Text};
use crate::gpu::{Bind, Binds, Buffer, GRID, Gpu, Kernel, Pipeline, Shared, Size};
use crate::shaders::FIXED;
use crate::workspace::Addition;
use std::sync::Arc;
use trimip_core::field::params::ALIGNMENT;

/// Shader source: reads gradients in fixed point.
pub const OWN_FIXED: Source = Parts(&[FIXED, Text(include_str!("../shaders/own_fixed.wgsl"))]);
/// Shader source: reads gradients in f32.
pub const OWN_FLOAT: Source = Text(include_str!("../shaders/own_float.wgsl"));

/// All ways of adding, for validation.
#[cfg(test)]
pub const ADDITIONS: [Addition; 3] = [Addition::Fixed, Addition::Atomic, Addition::Exchange];

impl Addition {
    /// Returns the source of the functions `add_base` and `add_derived`.
    pub fn source(self) -> Source {
        match self {
            Self::Fixed => Parts(&[FIXED, Text(include_str!("../shaders/add_fixed.wgsl"))]),
            Self::Atomic => Text(include_str!("../shaders/add_atomic.wgsl")),
            Self::Exchange => Text(include_str!("../shaders/add_exchange.wgsl")),
        }
    }

    /// Returns a kernel that calls only `add_base`.
    pub fn kernel(self, entry: &'static str, sources: &[Source], bindings: &[(u32, Access)]) -> Kernel {
        let own: &[(u32, Access)] = if self == Self::Fixed { &[(6, Write), (8, Write)] } else { &[] };
        Kernel::new(entry, sources, bindings).and(&[self.source()], own)
    }
}

shared! {
    /// Parameters of the conversion from fixed point.
    struct Conversion as Conversion {
        /// Number of groups of four floats.
        count: u32,
    }
}

/// Returns the kernel that converts gradients from fixed point to f32.
pub fn to_float() -> Kernel {
    let text = Text(include_str!("shaders/fixed_to_float.wgsl"));
    let sources = [GRID, OWN_FIXED, Source::of::<Conversion>(), text];
    Kernel::new("fixed_to_float", &sources, &[(0, Write), (2, Parameters), (3, Write)])
}

/// The sums of the gradients of one array of parameters.
pub struct Scatter {
    gpu: Arc<Gpu>,
    add: Pipeline,
    to_float: Option<Pipeline>,
    /// Number of floats.
    length: usize,
    /// High words of the sums in fixed point.
    high: Buffer<f32>,
    /// Counter of terms that do not fit into fixed point.
    skipped: wgpu::Buffer,
}

impl Scatter {
    /// Creates sums of `length` floats, to which the kernel `add` adds; the buffers are minimal unless `training`.
    pub fn new(
        gpu: &Arc<Gpu>,
        add: Kernel,
        addition: Addition,
        training: bool,
        length: usize,
        skipped: &Buffer<u32>,
    ) -> Self {
        let fixed = addition == Addition::Fixed;
        Self {
            gpu: Arc::clone(gpu),
            add: gpu.pipeline(add),
            to_float: fixed.then(|| gpu.pipeline(to_float())),
            length,
            high: Buffer::zeros(gpu, if training && fixed { length } else { ALIGNMENT }),
            skipped: skipped.raw().clone(),
        }
    }

    /// Returns the number of floats.
    pub fn length(&self) -> usize {
        self.length
    }

    /// Sets the sums to zero: the first [`length`](Self::length) floats of `sums`, and the high words.
    pub fn clear(&self, sums: &Buffer<f32>) {
        let bytes = |count: usize| (count * size_of::<f32>()) as u64;
        self.gpu.clear(sums.raw(), 0, bytes(self.length));
        self.gpu.clear(self.high.raw(), 0, bytes(self.high.capacity()));
    }

    /// Adds the gradients of a tile's features. `places` is the array from which the kernel reads where each sample
    /// lies; `rest` are the kernel's bindings after those of the sums.
    pub fn add<P: Shared>(
        &self,
        from: &FeatureGradients,
        places: &wgpu::Buffer,
        sums: &Buffer<f32>,
        rest: &[Bind<'_>],
        (params, size): (&P, Size<'_>),
    ) {
        let binds = Binds::new(whole(&from.gradients));
        let binds = binds.and([whole(places), sums.part(0, self.length), from.at.rows.bind()]);
        let fixed = self.to_float.as_ref().map(|_| [self.high.bind(), whole(&self.skipped)]);
        let binds = binds.and(fixed.into_iter().flatten()).and(rest.iter().copied());
        self.gpu.dispatch(&self.add, &binds, params, size);
    }

    /// Converts sums in fixed point to f32, in place: the first [`length`](Self::length) floats of `sums`. Leaves other
    /// sums unchanged.
    pub fn to_float(&self, sums: &Buffer<f32>) {
        if let Some(to_float) = &self.to_float {
            let count = self.length as u32 / 4;
            let binds = [sums.part(0, self.length), self.high.part(0, self.length)];
            self.gpu.dispatch(to_float, &binds, &Conversion { count }, Size::Items(count.into()));
        }
    }
}
