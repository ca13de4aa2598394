//! The policy of the optimiser: which part of each slot a step updates, by which rule, and which groups it skips.

use crate::{
    Config, Layout,
    config::{OptimizerConfig, Untouched},
    field::{
        adamw::Rule,
        params::{ALIGNMENT, ActiveRange, Slot},
    },
};
use std::ops::Range;

/// Settings, slots, and the active part of each slot.
#[derive(Clone, Debug)]
pub struct OptimizerPolicy {
    settings: OptimizerConfig,
    slots: Vec<Slot>,
    /// One part per slot; its end is rounded up to the alignment.
    parts: Vec<ActiveRange>,
}

/// The update of one slot in one step.
#[derive(Clone, Debug, PartialEq)]
pub struct SlotUpdate {
    /// Range of the updated parameters; its end is rounded up to the alignment.
    pub range: Range<usize>,
    /// The rule of the update.
    pub rule: Rule<f32>,
    /// Number of values in a group; groups without a gradient are skipped. `None` if nothing is skipped.
    pub group: Option<usize>,
}

impl OptimizerPolicy {
    /// Creates the policy of a configuration, which updates the whole slots of `layout`.
    pub fn new(config: &Config, layout: &Layout) -> Self {
        Self {
            settings: config.optimizer.clone(),
            slots: layout.slots.clone(),
            parts: layout.slots.iter().map(ActiveRange::whole).collect(),
        }
    }

    /// Restricts updates to these parts of the slots, one per slot.
    pub fn restrict(&mut self, parts: &[ActiveRange]) {
        self.parts = parts.to_vec();
        for part in &mut self.parts {
            part.range.end = part.range.end.next_multiple_of(ALIGNMENT);
        }
    }

    /// Returns true if groups of values without a gradient are not updated.
    pub fn skips_untouched(&self) -> bool {
        self.settings.untouched == Untouched::Skip
    }

    /// Returns the update of each slot at step `step` (counted from 1) at the networks' learning rate.
    pub fn updates(&self, learning_rate: f64, step: u64) -> impl Iterator<Item = SlotUpdate> {
        self.slots.iter().zip(&self.parts).map(move |(slot, part)| SlotUpdate {
            range: part.range.clone(),
            rule: Rule {
                sparsity: part.sparsity as f32,
                ..Rule::of(&self.settings, slot, learning_rate, step)
            },
            group: slot.group.filter(|_| self.skips_untouched()),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_restricted_slot_is_updated_in_its_part_alone() {
        let slot = |name: &str, length, group| Slot { group, ..Slot::new(name, vec![length], 1.0) };
        let layout = Layout::of([slot("texels", 100, Some(4)), slot("weights", 20, None)]);
        let mut config = Config::default();
        config.optimizer.untouched = Untouched::Skip;
        let mut policy = OptimizerPolicy::new(&config, &layout);
        let ranges =
            |policy: &OptimizerPolicy| policy.updates(1e-3, 1).map(|update| update.range).collect::<Vec<_>>();
        assert_eq!(ranges(&policy), [0..112, 112..144]);
        let whole = ActiveRange::whole(&layout.slots[1]);
        policy.restrict(&[ActiveRange { range: 0..20, sparsity: 0.5 }, whole]);
        assert_eq!(ranges(&policy), [0..32, 112..144], "up to the next alignment");
        let found: Vec<_> =
            policy.updates(1e-3, 1).map(|update| (update.rule.sparsity, update.group)).collect();
        assert_eq!(found, [(0.5, Some(4)), (0.0, None)]);
        config.optimizer.untouched = Untouched::Decay;
        let policy = OptimizerPolicy::new(&config, &layout);
        assert!(policy.updates(1e-3, 1).all(|update| update.group.is_none()) && !policy.skips_untouched());
    }
}
