//! Tri-mip encoding on the GPU: planes are the front of the parameters, the levels above them one derived array.

use crate::backend::{Lane, WgpuBackend};
use crate::buffer::Buffer;
use crate::device::{Bind, GROUP, Gpu, Size};
use crate::kernel::{AVERAGE, Addition, ENCODING, pull, scatter};
use crate::rows::Rows;
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;
use trimip_core::batch::{Deposit, Samples};
use trimip_core::tri_mip::{CHANNELS, FEATURES, Pyramid};
use trimip_core::{Aabb, Config, Encoder};

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    log2_base_radius: [f32; 3],
    levels: u32,
    sides: [u32; 3],
    counter: u32,
}

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct LevelParams {
    sides: [u32; 3],
    has_coarse: u32,
}

/// Planes and their mip levels.
pub struct WgpuEncoder {
    gpu: Arc<Gpu>,
    pyramid: Pyramid,
    /// The pyramid of planes of full size.
    whole: Pyramid,
    derived: Buffer<f32>,
    derived_gradient: Buffer<f32>,
    addition: Addition,
    /// High words of the planes' and the levels' gradient in fixed point.
    high: [Buffer<f32>; 2],
    /// Counts the terms that fixed point cannot hold.
    skipped: wgpu::Buffer,
}

/// Feature gradients of a step and where they belong: the workspace's own arrays, which nothing overwrites before the
/// step is over.
#[derive(Default)]
pub struct EncoderGradient(Option<Left>);

struct Left {
    gradients: wgpu::Buffer,
    spheres: wgpu::Buffer,
    rows: Rows,
}

impl WgpuEncoder {
    /// The planes of a configuration; `skipped` counts the terms of gradients that are left out.
    pub fn new(
        gpu: &Arc<Gpu>,
        config: &Config,
        training: bool,
        addition: Addition,
        skipped: &Buffer<u32>,
    ) -> Self {
        let pyramid = Pyramid::new(&config.encoder, &Aabb::new(&config.scene));
        // A binding has at least one value, also where there is a base level alone.
        let derived = pyramid.derived_len().max(CHANNELS);
        let (base, fixed) = (pyramid.base_len(), training && addition == Addition::Fixed);
        Self {
            gpu: Arc::clone(gpu),
            whole: pyramid.clone(),
            pyramid,
            derived: Buffer::zeros(gpu, derived),
            derived_gradient: Buffer::zeros(gpu, if training { derived } else { CHANNELS }),
            addition,
            high: [base, derived].map(|length| Buffer::zeros(gpu, if fixed { length } else { CHANNELS })),
            skipped: skipped.raw().clone(),
        }
    }

    fn params(&self, counter: u32) -> Params {
        let Pyramid { sides, levels, log2_base_radius } = &self.pyramid;
        Params {
            log2_base_radius: log2_base_radius.map(|radius| radius as f32),
            levels: *levels as u32,
            sides: sides.map(|side| side as u32),
            counter,
        }
    }

    /// What a pass over `level` needs to know.
    fn level_params(&self, level: usize, has_coarse: bool) -> LevelParams {
        let sides = self.pyramid.sides.map(|side| (side >> level) as u32);
        LevelParams { sides, has_coarse: u32::from(has_coarse) }
    }

    /// Invocations of a pass over `level`: one has four channels of a texel.
    fn items(&self, level: usize) -> Size<'static> {
        Size::Items((self.pyramid.texels(level) * CHANNELS / 4) as u64)
    }

    /// A level of an array of levels above the base, or of the base array.
    fn level<'a>(&self, level: usize, base: &'a Buffer<f32>, derived: &'a Buffer<f32>) -> Bind<'a> {
        let count = self.pyramid.texels(level) * CHANNELS;
        match level {
            0 => base.part(0, count),
            _ => derived.part(self.pyramid.offset(level, 0), count),
        }
    }
}

impl Encoder<WgpuBackend> for WgpuEncoder {
    type Gradient = EncoderGradient;

    fn gradient(&self) -> EncoderGradient {
        EncoderGradient::default()
    }

    fn halve(&mut self, halvings: u32) {
        self.pyramid = self.whole.halved(halvings);
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

    fn forward(
        &self,
        lane: &mut Lane,
        parameters: &Buffer<f32>,
        samples: &Samples<WgpuBackend>,
        features: &mut Buffer<f32>,
    ) {
        let rows = Rows::of(&samples.spheres, &mut lane.count);
        rows.size(features, FEATURES);
        let planes = parameters.part(0, self.pyramid.base_len());
        let binds = [planes, self.derived.bind(), samples.spheres.bind(), features.bind(), rows.bind()];
        let size = rows.dispatch(FEATURES as u32 / 4, GROUP);
        self.gpu.dispatch(&ENCODING, &binds, &self.params(rows.counter), size);
    }

    fn keep(&self, lane: &mut Lane, kept: &Buffer<u32>, features: &mut Buffer<f32>) {
        lane.keep(kept, features, FEATURES);
    }

    fn backward(
        &self,
        lane: &mut Lane,
        samples: &Samples<WgpuBackend>,
        feature_gradients: &Buffer<f32>,
        gradient: &mut EncoderGradient,
    ) {
        gradient.0 = Some(Left {
            gradients: feature_gradients.raw().clone(),
            spheres: samples.spheres.raw().clone(),
            rows: Rows::of(&samples.spheres, &mut lane.count),
        });
    }

    fn flush(&mut self, deposits: &mut [Deposit<WgpuBackend>], parameter_gradient: &mut Buffer<f32>) {
        let bytes = |count: usize| (count * size_of::<f32>()) as u64;
        self.gpu.clear(parameter_gradient.raw(), 0, bytes(self.pyramid.base_len()));
        for whole in [&self.derived_gradient, &self.high[0], &self.high[1]] {
            self.gpu.clear(whole.raw(), 0, bytes(whole.capacity()));
        }
        let fixed = self.addition == Addition::Fixed;
        for deposit in deposits {
            let Some(Left { gradients, spheres, rows }) = deposit.encoder.0.take() else { continue };
            let whole = |buffer| Bind { buffer, offset: 0, size: None };
            let mut binds = vec![
                whole(&gradients),
                whole(&spheres),
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
        // Pull from coarse to fine: each texel of a level carries a quarter of its parent's gradient.
        for level in (0..self.pyramid.levels).rev() {
            let has_coarse = level + 1 < self.pyramid.levels;
            // Where there is no coarser level, something else stands in its place and is not read.
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
}
