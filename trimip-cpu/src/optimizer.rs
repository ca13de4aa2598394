//! AdamW on the CPU: one pass over all parameters, in chunks that do not depend on the number of threads.

use crate::CpuBackend;
use crate::buffer::Buffer;
use crate::simd::{Kernel, Lanes, Simd};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};
use trimip_core::adamw::Rule;
use trimip_core::batch::Deposit;
use trimip_core::config::OptimizerConfig;
use trimip_core::params::{Kind, Slot};
use trimip_core::{Config, Layout, Optimizer};

/// Parameters of one task.
const CHUNK: usize = 1 << 15;

/// Moments of all parameters.
pub struct CpuOptimizer {
    simd: Simd,
    config: OptimizerConfig,
    slots: Vec<Slot>,
    m: Buffer<f32>,
    v: Buffer<f32>,
    non_finite: AtomicU64,
}

impl CpuOptimizer {
    /// Zero moments; none at all unless `training`.
    pub fn new(simd: Simd, config: &Config, layout: &Layout, training: bool) -> Self {
        let length = if training { layout.len() } else { 0 };
        Self {
            simd,
            config: config.optimizer.clone(),
            slots: layout.slots.clone(),
            m: Buffer::zeros(length),
            v: Buffer::zeros(length),
            non_finite: AtomicU64::new(0),
        }
    }
}

impl Optimizer<CpuBackend> for CpuOptimizer {
    fn step(
        &mut self,
        parameters: &mut Buffer<f32>,
        gradient: &Buffer<f32>,
        deposits: &[Deposit<CpuBackend>],
        learning_rate: f64,
        step: u64,
    ) {
        let weight: f64 = deposits.iter().map(|deposit| deposit.sums.weight).sum();
        let scale = (1.0 / weight) as f32;
        for slot in &self.slots {
            let factor = if slot.kind == Kind::Planes { self.config.plane_scale } else { 1.0 };
            let rule = Rule::new(&self.config, learning_rate * factor, step);
            let range = slot.range.clone();
            let chunks = parameters[range.clone()]
                .par_chunks_mut(CHUNK)
                .zip(self.m[range.clone()].par_chunks_mut(CHUNK))
                .zip(self.v[range.clone()].par_chunks_mut(CHUNK))
                .zip(gradient[range].par_chunks(CHUNK));
            chunks.for_each(|(((parameters, m), v), gradient)| {
                let skipped = self.simd.run(Update { rule, scale, parameters, m, v, gradient });
                if skipped > 0 {
                    self.non_finite.fetch_add(skipped, Ordering::Relaxed);
                }
            });
        }
    }

    fn moments(&self) -> [&Buffer<f32>; 2] {
        [&self.m, &self.v]
    }

    fn moments_mut(&mut self) -> [&mut Buffer<f32>; 2] {
        [&mut self.m, &mut self.v]
    }

    fn non_finite(&self) -> u64 {
        self.non_finite.load(Ordering::Relaxed)
    }
}

struct Update<'a> {
    rule: Rule<f32>,
    scale: f32,
    parameters: &'a mut [f32],
    m: &'a mut [f32],
    v: &'a mut [f32],
    gradient: &'a [f32],
}

impl Kernel for Update<'_> {
    /// Gradients that were not finite.
    type Output = u64;
    #[inline(always)]
    fn run<L: Lanes>(self) -> u64 {
        let Self { rule, scale, parameters, m, v, gradient } = self;
        // One pass that looks, so that the pass that writes has no branch and becomes vectors.
        let finite = gradient.iter().fold(0.0_f32, |sum, g| sum + g * 0.0) == 0.0;
        let moments = m.iter_mut().zip(v.iter_mut());
        let rows = parameters.iter_mut().zip(moments).zip(gradient);
        if finite {
            rows.for_each(|((parameter, (m, v)), gradient)| rule.apply(parameter, m, v, gradient * scale));
            return 0;
        }
        let mut skipped = 0;
        for ((parameter, (m, v)), gradient) in rows {
            if gradient.is_finite() {
                rule.apply(parameter, m, v, gradient * scale);
            } else {
                skipped += 1;
            }
        }
        skipped
    }
}
