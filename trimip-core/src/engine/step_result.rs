//! The results of a training step on the host: losses, counts, and the derivatives of the exposures.

use crate::{Result, engine::ranks::fault};
use serde::{Deserialize, Serialize};

/// Losses and counts of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepSums {
    /// Σ weight · loss: the photometric term averaged over channels, plus the other terms at work
    /// ([`losses`](crate::field::losses)).
    pub loss: f64,
    /// Σ weight over the rays that the loss is averaged over.
    pub weight: f64,
    /// Σ squared error over channels.
    pub squared_error: f64,
    /// Pixels.
    pub rays: u64,
    /// Samples marched.
    pub marched: u64,
    /// Samples kept.
    pub kept: u64,
    /// Pixels that are not finite.
    pub non_finite: u64,
}

impl StepSums {
    /// Adds the sums of another tile.
    pub fn add(&mut self, other: &Self) {
        self.loss += other.loss;
        self.weight += other.weight;
        self.squared_error += other.squared_error;
        self.rays += other.rays;
        self.marched += other.marched;
        self.kept += other.kept;
        self.non_finite += other.non_finite;
    }
}

/// Largest number of steps whose sums are not read back yet.
pub const MOST_PENDING: usize = 2;

/// The results of a training step on the host.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepResult {
    /// Losses and counts.
    pub sums: StepSums,
    /// Derivative of [`StepSums::loss`] by the log-gains (RGB) of each photograph; empty without `loss.exposure`.
    pub exposures: Vec<[f64; 3]>,
}

impl StepResult {
    /// All numbers as bits, to be sent to another process.
    pub fn to_words(&self) -> Vec<u64> {
        let StepSums { loss, weight, squared_error, rays, marched, kept, non_finite } = self.sums;
        let sums = [loss, weight, squared_error].map(f64::to_bits).into_iter();
        let counts = [rays, marched, kept, non_finite];
        sums.chain(counts).chain(self.exposures.as_flattened().iter().map(|value| value.to_bits())).collect()
    }

    /// The result of these [`to_words`](Self::to_words).
    ///
    /// # Errors
    /// When their number is not 7 and three for each photograph.
    pub fn of_words(words: &[u64]) -> Result<Self> {
        let Some((&[loss, weight, squared_error, rays, marched, kept, non_finite], exposures)) =
            words.split_first_chunk().filter(|(_, exposures)| exposures.len().is_multiple_of(3))
        else {
            let found = words.len();
            return Err(fault(format_args!("expected 7 sums and 3 for each photograph, found {found}")));
        };
        let [loss, weight, squared_error] = [loss, weight, squared_error].map(f64::from_bits);
        Ok(Self {
            sums: StepSums { loss, weight, squared_error, rays, marched, kept, non_finite },
            exposures: exposures.as_chunks().0.iter().map(|gains| gains.map(f64::from_bits)).collect(),
        })
    }

    /// Adds the result of another tile.
    pub fn add(&mut self, other: &Self) {
        self.sums.add(&other.sums);
        let count = self.exposures.len().max(other.exposures.len());
        self.exposures.resize(count, [0.0; 3]);
        for (own, other) in self.exposures.as_flattened_mut().iter_mut().zip(other.exposures.as_flattened()) {
            *own += other;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::ErrorKind;

    #[test]
    fn a_result_is_that_of_its_words_and_of_no_other_number_of_them() {
        let sums = StepSums {
            loss: 0.5,
            weight: 3.0,
            squared_error: f64::NAN,
            rays: 5,
            marched: u64::MAX,
            kept: 7,
            non_finite: 1,
        };
        let words = StepResult { sums, exposures: vec![[0.25, -1.0, 2.0], [1e300, 0.0, -0.0]] }.to_words();
        for count in 0..=words.len() {
            match StepResult::of_words(&words[..count]) {
                Ok(result) => {
                    assert!(count >= 7 && count % 3 == 1, "{count}");
                    assert_eq!(result.to_words(), words[..count]);
                }
                Err(error) => {
                    assert!(count < 7 || count % 3 != 1, "{count}");
                    assert_eq!(error.kind, ErrorKind::Device);
                    assert!(error.message.contains(&format!("found {count}")), "{error}");
                }
            }
        }
    }
}
