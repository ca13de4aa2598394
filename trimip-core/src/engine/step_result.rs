//! The results of a training step on the host: losses, counts, and the derivatives with respect to exposures and
//! cameras.

use crate::{Result, engine::ranks::fault};
use serde::{Deserialize, Serialize};

/// Losses and counts of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepSums {
    /// Σ weight · loss: the photometric term averaged over channels, plus the other enabled terms
    /// ([`losses`](crate::field::losses)).
    pub loss: f64,
    /// Σ weight of the pixels over which the loss is averaged.
    pub weight: f64,
    /// Σ importance · squared error over channels.
    pub squared_error: f64,
    /// Number of pixels.
    pub rays: u64,
    /// Number of marched samples.
    pub marched: u64,
    /// Number of kept samples.
    pub kept: u64,
    /// Number of samples with a backward pass: the drawn samples, or all kept samples in a step without a draw.
    #[serde(default)]
    pub drawn: u64,
    /// Number of pixels that are not finite.
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
        self.drawn += other.drawn;
        self.non_finite += other.non_finite;
    }
}

/// Largest number of steps whose sums have not been read back.
pub const MOST_PENDING: usize = 2;

/// Derivatives of [`StepSums::loss`] with respect to the camera of a photograph: four vectors along the axes of the
/// world. The first is the derivative with respect to a translation of the camera, and the second with respect to
/// rotations around the world's axes through the origin. The others are Σ c·g and Σ τ²·c·g over rays: g is the
/// derivative with respect to a motion of the ray's direction perpendicular to itself, and c and τ are the cosine and
/// tangent of the ray's angle to the optical axis. They determine the derivatives with respect to intrinsics
/// ([`intrinsics`](crate::engine::intrinsics)).
pub type CameraSums = [f64; 12];

/// The results of a training step on the host.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepResult {
    /// Losses and counts.
    pub sums: StepSums,
    /// Derivative of [`StepSums::loss`] with respect to the log-gains (RGB) of each photograph; empty without
    /// `loss.exposure`.
    pub exposures: Vec<[f64; 3]>,
    /// Derivatives of [`StepSums::loss`] with respect to the camera of each photograph; empty unless cameras are
    /// refined.
    pub cameras: Vec<CameraSums>,
}

impl StepResult {
    /// Returns all numbers as bits, to be sent to another process: the eight sums, the number of exposures, three words
    /// per exposure and twelve per camera.
    pub fn to_words(&self) -> Vec<u64> {
        let StepSums { loss, weight, squared_error, rays, marched, kept, drawn, non_finite } = self.sums;
        let sums = [loss, weight, squared_error].map(f64::to_bits).into_iter();
        let counts = [rays, marched, kept, drawn, non_finite];
        let by_photographs = self.exposures.as_flattened().iter().chain(self.cameras.as_flattened());
        let by_photographs = by_photographs.map(|value| value.to_bits());
        sums.chain(counts).chain([self.exposures.len() as u64]).chain(by_photographs).collect()
    }

    /// Returns the result whose [`to_words`](Self::to_words) are `words`.
    ///
    /// # Errors
    /// When the number of words is not 9 plus three per exposure plus twelve per camera.
    pub fn of_words(words: &[u64]) -> Result<Self> {
        let of = |words: &[u64]| -> Option<Self> {
            let (&[loss, weight, squared_error, rays, marched, kept, drawn, non_finite, exposures], rest) =
                words.split_first_chunk()?;
            let exposures = usize::try_from(exposures).ok()?.checked_mul(3)?;
            let (exposures, cameras) = rest.split_at_checked(exposures)?;
            let [loss, weight, squared_error] = [loss, weight, squared_error].map(f64::from_bits);
            Some(Self {
                sums: StepSums { loss, weight, squared_error, rays, marched, kept, drawn, non_finite },
                exposures: rows(exposures)?,
                cameras: rows(cameras)?,
            })
        };
        of(words).ok_or_else(|| {
            let found = words.len();
            fault(format_args!(
                "expected 8 sums, a count, 3 numbers for each exposure and 12 for each camera, found {found} words"
            ))
        })
    }

    /// Adds the result of another tile.
    pub fn add(&mut self, other: &Self) {
        self.sums.add(&other.sums);
        add_rows(&mut self.exposures, &other.exposures);
        add_rows(&mut self.cameras, &other.cameras);
    }
}

/// Returns rows of `N` numbers, or `None` if the last row is incomplete.
fn rows<const N: usize>(words: &[u64]) -> Option<Vec<[f64; N]>> {
    let (rows, rest) = words.as_chunks();
    rest.is_empty().then(|| rows.iter().map(|row| row.map(f64::from_bits)).collect())
}

/// Adds the rows `other` to the rows `own`; missing rows count as zero.
fn add_rows<const N: usize>(own: &mut Vec<[f64; N]>, other: &[[f64; N]]) {
    own.resize(own.len().max(other.len()), [0.0; N]);
    own.as_flattened_mut().iter_mut().zip(other.as_flattened()).for_each(|(own, other)| *own += other);
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
            drawn: 6,
            non_finite: 1,
        };
        let (exposures, cameras) = (vec![[0.25, -1.0, 2.0], [1e300, 0.0, -0.0]], vec![[0.5; 12]; 2]);
        let words = StepResult { sums, exposures, cameras }.to_words();
        for count in 0..=words.len() {
            match StepResult::of_words(&words[..count]) {
                Ok(result) => {
                    assert!(count >= 15 && (count - 15) % 12 == 0, "{count}");
                    assert_eq!(result.to_words(), words[..count]);
                }
                Err(error) => {
                    assert!(count < 15 || (count - 15) % 12 != 0, "{count}");
                    assert_eq!(error.kind(), ErrorKind::Device);
                    assert!(error.message().contains(&format!("found {count}")), "{error}");
                }
            }
        }
        let mut words = words;
        words[8] = u64::MAX;
        assert!(StepResult::of_words(&words).is_err());
    }
}
