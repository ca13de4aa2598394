//! Tri-mip encoding on the GPU. The base planes lie at the front of the parameters; the mip levels above them are
//! stored in one derived array.

use super::scatter::{OWN_FIXED, OWN_FLOAT};
use super::{Encoding, FeatureGradients, Places, TEXELS, whole};
use crate::gpu::Access::{self, Parameters, Read, Write};
use crate::gpu::Source::{self, Parts, Text};
use crate::gpu::{Bind, Binds, Buffer, GRID, GROUP, Gpu, Kernel, Pipeline, Size};
use crate::workspace::Addition;
use std::sync::Arc;
use trimip_core::field::encoders::tri_mip::{CHANNELS, FEATURES, LEVELS_PER_UNIT, MOST_LEVEL_INPUT, Pyramid};
use trimip_core::{Aabb, Config, field::encoders};

shared! {
    /// Parameters of the kernels that read texels and add up gradients.
    struct Params as Pyramid {
        /// log2 of each plane's base radius.
        log2_base_radius: [f32; 3],
        levels: u32,
        /// Number of texels along x, y and z at level 0.
        sides: [u32; 3],
        /// Index of the counter that holds the number of rows: counts[counter].
        counter: u32,
        /// log2 of the sphere radius that corresponds to level 0, for the level input.
        reference: f32,
        /// 1 if the level of a sample is one of its features.
        level_input: u32,
        /// Number of floats in a row of features.
        stride: u32,
    }

    /// Parameters of a pass over a level.
    struct LevelParams as Params {
        /// Number of texels of the finer level along x, y and z.
        sides: [u32; 3],
        /// 1 if there is a coarser level.
        has_coarse: u32,
    }
}

const PLANES: Source = Parts(&[
    GRID,
    Source::whole("TEXEL_FOURS", CHANNELS as u32 / 4),
    Text(include_str!("shaders/planes.wgsl")),
]);

/// Shader source: computes the mip level of a sample's sphere, and the texels that the sample reads.
pub const TRI_MIP: Source = Parts(&[
    PLANES,
    TEXELS,
    Source::of::<Params>(),
    Source::whole("CHANNELS", CHANNELS as u32),
    Source::whole("FOURS", FOURS),
    Source::real("LEVELS_PER_UNIT", LEVELS_PER_UNIT as f32),
    Source::real("MOST_LEVEL_INPUT", MOST_LEVEL_INPUT as f32),
    Text(include_str!("shaders/tri_mip.wgsl")),
]);

/// Number of features that a sample reads from texels, in units of four.
const FOURS: u32 = FEATURES as u32 / 4;

/// Returns the kernel that computes the features of samples.
fn encode() -> Kernel {
    Kernel::new(
        "encode",
        &[TRI_MIP, Text(include_str!("shaders/encode.wgsl"))],
        &[(0, Read), (1, Read), (2, Parameters), (3, Read), (4, Write), (5, Read)],
    )
}

/// Returns the kernel that computes a mip level from the next finer level.
fn average() -> Kernel {
    Kernel::new(
        "average",
        &[PLANES, Source::of::<LevelParams>(), Text(include_str!("shaders/average.wgsl"))],
        &[(0, Write), (1, Write), (2, Parameters)],
    )
}

/// Returns the kernel that adds feature gradients to texel gradients.
fn scatter(addition: Addition) -> Kernel {
    let own: &[(u32, Access)] =
        if addition == Addition::Fixed { &[(6, Write), (7, Write), (8, Write)] } else { &[] };
    Kernel::new(
        "scatter",
        &[TRI_MIP, Text(include_str!("shaders/scatter.wgsl"))],
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (4, Write), (5, Read)],
    )
    .and(&[addition.source()], own)
}

/// Returns the kernel that adds the gradients of a coarse level to the next finer level.
fn pull(addition: Addition) -> Kernel {
    let kernel = Kernel::new(
        "pull",
        &[PLANES, Source::of::<LevelParams>(), Text(include_str!("shaders/pull.wgsl"))],
        &[(0, Write), (1, Write), (2, Parameters)],
    );
    match addition {
        Addition::Fixed => kernel.and(&[OWN_FIXED], &[(3, Write)]),
        Addition::Atomic | Addition::Exchange => kernel.and(&[OWN_FLOAT], &[]),
    }
}

/// The planes and their mip levels.
pub(crate) struct Planes {
    gpu: Arc<Gpu>,
    encode: Pipeline,
    average: Pipeline,
    scatter: Pipeline,
    pull: Pipeline,
    pyramid: Pyramid,
    /// The pyramid at full resolution; `pyramid` is the one at the current growth stage.
    whole: Pyramid,
    derived: Buffer<f32>,
    derived_gradient: Buffer<f32>,
    /// log2 of the sphere radius that corresponds to level 0; `None` unless the level of a sample is one of its
    /// features.
    reference: Option<f32>,
    /// Number of floats in a row of features.
    stride: usize,
    addition: Addition,
    /// High words of the fixed-point gradients of the planes and of the derived levels.
    high: [Buffer<f32>; 2],
    /// Counter of terms that do not fit into fixed point.
    skipped: wgpu::Buffer,
}

impl Planes {
    fn params(&self, counter: u32) -> Params {
        let Pyramid { sides, levels, log2_base_radius } = &self.pyramid;
        Params {
            log2_base_radius: log2_base_radius.map(|radius| radius as f32),
            levels: *levels as u32,
            sides: sides.map(|side| side as u32),
            counter,
            reference: self.reference.unwrap_or_default(),
            level_input: self.reference.is_some().into(),
            stride: self.stride as u32,
        }
    }

