//! Settings that change during a run: piecewise constant functions of the fraction of the run.

use serde::{Deserialize, Serialize};

/// Pieces `[fraction, value]` with rising fractions; the first starts at 0. `[[0.0, 4.0], [0.5, 1.0]]` is 4 in the first
/// half of a run and 1 in the second. In settings, a single number stands for a constant schedule.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Schedule(Vec<[f64; 2]>);

impl Schedule {
    /// Returns the schedule of these pieces without checking them; see [`Schedule::is_whole`].
    pub fn new(pieces: Vec<[f64; 2]>) -> Self {
        Self(pieces)
    }

    /// Returns the value at `progress` in [0, 1].
    pub fn at(&self, progress: f64) -> f64 {
        let begun = self.0.iter().take_while(|[fraction, _]| *fraction <= progress);
        begun.last().or(self.0.first()).map_or(0.0, |[_, value]| *value)
    }

    /// Returns the fraction of the run at which the piece at `progress` begins.
    pub fn since(&self, progress: f64) -> f64 {
        let begun = self.0.iter().take_while(|[fraction, _]| *fraction <= progress);
        begun.last().map_or(0.0, |[fraction, _]| *fraction)
    }

    /// Iterates over the values of all pieces.
    pub fn values(&self) -> impl Iterator<Item = f64> {
        self.0.iter().map(|[_, value]| *value)
    }

    /// Returns true if the pieces cover a run: the first starts at 0, and the others follow at rising fractions below 1.
    pub fn is_whole(&self) -> bool {
        let fractions = || self.0.iter().map(|[fraction, _]| *fraction);
        fractions().next() == Some(0.0)
            && fractions().is_sorted_by(|a, b| a < b)
            && fractions().all(|f| (0.0..1.0).contains(&f))
    }

    /// Returns true if the pieces cover a run and their values are whole numbers that fall to 0.
    pub fn falls_to_zero(&self) -> bool {
        self.is_whole()
            && self.values().all(|value| value.fract() == 0.0)
            && self.values().is_sorted_by(|a, b| a > b)
            && self.values().last() == Some(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_piece_lasts_until_the_next_begins() {
        let schedule = Schedule(vec![[0.0, 4.0], [0.25, 2.0], [0.5, 1.0]]);
        let at = [0.0, 0.2499, 0.25, 0.4, 0.5, 1.0, 1.5].map(|progress| schedule.at(progress));
        assert_eq!(at, [4.0, 4.0, 2.0, 2.0, 1.0, 1.0, 1.0]);
        let since = [0.0, 0.2499, 0.25, 0.4, 0.5, 1.0].map(|progress| schedule.since(progress));
        assert_eq!(since, [0.0, 0.0, 0.25, 0.25, 0.5, 0.5]);
        assert!(schedule.is_whole());
    }

    #[test]
    fn pieces_that_do_not_cover_a_run_are_known() {
        for pieces in
            [vec![], vec![[0.1, 1.0]], vec![[0.0, 1.0], [0.0, 2.0]], vec![[0.0, 1.0], [f64::NAN, 2.0]]]
        {
            assert!(!Schedule(pieces.clone()).is_whole(), "{pieces:?}");
        }
    }
}
