//! The reduction tree of a step. The number of leaves is a power of two, and set i of partial gradients belongs to leaf i modulo this
//! number. Reductions have two stages: first the sets of each leaf are added up in order, then the leaves in a balanced binary tree.
//! Each rank owns a subtree, so that it sends one sum, and all sums are bit-identical for any number of ranks.

use std::ops::Range;
use trimip_core::engine::exchange::Rank;

/// The reduction tree, represented by its number of leaves.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReductionTree(usize);

impl ReductionTree {
    /// Creates a tree of `wanted` leaves, a power of two, or of fewer leaves if there are fewer sets (`partials`).
    pub fn new(wanted: u32, partials: usize) -> Self {
        Self((1 << partials.max(1).ilog2()).min((wanted as usize).max(1)))
    }

    /// Returns the number of leaves.
    pub fn count(self) -> usize {
        self.0
    }

    /// Returns the leaves of a rank, which form a subtree.
    pub fn of(self, this_rank: Rank) -> Range<usize> {
        let (mut leaves, mut ranks) = (0..self.0, 0..this_rank.size);
        while ranks.len() > 1 {
            let [left, right] = halves(ranks);
            let half = leaves.start + leaves.len() / 2;
            (ranks, leaves) = match left.contains(&this_rank.id) {
                true => (left, leaves.start..half),
                false => (right, half..leaves.end),
            };
        }
        leaves
    }

    /// Returns true if a rank owns set `index` of partial gradients.
    pub fn has(self, this_rank: Rank, index: usize) -> bool {
        self.of(this_rank).contains(&(index % self.0))
    }
}

/// Returns the left and the right half of a range of ranks or leaves. If the length is odd, the right half has one
/// more.
pub fn halves(range: Range<usize>) -> [Range<usize>; 2] {
    let half = range.start + range.len() / 2;
    [range.start..half, half..range.end]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_leaf_has_one_rank_and_every_rank_a_subtree() {
        for wanted in [1, 2, 4, 8, 64] {
            for partials in [1, 3, 16, 256] {
                let leaves = ReductionTree::new(wanted, partials);
                assert!(leaves.count().is_power_of_two() && leaves.count() <= partials.min(wanted as usize));
                for of in 1..=leaves.count() {
                    let mut next = 0;
                    for rank in 0..of {
                        let own = leaves.of(Rank { id: rank, size: of });
                        assert_eq!(own.start, next, "{leaves:?}, {of} ranks");
                        assert!(own.len().is_power_of_two() && own.start.is_multiple_of(own.len()));
                        next = own.end;
                    }
                    assert_eq!(next, leaves.count());
                    if of.is_power_of_two() {
                        assert!(
                            (0..of)
                                .all(|rank| leaves.of(Rank { id: rank, size: of }).len()
                                    == leaves.count() / of)
                        );
                    }
                    for index in 0..partials {
                        assert_eq!(
                            (0..of).filter(|&rank| leaves.has(Rank { id: rank, size: of }, index)).count(),
                            1
                        );
                    }
                }
            }
        }
    }
}
