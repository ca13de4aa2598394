//! Chooses the samples that have a backward pass (`train.backward_fraction`): all samples with large gradients, and
//! some of the others.

use super::Trainer;
use crate::{
    Backend,
    engine::{
        backend::Sampler,
        batch::{SampleDraw, StepSums},
    },
    math::rng::Sequence,
};

/// Initial threshold of the norms of gradients, with which nearly all samples are drawn.
const FIRST: f64 = 1e-12;

/// Largest threshold. Without a bound it would rise for ever in a scene without gradients.
const LAST: f64 = 1e12;

/// Largest factor by which a step changes the threshold.
const MOST: f64 = 2.0;

impl<B: Backend> Trainer<B> {
    /// Returns the draw of a step; `None` if all samples have a backward pass.
    pub(super) fn draw(&self, step: u64) -> Option<SampleDraw> {
        (self.state.draw_threshold > 0.0).then(|| self.draw_at(step, self.state.draw_threshold))
    }

    /// Returns a draw with the random numbers of a step.
    pub(super) fn draw_at(&self, step: u64, threshold: f64) -> SampleDraw {
        let random = self.loaded.stages.sampler.policy().random;
        SampleDraw { draws: random.at(Sequence::Sample, step), threshold: threshold as f32 }
    }

    /// Adapts the threshold, so that later steps draw about the configured fraction of the kept samples.
    pub(super) fn adapt_draw(&mut self, sums: &StepSums, progress: f64) {
        let fraction = self.loaded.config.train.backward_fraction.at(progress);
        let threshold = adapted(self.state.draw_threshold, fraction, [sums.drawn, sums.kept]);
        self.state.draw_threshold = threshold;
    }
}

/// Returns the threshold after a step that drew `drawn` of `of` samples, if a fraction `fraction` is wanted; 0 if all
/// samples are to be drawn.
fn adapted(threshold: f64, fraction: f64, [drawn, of]: [u64; 2]) -> f64 {
    if fraction >= 1.0 {
        return 0.0;
    }
    if threshold == 0.0 {
        return FIRST;
    }
    if of == 0 {
        return threshold;
    }
    if drawn == of {
        return (MOST * threshold).min(LAST);
    }
    // The number of drawn samples falls at most by the factor by which the threshold rises. The square root damps
    // oscillations on devices whose sums arrive late.
    let ratio = drawn as f64 / (fraction * of as f64);
    (threshold * ratio.sqrt().clamp(MOST.recip(), MOST)).clamp(FIRST, LAST)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::VecDeque;

    #[test]
    fn the_fraction_is_reached_however_late_the_sums_are() {
        // Norms from 1e-6 to 1, spread evenly over the orders of magnitude.
        let norms: Vec<f64> = (0..10_000).map(|i| 10.0_f64.powf(-6.0 * f64::from(i) / 1e4)).collect();
        let drawn = |threshold: f64| {
            let expected: f64 = norms.iter().map(|norm| (norm / threshold).min(1.0)).sum();
            [expected as u64, norms.len() as u64]
        };
        for lag in 0..=2 {
            for fraction in [0.9, 0.5, 0.25, 0.05] {
                let (mut threshold, mut late) = (0.0, VecDeque::new());
                for step in 0..200 {
                    late.push_back(if threshold > 0.0 { drawn(threshold) } else { [0, 10_000] });
                    if step >= lag {
                        let sums = late.pop_front().unwrap();
                        threshold = adapted(threshold, fraction, sums);
                    }
                }
                let found = drawn(threshold)[0] as f64 / 1e4;
                assert!((found / fraction - 1.0).abs() < 0.02, "lag {lag}: {found}, not {fraction}");
            }
        }
    }

    #[test]
    fn nothing_is_drawn_apart_if_all_samples_count() {
        assert_eq!(adapted(0.0, 1.0, [0, 100]), 0.0);
        assert_eq!(adapted(3.0, 1.0, [50, 100]), 0.0);
        assert!(adapted(0.0, 0.5, [0, 100]) > 0.0);
    }

    #[test]
    fn the_threshold_stays_within_its_range() {
        let mut threshold = 1e-3;
        assert_eq!(adapted(threshold, 0.5, [0, 0]), threshold, "a step without samples");
        for _ in 0..1000 {
            threshold = adapted(threshold, 0.5, [0, 100]);
        }
        assert_eq!(threshold, FIRST);
        for _ in 0..1000 {
            threshold = adapted(threshold, 0.5, [100, 100]);
        }
        assert_eq!(threshold, LAST);
    }
}
