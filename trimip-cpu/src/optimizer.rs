//! AdamW on the CPU: one pass over all parameters, in chunks that do not depend on the number of threads.

use crate::CpuBackend;
use crate::buffer::Buffer;
use crate::encoders::Piece;
use crate::simd::{Kernel, Lanes, Simd};
use rayon::prelude::*;
use std::sync::atomic::{AtomicU64, Ordering};
use trimip_core::engine::batch::Update;
use trimip_core::engine::policy::{OptimizerPolicy, SlotUpdate};
use trimip_core::field::adamw::Rule;
use trimip_core::field::params::ALIGNMENT;
use trimip_core::{Config, Layout, Optimizer};

/// Number of parameters per task.
const CHUNK: usize = 1 << 15;

/// AdamW moments of all parameters.
pub struct CpuOptimizer {
    simd: Simd,
    policy: OptimizerPolicy,
    m: Buffer<f32>,
    v: Buffer<f32>,
    non_finite: AtomicU64,
}

impl CpuOptimizer {
    /// Creates an optimiser with zero moments; the buffers are empty unless `training`.
    pub fn new(simd: Simd, config: &Config, layout: &Layout, training: bool) -> Self {
        let length = if training { layout.len() } else { 0 };
        Self {
            simd,
            policy: OptimizerPolicy::new(config, layout),
            m: Buffer::zeros(length),
            v: Buffer::zeros(length),
            non_finite: AtomicU64::new(0),
        }
    }
}

impl CpuOptimizer {
    /// Adds the number of non-finite gradients that another rank skipped.
    pub(crate) fn count_non_finite(&mut self, count: u64) {
        *self.non_finite.get_mut() += count;
    }

