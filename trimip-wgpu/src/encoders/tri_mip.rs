//! Tri-mip encoding on the GPU. The planes are at the front of the parameters; the levels above them are one derived
//! array.

use super::{Encoding, Left, Places, TEXELS, whole};
use crate::buffer::Buffer;
use crate::device::{Bind, GROUP, Gpu, Size};
use crate::kernel::Access::{self, Parameters, Read, Write};
use crate::kernel::{
    ADD_ATOMIC, ADD_EXCHANGE, ADD_FIXED, Addition, FIXED, GRID, Kernel, OWN_FIXED, OWN_FLOAT,
};
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;
use trimip_core::encoders::tri_mip::{CHANNELS, FEATURES, Pyramid};
use trimip_core::{Aabb, Config, encoders};

const PLANES: &str = include_str!("shaders/planes.wgsl");
const TRI_MIP: &str = include_str!("shaders/tri_mip.wgsl");
const SCATTER: &str = include_str!("shaders/scatter.wgsl");
const SCATTER_FIXED: &[&str] = &[GRID, PLANES, TEXELS, TRI_MIP, FIXED, ADD_FIXED, SCATTER];
const SCATTER_ATOMIC: &[&str] = &[GRID, PLANES, TEXELS, TRI_MIP, ADD_ATOMIC, SCATTER];
const SCATTER_EXCHANGE: &[&str] = &[GRID, PLANES, TEXELS, TRI_MIP, ADD_EXCHANGE, SCATTER];
const PULL: &str = include_str!("shaders/pull.wgsl");
const PULL_FIXED: &[&str] = &[GRID, PLANES, FIXED, OWN_FIXED, PULL];
const PULL_FLOAT: &[&str] = &[GRID, PLANES, OWN_FLOAT, PULL];

/// Computes the features of samples.
static ENCODE: Kernel = Kernel::new(
    "encode",
    &[GRID, PLANES, TEXELS, TRI_MIP, include_str!("shaders/encode.wgsl")],
    &[(0, Read), (1, Read), (2, Parameters), (3, Read), (4, Write), (5, Read)],
);

/// Computes a level from the next finer one.
static AVERAGE: Kernel = Kernel::new(
    "average",
    &[GRID, PLANES, include_str!("shaders/average.wgsl")],
    &[(0, Write), (1, Write), (2, Parameters)],
);

/// The kernel that scatters feature gradients to texel gradients.
fn scatter(addition: Addition) -> Kernel {
    const FLOATS: &[(u32, Access)] =
        &[(0, Read), (1, Read), (2, Parameters), (3, Write), (4, Write), (5, Read)];
    const WORDS: &[(u32, Access)] = &[
        (0, Read),
        (1, Read),
        (2, Parameters),
        (3, Write),
        (4, Write),
        (5, Read),
        (6, Write),
        (7, Write),
        (8, Write),
    ];
    match addition {
        Addition::Fixed => Kernel::new("scatter", SCATTER_FIXED, WORDS),
        Addition::Atomic => Kernel::new("scatter", SCATTER_ATOMIC, FLOATS),
        Addition::Exchange => Kernel::new("scatter", SCATTER_EXCHANGE, FLOATS),
    }
}

/// The kernel that pulls gradients from a coarse level to the next finer one.
fn pull(addition: Addition) -> Kernel {
    match addition {
        Addition::Fixed => {
            Kernel::new("pull", PULL_FIXED, &[(0, Write), (1, Write), (2, Parameters), (3, Write)])
        }
        Addition::Atomic | Addition::Exchange => {
            Kernel::new("pull", PULL_FLOAT, &[(0, Write), (1, Write), (2, Parameters)])
        }
    }
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    log2_base_radius: [f32; 3],
    levels: u32,
    sides: [u32; 3],
    counter: u32,
    reference: f32,
    level_input: u32,
    stride: u32,
    unused: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct LevelParams {
    sides: [u32; 3],
    has_coarse: u32,
}

/// The planes and their mip levels.
pub(crate) struct Planes {
    gpu: Arc<Gpu>,
    pyramid: Pyramid,
    /// The pyramid of the planes in full size.
    whole: Pyramid,
    derived: Buffer<f32>,
    derived_gradient: Buffer<f32>,
    /// log2 of the radius of level 0, if the level of a sample is one of its features.
    reference: Option<f32>,
    /// Floats in a row of features.
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
            unused: 0,
        }
    }

    /// Parameters of a pass over `level`.
    fn level_params(&self, level: usize, has_coarse: bool) -> LevelParams {
        let sides = self.pyramid.sides.map(|side| (side >> level) as u32);
        LevelParams { sides, has_coarse: u32::from(has_coarse) }
    }

    /// Invocations of a pass over `level`: one per four channels of a texel.
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
            self.gpu.dispatch(&AVERAGE, &binds, &self.level_params(level - 1, true), self.items(level));
        }
    }

    fn forward(&self, parameters: &Buffer<f32>, at: &Places, _: &Buffer<f32>, features: &Buffer<f32>) {
        let (planes, rows) = (parameters.part(0, self.pyramid.base_len()), &at.rows);
        let binds = [planes, self.derived.bind(), whole(&at.spheres), features.bind(), rows.bind()];
        let size = rows.dispatch(FEATURES as u32 / 4, GROUP);
        self.gpu.dispatch(&ENCODE, &binds, &self.params(rows.counter), size);
    }

    fn flush(
        &mut self,
        deposits: impl Iterator<Item = Left>,
        _: &Buffer<f32>,
        parameter_gradient: &Buffer<f32>,
    ) {
        let bytes = |count: usize| (count * size_of::<f32>()) as u64;
        self.gpu.clear(parameter_gradient.raw(), 0, bytes(self.pyramid.base_len()));
        for whole in [&self.derived_gradient, &self.high[0], &self.high[1]] {
            self.gpu.clear(whole.raw(), 0, bytes(whole.capacity()));
        }
        let fixed = self.addition == Addition::Fixed;
        for left in deposits {
            let rows = &left.at.rows;
            let mut binds = vec![
                whole(&left.gradients),
                whole(&left.at.spheres),
                parameter_gradient.part(0, self.pyramid.base_len()),
                self.derived_gradient.bind(),
                rows.bind(),
            ];
            if fixed {
                binds.extend(self.high.iter().map(Buffer::bind));
                binds.push(whole(&self.skipped));
            }
            let size = rows.dispatch(FEATURES as u32 / 4, GROUP);
            self.gpu.dispatch(&scatter(self.addition), &binds, &self.params(rows.counter), size);
        }
        // Pull from coarse to fine: each texel gets a quarter of its parent's gradient.
        for level in (0..self.pyramid.levels).rev() {
            let has_coarse = level + 1 < self.pyramid.levels;
            // Without a coarser level, another buffer is bound in its place and not read.
            let coarse = match has_coarse {
                true => self.level(level + 1, parameter_gradient, &self.derived_gradient),
                false => self.derived.bind(),
            };
            let mut binds = vec![self.level(level, parameter_gradient, &self.derived_gradient), coarse];
            if fixed {
                binds.push(self.level(level, &self.high[0], &self.high[1]));
            }
            let params = self.level_params(level, has_coarse);
            self.gpu.dispatch(&pull(self.addition), &binds, &params, self.items(level));
        }
    }

    #[cfg(test)]
    fn kernels() -> Vec<Kernel> {
        let additions = [Addition::Fixed, Addition::Atomic, Addition::Exchange];
        let of = |addition| [scatter(addition), pull(addition)];
        additions.into_iter().flat_map(of).chain([ENCODE.clone(), AVERAGE.clone()]).collect()
    }
}
