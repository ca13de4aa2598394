//! AdamW on the GPU: one dispatch per slot. If the loss weights of a step sum to 0, nothing changes.

use crate::gpu::Access::{Parameters, Read, Write};
use crate::gpu::Source::{self, Text};
use crate::gpu::{Bind, Buffer, GRID, Gpu, Kernel, Pipeline, Size};
use crate::workspace::WgpuBackend;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use trimip_core::engine::batch::Update;
use trimip_core::engine::policy::{OptimizerPolicy, SlotUpdate};
use trimip_core::{Config, Layout, Optimizer};

shared! {
    /// Parameters of an update.
    struct Params as Params {
        beta1: f32,
        beta2: f32,
        share1: f32,
        share2: f32,
        epsilon: f32,
        rate: f32,
        root_correction: f32,
        shrink: f32,
        /// First parameter and number of parameters, in units of four.
        start: u32,
        count: u32,
        /// Number of parameters in a group, a power of two up to 16. Groups without a gradient are skipped; 0 updates
        /// all parameters.
        group: u32,
        /// Value that is added to the gradient with the sign of the parameter.
        sparsity: f32,
    }
}

/// Returns the kernel that updates the parameters of a slot.
pub fn update() -> Kernel {
    Kernel::new(
        "update",
        &[GRID, Source::of::<Params>(), Text(include_str!("shaders/adamw.wgsl"))],
        &[(0, Write), (1, Read), (2, Parameters), (3, Write), (4, Write), (5, Read), (6, Write)],
    )
}

/// AdamW moments of all parameters.
pub struct WgpuOptimizer {
    gpu: Arc<Gpu>,
    update: Pipeline,
    policy: OptimizerPolicy,
    m: Buffer<f32>,
    v: Buffer<f32>,
    skipped: Buffer<u32>,
    /// Value of `skipped` when it was last read.
    counters: AtomicU64,
}

impl WgpuOptimizer {
    /// Creates an optimiser with zero moments; the buffers are minimal unless `training`. `skipped`, one number, counts
    /// the gradients, and terms of gradients, that are left out because of their size.
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
            update: gpu.pipeline(update()),
            policy: OptimizerPolicy::new(config, layout),
            m: Buffer::zeros(gpu, length),
            v: Buffer::zeros(gpu, length),
            skipped,
            counters: AtomicU64::new(0),
        }
    }
}

impl Optimizer<WgpuBackend> for WgpuOptimizer {
    fn policy(&self) -> &OptimizerPolicy {
        &self.policy
    }

    fn policy_mut(&mut self) -> &mut OptimizerPolicy {
        &mut self.policy
    }

    fn step(&mut self, update: &mut Update<'_, WgpuBackend>) {
        let Update { parameters, gradient, partials, learning_rate, step } = update;
        let Some(sums) = partials.iter().find_map(|partial| partial.sums.0.as_ref()) else { return };
        self.move_all(parameters, gradient, &sums.buffer, *learning_rate, *step);
    }

    fn moments(&self) -> [&Buffer<f32>; 2] {
        // The caller is about to wait for the moments anyway, so the count is read here.
        self.counters.store(self.skipped.read()[0].into(), Ordering::Relaxed);
        [&self.m, &self.v]
    }

    fn moments_mut(&mut self) -> [&mut Buffer<f32>; 2] {
        [&mut self.m, &mut self.v]
    }

    fn non_finite(&self) -> u64 {
        self.counters.load(Ordering::Relaxed)
    }
}