    /// Performs [`Optimizer::step`] for an encoder whose first slot has a gradient of zero outside of `touched`.
    /// Returns the number of non-finite gradients that were skipped in the first slot.
    pub(crate) fn step_within(
        &mut self,
        update: &mut Update<'_, CpuBackend>,
        touched: Option<Vec<Piece<'_>>>,
    ) -> u64 {
        let Update { parameters, gradient, partials, learning_rate, step } = update;
        let weight: f64 = partials.iter().map(|partial| partial.sums.sums.weight).sum();
        let scale = (1.0 / weight) as f32;
        let Self { simd, policy, m, v, non_finite } = self;
        let before = *non_finite.get_mut();
        let mut first = 0;
        for (index, SlotUpdate { range: whole, rule, group }) in
            policy.updates(*learning_rate, *step).enumerate()
        {
            // Updates the first slot row by row if the encoder reports the touched part of each row.
            let mut pieces = Vec::new();
            match touched.as_deref() {
                Some(rows) if index == 0 => {
                    let mut start = whole.start;
                    for piece in rows {
                        pieces.push((start..start + piece.length, piece.row, Some(&piece.within)));
                        start += piece.length;
                    }
                }
                _ => pieces.push((whole.clone(), CHUNK, None)),
            }
            for (range, chunk, rows) in pieces {
                let chunks = parameters[range.clone()]
                    .par_chunks_mut(chunk)
                    .zip(m[range.clone()].par_chunks_mut(chunk))
                    .zip(v[range.clone()].par_chunks_mut(chunk))
                    .zip(gradient[range].par_chunks(chunk));
                chunks.enumerate().with_min_len(4).for_each(|(i, (((parameters, m), v), gradient))| {
                    let within = rows.map_or(0..parameters.len(), |within| within(i));
                    let skipped = simd.run(Lines {
                        rule,
                        scale,
                        group,
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
            if index == 0 {
                first = *non_finite.get_mut() - before;
            }
        }
        first
    }
}

impl Optimizer<CpuBackend> for CpuOptimizer {
    fn policy(&self) -> &OptimizerPolicy {
        &self.policy
    }

    fn policy_mut(&mut self) -> &mut OptimizerPolicy {
        &mut self.policy
    }

    fn step(&mut self, update: &mut Update<'_, CpuBackend>) {
        self.step_within(update, None);
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

struct Lines<'a> {
    rule: Rule<f32>,
    scale: f32,
    /// Number of values in a group. Groups without a gradient are skipped; `None` skips nothing.
    group: Option<usize>,
    parameters: &'a mut [f32],
    m: &'a mut [f32],
    v: &'a mut [f32],
    gradient: &'a [f32],
}

impl Kernel for Lines<'_> {
    /// Number of gradients whose square overflows f32.
    type Output = u64;
    #[inline(always)]
    fn run<L: Lanes>(self) -> u64 {
        let Self { rule, scale, group, parameters, m, v, gradient } = self;
        // Slots are padded to whole lines, because the compiler vectorises loops over arrays of fixed length. A first
        // pass only checks for non-finite gradients, so that the pass that writes has no branch.
        let square = |g: f32| (g * scale) * (g * scale);
        let mut check = [0.0; ALIGNMENT];
        for gradient in gradient.as_chunks::<ALIGNMENT>().0 {
            (0..ALIGNMENT).for_each(|i| check[i] += square(gradient[i]) * 0.0);
        }
        let finite = check == [0.0; ALIGNMENT];
        let moments = m.as_chunks_mut::<ALIGNMENT>().0.iter_mut().zip(v.as_chunks_mut::<ALIGNMENT>().0);
        let lines = parameters.as_chunks_mut::<ALIGNMENT>().0.iter_mut().zip(moments);
        let mut skipped = 0;
        for ((parameters, (m, v)), gradient) in lines.zip(gradient.as_chunks::<ALIGNMENT>().0) {
            if group.is_some() && gradient.iter().all(|g| *g == 0.0) {
                continue;
            }
            let moved = moved(gradient, group);
            if finite {
                // To avoid a branch, every lane is computed, and groups without a gradient then keep their old values.
                let (mut new, mut new_m, mut new_v) = (*parameters, *m, *v);
                for i in 0..ALIGNMENT {
                    rule.apply(&mut new[i], &mut new_m[i], &mut new_v[i], gradient[i] * scale);
                }
                for i in 0..ALIGNMENT {
                    parameters[i] = if moved[i] { new[i] } else { parameters[i] };
                    m[i] = if moved[i] { new_m[i] } else { m[i] };
                    v[i] = if moved[i] { new_v[i] } else { v[i] };
                }
                continue;
            }
            for i in (0..ALIGNMENT).filter(|i| moved[*i]) {
                if square(gradient[i]).is_finite() {
                    rule.apply(&mut parameters[i], &mut m[i], &mut v[i], gradient[i] * scale);
                } else {
                    skipped += 1;
                }
            }
        }
        skipped
    }
}

/// Returns for each lane of a line whether its group has a gradient. A line consists of whole groups, or lies within
/// one group.
#[inline(always)]
fn moved(gradient: &[f32; ALIGNMENT], group: Option<usize>) -> [bool; ALIGNMENT] {
    let Some(group) = group.filter(|group| *group < ALIGNMENT) else { return [true; ALIGNMENT] };
    let mut any = gradient.map(|g| g != 0.0);
    for step in [1, 2, 4, 8] {
        if step < group {
            let before = any;
            for i in 0..ALIGNMENT {
                any[i] |= before[i ^ step];
            }
        }
    }
    any
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::Backend;
    use trimip_core::config::{FilePrecision, Untouched};
    use trimip_core::engine::batch::{PartialGradients, StepResult, StepSums};
    use trimip_core::field::params::Slot;

    /// Returns dense and sparse slots whose lengths are not multiples of a register's length, each with its own rate
    /// and decay.
    fn odd() -> Layout {
        let slot = |name: &str, shape: &[usize], rate, decay, group| Slot {
            rate,
            decay,
            group,
            precision: FilePrecision::F32,
            ..Slot::new(name, shape.to_vec(), 1.0)
        };
        Layout::of([
            slot("weights", &[3, 5], 1.0, 1.0, None),
            slot("bias", &[1], 2.0, 0.0, None),
            slot("pairs", &[21, 2], 10.0, 0.5, Some(2)),
            slot("singles", &[19], 3.0, 1.0, Some(1)),
            slot("texels", &[3, 16], 10.0, 1.0, Some(16)),
            slot("last", &[7], 1.0, 1.0, None),
        ])
    }

    /// Returns the value and moments after step `step` at a learning rate of 1e-2, from Algorithm 2 of Loshchilov and
    /// Hutter as printed.
    fn printed(config: &Config, slot: &Slot, step: u64, [x, m, v]: [f64; 3], gradient: f64) -> [f64; 3] {
        let c = &config.optimizer;
        let m = c.beta1 * m + (1.0 - c.beta1) * gradient;
        let v = c.beta2 * v + (1.0 - c.beta2) * gradient * gradient;
        let m_hat = m / (1.0 - c.beta1.powf(step as f64));
        let v_hat = v / (1.0 - c.beta2.powf(step as f64));
        let rate = 1e-2 * slot.rate;
        let decay = rate * slot.decay * c.weight_decay * x;
        [x - rate * m_hat / (v_hat.sqrt() + c.epsilon) - decay, m, v]
    }

    #[test]
    fn slots_of_any_length_and_group_follow_the_printed_rule() {
        let mut config = Config::default();
        (config.encoder.plane_size, config.encoder.levels, config.field.hidden) = (4, 1, 16);
        (config.optimizer.weight_decay, config.optimizer.untouched) = (0.1, Untouched::Skip);
        let layout = odd();
        for simd in Simd::available() {
            let backend = CpuBackend::new(2, simd).unwrap();
            let stages = backend.stages(&config, None).unwrap();
            let sums =
                StepResult { sums: StepSums { weight: 4.0, ..StepSums::default() }, ..StepResult::default() };
            let (field, encoder) = (
                trimip_core::Field::gradient(&stages.field),
                trimip_core::Encoder::gradient(&stages.encoder),
            );
            let mut partials = [PartialGradients { field, encoder, sums }];
            let mut optimizer = CpuOptimizer::new(simd, &config, &layout, true);
            let mut parameters = Buffer::zeros(layout.len());
            parameters.copy_from_slice(&layout.initial(&config));
            let mut exact: Vec<[f64; 3]> = parameters.iter().map(|&x| [x.into(), 0.0, 0.0]).collect();
            for step in 1..=4 {
                let mut gradient = Buffer::zeros(layout.len());
                for slot in &layout.slots {
                    for i in slot.range.clone() {
                        // Every third group has no gradient in this step.
                        let group = (i - slot.range.start) / slot.group.unwrap_or(1);
                        let idle = (group as u64 + step).is_multiple_of(3);
                        gradient[i] =
                            if idle { 0.0 } else { ((i as u64 * 37 + step * 11) % 17) as f32 - 7.5 };
                    }
                }
                optimizer.step(&mut Update {
                    parameters: &mut parameters,
                    gradient: &mut gradient,
                    partials: &mut partials,
                    learning_rate: 1e-2,
                    step,
                });
                for slot in &layout.slots {
                    for i in slot.range.clone() {
                        let group = (i - slot.range.start) / slot.group.unwrap_or(1);
                        if slot.group.is_some() && (group as u64 + step).is_multiple_of(3) {
                            continue;
                        }
                        exact[i] = printed(&config, slot, step, exact[i], f64::from(gradient[i]) / 4.0);
                    }
                }
                for slot in &layout.slots {
                    for i in slot.range.clone() {
                        let [x, m, v] = exact[i];
                        let found = [parameters[i], optimizer.m[i], optimizer.v[i]].map(f64::from);
                        for (found, expected) in found.into_iter().zip([x, m, v]) {
                            // Values are of order one; after cancellation the rounding error of the operands remains.
                            let bound = 1e-6 * expected.abs().max(1.0);
                            assert!((found - expected).abs() <= bound, "{simd:?} {}[{i}] {found}", slot.name);
                        }
                    }
                    let between = slot.range.end..slot.padded().end;
                    assert!(parameters[between].iter().all(|x| x.to_bits() == 0), "{simd:?} {}", slot.name);
                }
            }
        }
    }
}
