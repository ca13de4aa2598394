//! The parts of a step. Deposit i belongs to part i modulo their number, a power of two. What is summed over partial gradients is summed
//! over those of each part first, in order, and then over the parts in a balanced binary tree. A rank has a subtree, so that it
//! sends one sum, and all sums have the same bits for any number of ranks.

use std::ops::Range;
use trimip_core::engine::exchange::Rank;

/// Number of parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ReductionTree(usize);

impl ReductionTree {
    /// The `wanted` number of parts, a power of two, or as many as `partials` allow.
    pub fn new(wanted: u32, partials: usize) -> Self {
        Self((1 << partials.max(1).ilog2()).min((wanted as usize).max(1)))
    }

    /// Number of parts.
    pub fn count(self) -> usize {
        self.0
    }

    /// The parts of a rank: a subtree.
    pub fn of(self, this_rank: Rank) -> Range<usize> {
        let (mut parts, mut ranks) = (0..self.0, 0..this_rank.size);
        while ranks.len() > 1 {
            let [left, right] = halves(ranks);
            let half = parts.start + parts.len() / 2;
            (ranks, parts) = match left.contains(&this_rank.id) {
                true => (left, parts.start..half),
                false => (right, half..parts.end),
            };
        }
        parts
    }

    /// True if a rank has partial gradients `index`.
    pub fn has(self, this_rank: Rank, index: usize) -> bool {
        self.of(this_rank).contains(&(index % self.0))
    }
}

/// The left and the right half of a range of ranks or parts. Of an odd number of ranks the right half has more.
pub fn halves(range: Range<usize>) -> [Range<usize>; 2] {
    let half = range.start + range.len() / 2;
    [range.start..half, half..range.end]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_part_has_one_rank_and_every_rank_a_subtree() {
        for wanted in [1, 2, 4, 8, 64] {
            for partials in [1, 3, 16, 256] {
                let parts = ReductionTree::new(wanted, partials);
                assert!(parts.count().is_power_of_two() && parts.count() <= partials.min(wanted as usize));
                for of in 1..=parts.count() {
                    let mut next = 0;
                    for rank in 0..of {
                        let own = parts.of(Rank { id: rank, size: of });
                        assert_eq!(own.start, next, "{parts:?}, {of} ranks");
                        assert!(own.len().is_power_of_two() && own.start.is_multiple_of(own.len()));
                        next = own.end;
                    }
                    assert_eq!(next, parts.count());
                    if of.is_power_of_two() {
                        assert!((0..of).all(|rank| parts.of(Rank { id: rank, size: of }).len() == parts.count() / of));
                    }
                    for index in 0..partials {
                        assert_eq!(
                            (0..of).filter(|&rank| parts.has(Rank { id: rank, size: of }, index)).count(),
                            1
                        );
                    }
                }
            }
        }
    }
}
