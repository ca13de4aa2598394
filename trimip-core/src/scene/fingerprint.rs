//! Fingerprint of training views: their number, cameras and pixels, as the run uses them. The result of a run resumed on
//! other views would belong to neither data set.

use crate::ViewSet;
use serde::{Deserialize, Serialize};

/// Odd multiplier of the hash, 2^64 divided by the golden ratio (Knuth, The Art of Computer Programming 3, 6.4).
const MULTIPLIER: u64 = 0x9e37_79b9_7f4a_7c15;

/// Number of independent sums of a hash: the multiplications of a single sum would wait for each other.
const LANES: usize = 8;

/// Fingerprint of training views at all scales.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Fingerprint {
    /// Number of views.
    pub views: usize,
    /// Hash of all numbers of all cameras, as f32: the last bits of f64 may differ between machines.
    pub cameras: u64,
    /// Hash of all pixels.
    pub pixels: u64,
}

impl Fingerprint {
    /// Returns the fingerprint of `set`.
    pub fn of(set: &ViewSet) -> Self {
        let numbers = set.views.iter().flat_map(|view| view.camera.numbers());
        let cameras: Vec<u8> = numbers.flat_map(|number| (number as f32).to_le_bytes()).collect();
        Self { views: set.views.len(), cameras: hash(&cameras), pixels: hash(set.pixels.as_flattened()) }
    }

    /// Describes the differences from `other`; returns `None` if there are none.
    pub fn difference(&self, other: &Self) -> Option<String> {
        if self.views != other.views {
            return Some(format!("{} training views, was {}", self.views, other.views));
        }
        let parts = [("cameras", self.cameras == other.cameras), ("pixels", self.pixels == other.pixels)];
        let differing: Vec<&str> =
            parts.into_iter().filter(|(_, same)| !same).map(|(name, _)| name).collect();
        (!differing.is_empty()).then(|| format!("other {} of the training views", differing.join(" and ")))
    }
}

/// Returns a hash of bytes that is identical on every machine. It detects accidental changes, not attacks.
pub fn hash(bytes: &[u8]) -> u64 {
    let mix = |sum: u64, word: u64| (sum ^ word).wrapping_mul(MULTIPLIER).rotate_left(29);
    let (words, rest) = bytes.as_chunks::<8>();
    let mut sums = [bytes.len() as u64; LANES];
    let (blocks, last) = words.as_chunks::<LANES>();
    for block in blocks {
        for (sum, word) in sums.iter_mut().zip(block) {
            *sum = mix(*sum, u64::from_le_bytes(*word));
        }
    }
    let tail = last.iter().map(|word| u64::from_le_bytes(*word)).chain(rest.iter().map(|&byte| byte.into()));
    sums.into_iter().chain(tail).fold(0, mix)
}

/// Returns a hash of several parts that is identical on every machine: the hash of the [hashes](hash) of all parts, so that
/// it also depends on where each part ends.
pub fn hash_of<P: AsRef<[u8]>>(parts: impl IntoIterator<Item = P>) -> u64 {
    let hashes: Vec<u8> = parts.into_iter().flat_map(|part| hash(part.as_ref()).to_le_bytes()).collect();
    hash(&hashes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_byte_and_the_length_count() {
        for length in [0, 1, 7, 8, 63, 64, 65, 200] {
            let bytes: Vec<u8> = (0..length).map(|i| (i * 37) as u8).collect();
            let whole = hash(&bytes);
            assert_eq!(whole, hash(&bytes.clone()));
            assert_ne!(whole, hash(&[&bytes[..], &[0]].concat()), "{length} bytes and a zero");
            for place in 0..length {
                let mut other = bytes.clone();
                other[place] ^= 1;
                assert_ne!(whole, hash(&other), "byte {place} of {length}");
            }
        }
        // Neighbours that are swapped.
        assert_ne!(hash(&[1, 2, 3]), hash(&[2, 1, 3]));
        assert_ne!(hash(&[[1; 8], [2; 8]].concat()), hash(&[[2; 8], [1; 8]].concat()));
    }

    /// Checks hashes against numbers that another program computed from the description of the hash. Files and other
    /// machines hold such hashes.
    #[test]
    fn hashes_are_the_same_in_every_version() {
        assert_eq!(hash(b""), 0);
        assert_eq!(hash(b"abc"), 0x64f5_b31a_8513_6c85);
        assert_eq!(hash(&(0..200).collect::<Vec<u8>>()), 0x7713_fada_7a6f_47ea);
        assert_eq!(hash_of(["abc", "", "de"]), 0x42d8_ee1f_e186_0be2);
        assert_eq!(hash_of(["ab", "cde"]), 0x1dd0_7972_5de2_1e8b);
    }

    #[test]
    fn a_difference_is_named() {
        let own = Fingerprint { views: 3, cameras: 1, pixels: 2 };
        assert_eq!(own.difference(&own), None);
        let says = |other: Fingerprint, part: &str| assert!(own.difference(&other).unwrap().contains(part));
        says(Fingerprint { views: 4, ..own }, "3 training views, was 4");
        says(Fingerprint { pixels: 9, ..own }, "other pixels");
        says(Fingerprint { cameras: 9, pixels: 9, ..own }, "cameras and pixels");
    }
}
