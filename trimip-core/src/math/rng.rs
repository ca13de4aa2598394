//! Counter-based random numbers: a hash of (seed, sequence, step, index) and nothing else. There is no state to save, any
//! CPU or GPU thread draws the number it needs, and 32-bit integer arithmetic gives the same bits everywhere.

/// Purpose of a random number; sequences are independent of each other.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(u32)]
pub enum Sequence {
    /// Initial parameters.
    Initial = 1,
    /// Pixels of a training batch.
    Pixel = 2,
    /// Jitter of a ray's first sample.
    Jitter = 3,
    /// Choice of occupancy cells.
    Cell = 4,
    /// Points inside occupancy cells.
    Point = 5,
    /// Backgrounds of training rays.
    Background = 6,
    /// Directions in which rays are moved, for the gradient with respect to poses.
    Motion = 7,
    /// Samples that have a backward pass.
    Sample = 8,
}

/// A seed, to be hashed with sequence, step and index.
#[derive(Clone, Copy, Debug)]
pub struct Random {
    seed: [u32; 2],
}

impl Random {
    /// Creates the generator of a seed.
    pub fn new(seed: u64) -> Self {
        Self { seed: [seed as u32, (seed >> 32) as u32] }
    }

    /// Returns the numbers of a sequence at a step. They hold the part of the hash that is common to all indices.
    #[inline]
    pub fn at(&self, sequence: Sequence, step: u64) -> Draws {
        let key = self.seed[1].wrapping_mul(0x9e37_79b9) ^ (sequence as u32).wrapping_mul(0x85eb_ca6b);
        // The second round of the hash separates seeds that differ in few bits.
        Draws(pcg4d([self.seed[0] ^ key, step as u32, (step >> 32) as u32, sequence as u32]))
    }

    /// Returns four independent 32-bit numbers for (`sequence`, `step`, `index`).
    #[inline]
    pub fn bits(&self, sequence: Sequence, step: u64, index: u32) -> [u32; 4] {
        self.at(sequence, step).bits(index)
    }

    /// Returns four independent numbers in [0, 1), multiples of 2^−24.
    #[inline]
    pub fn uniform(&self, sequence: Sequence, step: u64, index: u32) -> [f32; 4] {
        self.bits(sequence, step, index).map(unit)
    }
}

/// The numbers of one sequence at one step.
#[derive(Clone, Copy, Debug)]
pub struct Draws([u32; 4]);

impl Draws {
    /// Returns the state from which a device draws the same numbers.
    pub fn words(&self) -> [u32; 4] {
        self.0
    }

    /// Returns four independent 32-bit numbers for `index`.
    #[inline]
    pub fn bits(&self, index: u32) -> [u32; 4] {
        let [x, y, z, w] = self.0;
        pcg4d([x ^ index, y, z, w.wrapping_add(index)])
    }
}

/// Converts the upper 24 bits to a number in [0, 1).
#[inline]
pub fn unit(bits: u32) -> f32 {
    (bits >> 8) as f32 * (1.0 / 16_777_216.0)
}

/// Converts 32 random bits to a number in 0..count (multiply-shift; bias below count/2^32).
#[inline]
pub fn below(bits: u32, count: u32) -> u32 {
    ((u64::from(bits) * u64::from(count)) >> 32) as u32
}

/// Hashes four words to four words (Jarzynski and Olano, Hash Functions for GPU Rendering, 2020).
#[inline]
fn pcg4d(v: [u32; 4]) -> [u32; 4] {
    let mix = |[mut x, mut y, mut z, mut w]: [u32; 4]| {
        x = x.wrapping_add(y.wrapping_mul(w));
        y = y.wrapping_add(z.wrapping_mul(x));
        z = z.wrapping_add(x.wrapping_mul(y));
        w = w.wrapping_add(y.wrapping_mul(z));
        [x, y, z, w]
    };
    mix(mix(v.map(|v| v.wrapping_mul(1_664_525).wrapping_add(1_013_904_223))).map(|v| v ^ (v >> 16)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_uniform_and_their_four_parts_uncorrelated() {
        let random = Random::new(7);
        let count = 100_000;
        let draws: Vec<[f32; 4]> = (0..count).map(|i| random.uniform(Sequence::Pixel, 3, i)).collect();
        let mean = |f: &dyn Fn(&[f32; 4]) -> f64| draws.iter().map(f).sum::<f64>() / f64::from(count);
        // The standard error of a mean is 0.29/√n = 0.0009 for uniform numbers and 0.083/√n for products of centred ones.
        for a in 0..4 {
            assert!((mean(&|d| d[a].into()) - 0.5).abs() < 0.004);
            assert!((mean(&|d| (f64::from(d[a]) - 0.5).powi(2)) - 1.0 / 12.0).abs() < 0.002);
            for b in 0..a {
                assert!(mean(&|d| (f64::from(d[a]) - 0.5) * (f64::from(d[b]) - 0.5)).abs() < 0.0012);
            }
        }
        let serial: f64 =
            draws.windows(2).map(|w| (f64::from(w[0][0]) - 0.5) * (f64::from(w[1][0]) - 0.5)).sum();
        assert!((serial / f64::from(count)).abs() < 0.0012, "neighbouring indices");
    }

    #[test]
    fn seed_stream_step_and_index_all_matter() {
        let reference = Random::new(1).bits(Sequence::Pixel, 1, 1);
        for other in [
            Random::new(2).bits(Sequence::Pixel, 1, 1),
            Random::new(1 | 1 << 32).bits(Sequence::Pixel, 1, 1),
            Random::new(1).bits(Sequence::Jitter, 1, 1),
            Random::new(1).bits(Sequence::Pixel, 2, 1),
            Random::new(1).bits(Sequence::Pixel, 1 | 1 << 32, 1),
            Random::new(1).bits(Sequence::Pixel, 1, 2),
        ] {
            assert!((0..4).all(|i| other[i] != reference[i]));
        }
    }

    #[test]
    fn below_stays_below_and_reaches_every_value() {
        let mut seen = [false; 10];
        for i in 0..1000 {
            seen[below(Random::new(0).bits(Sequence::Cell, 0, i)[0], 10) as usize] = true;
        }
        assert!(seen.iter().all(|&s| s));
        assert_eq!(below(u32::MAX, 10), 9);
    }
}
