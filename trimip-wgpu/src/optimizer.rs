//! AdamW on the GPU: one dispatch for each slot. Where a step has no weight, nothing moves.

use crate::backend::WgpuBackend;
use crate::buffer::Buffer;
use crate::device::{Gpu, Size};
use crate::kernel::UPDATE;
use bytemuck::{Pod, Zeroable};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use trimip_core::adamw::Rule;
use trimip_core::batch::Deposit;
use trimip_core::config::{OptimizerConfig, Untouched};
use trimip_core::params::{Kind, Slot};
use trimip_core::{Config, Layout, Optimizer};

#[repr(C)]
#[derive(Clone, Copy, Pod, Zeroable)]
struct Params {
    beta1: f32,
    beta2: f32,
    share1: f32,
    share2: f32,
    epsilon: f32,
    rate: f32,
    root_correction: f32,
    shrink: f32,
    start: u32,
    count: u32,
    skip: u32,
}

/// Moments of all parameters.
pub struct WgpuOptimizer {
    gpu: Arc<Gpu>,
    config: OptimizerConfig,
    slots: Vec<Slot>,
    m: Buffer<f32>,
    v: Buffer<f32>,
    skipped: Buffer<u32>,
    /// What `skipped` held when it was last read.
    known: AtomicU64,
    halvings: u32,
}

impl WgpuOptimizer {
    /// Zero moments; none to speak of unless `training`. `skipped` counts what is left out for its size.
    pub fn new(
        gpu: &Arc<Gpu>,
        config: &Config,
        layout: &Layout,
        training: bool,
        skipped: Buffer<u32>,
    ) -> Self {
        let length = if training { layout.len() } else { 4 };
        Self {
            gpu: Arc::clone(gpu),
            config: config.optimizer.clone(),
            slots: layout.slots.clone(),
            m: Buffer::zeros(gpu, length),
            v: Buffer::zeros(gpu, length),
            skipped,
            known: AtomicU64::new(0),
            halvings: 0,
        }
    }
}

impl Optimizer<WgpuBackend> for WgpuOptimizer {
    fn step(
        &mut self,
        parameters: &mut Buffer<f32>,
        gradient: &Buffer<f32>,
        deposits: &[Deposit<WgpuBackend>],
        learning_rate: f64,
        step: u64,
    ) {
        let Some(sums) = deposits.iter().find_map(|deposit| deposit.sums.0.as_ref()) else { return };
        for slot in &self.slots {
            let planes = slot.kind == Kind::Planes;
            let rate = if planes { learning_rate * self.config.plane_scale } else { learning_rate };
            let rule = Rule::<f32>::new(&self.config, rate, step);
            let length = if planes { slot.range.len() >> (2 * self.halvings) } else { slot.range.len() };
            let count = (length / 4) as u32;
            let params = Params {
                beta1: rule.beta1,
                beta2: rule.beta2,
                share1: rule.share1,
                share2: rule.share2,
                epsilon: rule.epsilon,
                rate: rule.rate,
                root_correction: rule.root_correction,
                shrink: rule.shrink,
                start: (slot.range.start / 4) as u32,
                count,
                skip: u32::from(planes && self.config.untouched == Untouched::Skip),
            };
            let sums = crate::device::Bind { buffer: &sums.buffer, offset: 0, size: None };
            let binds =
                [parameters.bind(), gradient.bind(), self.m.bind(), self.v.bind(), sums, self.skipped.bind()];
            self.gpu.dispatch(&UPDATE, &binds, &params, Size::Items(count.into()));
        }
    }

    fn halve(&mut self, halvings: u32) {
        self.halvings = halvings;
    }

    fn moments(&self) -> [&Buffer<f32>; 2] {
        // Whoever takes the moments waits for them anyway: the count is renewed beside.
        self.known.store(self.skipped.read()[0].into(), Ordering::Relaxed);
        [&self.m, &self.v]
    }

    fn moments_mut(&mut self) -> [&mut Buffer<f32>; 2] {
        [&mut self.m, &mut self.v]
    }

    fn non_finite(&self) -> u64 {
        self.known.load(Ordering::Relaxed)
    }
}
