//! AdamW on the CPU: one pass over all parameters, in chunks that do not depend on the number of threads.

use crate::CpuBackend;
use crate::buffer::{Buffer, take};
use crate::extents::Touched;
use crate::simd::{Kernel, Lanes, Simd};
use rayon::prelude::*;
use std::ops::Range;
use std::sync::atomic::{AtomicU64, Ordering};
use trimip_core::adamw::Rule;
use trimip_core::batch::Deposit;
use trimip_core::config::{OptimizerConfig, Untouched};
use trimip_core::params::{Kind, Slot};
use trimip_core::tri_mip::CHANNELS;
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
    halvings: u32,
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
            halvings: 0,
        }
    }
}

impl CpuOptimizer {
    /// True when texels without a gradient stay as they are.
    pub(crate) fn skips_untouched(&self) -> bool {
        self.config.untouched == Untouched::Skip
    }

    /// As [`Optimizer::step`], for planes whose gradient is zero outside of `touched`.
    pub(crate) fn step_within(
        &mut self,
        parameters: &mut Buffer<f32>,
        gradient: &Buffer<f32>,
        deposits: &[Deposit<CpuBackend>],
        learning_rate: f64,
        step: u64,
        touched: Option<Touched<'_>>,
    ) {
        let weight: f64 = deposits.iter().map(|deposit| deposit.sums.weight).sum();
        let scale = (1.0 / weight) as f32;
        let Self { simd, config, slots, m, v, non_finite, halvings } = self;
        for slot in slots.iter() {
            let planes = slot.kind == Kind::Planes;
            let rate = if planes { learning_rate * config.plane_scale } else { learning_rate };
            let rule = Rule::new(config, rate, step);
            let skip = planes && config.untouched == Untouched::Skip;
            let mut whole = slot.range.clone();
            if planes {
                whole.end = whole.start + (whole.len() >> (2 * *halvings));
            }
            // Plane by plane and row by row where rows say what they touched.
            let pieces = match touched {
                Some(Touched { shapes, mut rows }) if planes => {
                    let mut start = whole.start;
                    Vec::from(shapes.map(|shape| {
                        let range = start..start + shape.rows * shape.row();
                        start = range.end;
                        (range, shape.row(), Some(take(&mut rows, shape.rows)))
                    }))
                }
                _ => vec![(whole, CHUNK, None)],
            };
            for (range, chunk, rows) in pieces {
                let chunks = parameters[range.clone()]
                    .par_chunks_mut(chunk)
                    .zip(m[range.clone()].par_chunks_mut(chunk))
                    .zip(v[range.clone()].par_chunks_mut(chunk))
                    .zip(gradient[range].par_chunks(chunk));
                chunks.enumerate().with_min_len(4).for_each(|(i, (((parameters, m), v), gradient))| {
                    let within = rows.map_or(0..parameters.len(), |rows| {
                        let Range { start, end } = rows[i].texels();
                        start * CHANNELS..end * CHANNELS
                    });
                    let skipped = simd.run(Update {
                        rule,
                        scale,
                        skip,
                        parameters: &mut parameters[within.clone()],
                        m: &mut m[within.clone()],
                        v: &mut v[within.clone()],
                        gradient: &gradient[within],
                    });
                    if skipped > 0 {
                        non_finite.fetch_add(skipped, Ordering::Relaxed);
                    }
                });
            }
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
        self.step_within(parameters, gradient, deposits, learning_rate, step, None);
    }

    fn halve(&mut self, halvings: u32) {
        self.halvings = halvings;
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
    /// Leave texels without any gradient as they are.
    skip: bool,
    parameters: &'a mut [f32],
    m: &'a mut [f32],
    v: &'a mut [f32],
    gradient: &'a [f32],
}

impl Kernel for Update<'_> {
    /// Gradients whose square is beyond f32.
    type Output = u64;
    #[inline(always)]
    fn run<L: Lanes>(self) -> u64 {
        let Self { rule, scale, skip, parameters, m, v, gradient } = self;
        // One pass that looks, so that the pass that writes has no branch and becomes vectors.
        let square = |g: f32| (g * scale) * (g * scale);
        let finite = gradient.iter().fold(0.0_f32, |sum, &g| sum + square(g) * 0.0) == 0.0;
        // Every slot holds a multiple of 16 values; arrays of known length become vectors.
        let moments = m.as_chunks_mut::<CHANNELS>().0.iter_mut().zip(v.as_chunks_mut::<CHANNELS>().0);
        let texels = parameters.as_chunks_mut::<CHANNELS>().0.iter_mut().zip(moments);
        let mut skipped = 0;
        for ((parameters, (m, v)), gradient) in texels.zip(gradient.as_chunks::<CHANNELS>().0) {
            if skip && gradient.iter().all(|g| *g == 0.0) {
                continue;
            }
            for i in 0..CHANNELS {
                if finite || square(gradient[i]).is_finite() {
                    rule.apply(&mut parameters[i], &mut m[i], &mut v[i], gradient[i] * scale);
                } else {
                    skipped += 1;
                }
            }
        }
        skipped
    }
}