impl WgpuOptimizer {
    /// Updates all slots; the second value of `sums` is the sum of the loss weights.
    fn move_all(
        &mut self,
        parameters: &Buffer<f32>,
        gradient: &Buffer<f32>,
        sums: &wgpu::Buffer,
        learning_rate: f64,
        step: u64,
    ) {
        for SlotUpdate { range, rule, group } in self.policy.updates(learning_rate, step) {
            let count = (range.len() / 4) as u32;
            let params = Params {
                beta1: rule.beta1,
                beta2: rule.beta2,
                share1: rule.share1,
                share2: rule.share2,
                epsilon: rule.epsilon,
                rate: rule.rate,
                root_correction: rule.root_correction,
                shrink: rule.shrink,
                start: (range.start / 4) as u32,
                count,
                group: group.unwrap_or(0) as u32,
                sparsity: rule.sparsity,
            };
            let sums = Bind::whole(sums);
            let [m, v, skipped] = [self.m.bind(), self.v.bind(), self.skipped.bind()];
            let binds = [parameters.bind(), gradient.bind(), m, v, sums, skipped];
            self.gpu.dispatch(&self.update, &binds, &params, Size::Items(count.into()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::probe::gpu;
    use trimip_core::config::Untouched;
    use trimip_core::field::params::Slot;

    /// Returns the value and moments after step `step` at a learning rate of 1e-3, from Algorithm 2 of Loshchilov and
    /// Hutter as printed.
    fn printed(config: &Config, slot: &Slot, step: u64, [x, m, v]: [f64; 3], gradient: f64) -> [f64; 3] {
        let c = &config.optimizer;
        let m = c.beta1 * m + (1.0 - c.beta1) * gradient;
        let v = c.beta2 * v + (1.0 - c.beta2) * gradient * gradient;
        let m_hat = m / (1.0 - c.beta1.powf(step as f64));
        let v_hat = v / (1.0 - c.beta2.powf(step as f64));
        let rate = 1e-3 * slot.rate;
        let decay = rate * slot.decay * c.weight_decay * x;
        [x - rate * m_hat / (v_hat.sqrt() + c.epsilon) - decay, m, v]
    }

    #[test]
    fn slots_of_any_length_and_group_follow_the_printed_rule() {
        let Some(gpu) = gpu() else { return };
        let slot =
            |name: &str, length, group| Slot { group, rate: 10.0, ..Slot::new(name, vec![length], 1.0) };
        let layout = Layout::of([
            slot("weights", 15, None),
            slot("bias", 1, None),
            slot("pairs", 42, Some(2)),
            slot("singles", 19, Some(1)),
            slot("fours", 20, Some(4)),
            slot("texels", 48, Some(16)),
            slot("last", 7, None),
        ]);
        let mut config = Config::default();
        (config.optimizer.weight_decay, config.optimizer.untouched) = (0.1, Untouched::Skip);
        let mut optimizer = WgpuOptimizer::new(&gpu, &config, &layout, true, Buffer::zeros(&gpu, 1));
        let (mut parameters, mut sums) = (Buffer::zeros(&gpu, 0), Buffer::<f32>::zeros(&gpu, 0));
        let initial = layout.initial(&config);
        parameters.write(&initial);
        sums.write(&[0.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]);
        let mut exact: Vec<[f64; 3]> = initial.iter().map(|&x| [x.into(), 0.0, 0.0]).collect();
        for step in 1..=4 {
            let mut values = vec![0.0; layout.len()];
            for slot in &layout.slots {
                for i in slot.range.clone() {
                    // Every third group has no gradient in this step.
                    let group = (i - slot.range.start) / slot.group.unwrap_or(1);
                    let idle = (group as u64 + step).is_multiple_of(3);
                    values[i] = if idle { 0.0 } else { ((i as u64 * 37 + step * 11) % 17) as f32 - 7.5 };
                    if !(idle && slot.group.is_some()) {
                        exact[i] = printed(&config, slot, step, exact[i], f64::from(values[i]) / 4.0);
                    }
                }
            }
            let mut gradient = Buffer::zeros(&gpu, 0);
            gradient.write(&values);
            optimizer.move_all(&parameters, &gradient, sums.bind().buffer, 1e-3, step);
        }
        let found = [parameters.read(), optimizer.m.read(), optimizer.v.read()];
        gpu.check("AdamW").expect("the kernel compiles");
        for slot in &layout.slots {
            for i in slot.range.clone() {
                for (found, expected) in found.iter().map(|values| f64::from(values[i])).zip(exact[i]) {
                    let bound = 2e-6 * expected.abs().max(1.0);
                    assert!((found - expected).abs() <= bound, "{}[{i}]: {found}, not {expected}", slot.name);
                }
            }
            assert!(found[0][slot.range.end..slot.padded().end].iter().all(|&x| x == 0.0), "{}", slot.name);
        }
    }
}