    /// Returns the parameters of a pass over `level`.
    fn level_params(&self, level: usize, has_coarse: bool) -> LevelParams {
        let sides = self.pyramid.sides.map(|side| (side >> level) as u32);
        LevelParams { sides, has_coarse: u32::from(has_coarse) }
    }

    /// Returns the number of invocations of a pass over `level`: one per four channels of a texel.
    fn items(&self, level: usize) -> Size<'static> {
        Size::Items((self.pyramid.texels(level) * CHANNELS / 4) as u64)
    }

    /// Binds `level` within the base array or the array of derived levels.
    fn level<'a>(&self, level: usize, base: &'a Buffer<f32>, derived: &'a Buffer<f32>) -> Bind<'a> {
        let count = self.pyramid.texels(level) * CHANNELS;
        match level {
            0 => base.part(0, count),
            _ => derived.part(self.pyramid.offset(level, 0), count),
        }
    }
}

impl Encoding for Planes {
    fn new(
        gpu: &Arc<Gpu>,
        config: &Config,
        training: bool,
        addition: Addition,
        skipped: &Buffer<u32>,
    ) -> Self {
        let pyramid = Pyramid::new(&config.encoder, &Aabb::new(&config.scene));
        // A binding holds at least one value, even if there is only the base level.
        let derived = pyramid.derived_len().max(CHANNELS);
        let (base, fixed) = (pyramid.base_len(), training && addition == Addition::Fixed);
        Self {
            gpu: Arc::clone(gpu),
            encode: gpu.pipeline(encode()),
            average: gpu.pipeline(average()),
            scatter: gpu.pipeline(scatter(addition)),
            pull: gpu.pipeline(pull(addition)),
            reference: config.encoder.level_input.then(|| pyramid.reference() as f32),
            stride: encoders::stride(config),
            whole: pyramid.clone(),
            pyramid,
            derived: Buffer::zeros(gpu, derived),
            derived_gradient: Buffer::zeros(gpu, if training { derived } else { CHANNELS }),
            addition,
            high: [base, derived].map(|length| Buffer::zeros(gpu, if fixed { length } else { CHANNELS })),
            skipped: skipped.raw().clone(),
        }
    }

    fn grow(&mut self, stage: u32) {
        self.pyramid = self.whole.halved(stage);
    }

    fn refresh(&mut self, parameters: &Buffer<f32>) {
        for level in 1..self.pyramid.levels {
            let binds = [
                self.level(level - 1, parameters, &self.derived),
                self.level(level, parameters, &self.derived),
            ];
            self.gpu.dispatch(&self.average, &binds, &self.level_params(level - 1, true), self.items(level));
        }
    }

    fn forward(&self, parameters: &Buffer<f32>, at: &Places, _: &Buffer<f32>, features: &Buffer<f32>) {
        let (planes, rows) = (parameters.part(0, self.pyramid.base_len()), &at.rows);
        let binds = [planes, self.derived.bind(), whole(&at.spheres), features.bind(), rows.bind()];
        let size = rows.dispatch(FOURS, GROUP);
        self.gpu.dispatch(&self.encode, &binds, &self.params(rows.counter), size);
    }

    fn reduce(
        &mut self,
        partials: impl Iterator<Item = FeatureGradients>,
        _: &Buffer<f32>,
        parameter_gradient: &Buffer<f32>,
    ) {
        let bytes = |count: usize| (count * size_of::<f32>()) as u64;
        self.gpu.clear(parameter_gradient.raw(), 0, bytes(self.pyramid.base_len()));
        for whole in [&self.derived_gradient, &self.high[0], &self.high[1]] {
            self.gpu.clear(whole.raw(), 0, bytes(whole.capacity()));
        }
        let fixed = self.addition == Addition::Fixed;
        for from in partials {
            let rows = &from.at.rows;
            let mut binds = Binds::new(whole(&from.gradients)).and([
                whole(&from.at.spheres),
                parameter_gradient.part(0, self.pyramid.base_len()),
                self.derived_gradient.bind(),
                rows.bind(),
            ]);
            if fixed {
                binds = binds.and(self.high.iter().map(Buffer::bind)).and([whole(&self.skipped)]);
            }
            let size = rows.dispatch(FOURS, GROUP);
            self.gpu.dispatch(&self.scatter, &binds, &self.params(rows.counter), size);
        }
        // Adds gradients from coarse to fine levels: each texel gets a quarter of its parent's gradient.
        for level in (0..self.pyramid.levels).rev() {
            let has_coarse = level + 1 < self.pyramid.levels;
            // If there is no coarser level, another buffer is bound in its place; the kernel does not read it.
            let coarse = match has_coarse {
                true => self.level(level + 1, parameter_gradient, &self.derived_gradient),
                false => self.derived.bind(),
            };
            let fine = self.level(level, parameter_gradient, &self.derived_gradient);
            let high = fixed.then(|| self.level(level, &self.high[0], &self.high[1]));
            let binds = Binds::new(fine).and([coarse]).and(high);
            let params = self.level_params(level, has_coarse);
            self.gpu.dispatch(&self.pull, &binds, &params, self.items(level));
        }
    }

    #[cfg(test)]
    fn kernels() -> Vec<Kernel> {
        let of = |addition| [scatter(addition), pull(addition)];
        super::scatter::ADDITIONS.into_iter().flat_map(of).chain([encode(), average()]).collect()
    }
}
