//! Distribution of a step's rays over the scales of a set, and the loss weight of a ray of each scale.

use crate::Scale;

/// Rays and loss weight of each scale.
///
/// A scale of area weight w = 4^j has 1/w of the finest scale's pixels. At balance b its share of the rays is ∝ w^(b−1)
/// and each ray has weight w^(1−b). The expected loss is the same at every b, with equal weight for all scales. At 0 all
/// pixels are equally likely (paper), and the gradient of coarse scales comes from few rays. At 1 all scales get equally
/// many rays, which minimises the variance if the scales have equal variance.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Balance {
    shares: Vec<f64>,
    weights: Vec<f32>,
}

impl Balance {
    /// Balance `balance` in [0, 1] over `scales`, fine to coarse. A scale without pixels gets no rays.
    pub fn new(scales: &[Scale], balance: f64) -> Self {
        let weight = |scale: &Scale| f64::from(scale.weight);
        let share = |scale: &Scale| match scale.pixels.is_empty() {
            true => 0.0,
            false => weight(scale).powf(balance - 1.0),
        };
        let sum: f64 = scales.iter().map(share).sum();
        Self {
            shares: scales.iter().map(|scale| share(scale) / sum).collect(),
            weights: scales.iter().map(|scale| weight(scale).powf(1.0 - balance) as f32).collect(),
        }
    }

    /// Index of the first of `total` rays that belongs to each scale, fine to coarse: coarse scales take their rounded-down
    /// share from the end, the finest the rest.
    pub fn begins(&self, total: u32) -> impl DoubleEndedIterator<Item = u32> + ExactSizeIterator + use<> {
        let mut begins = vec![0; self.shares.len()];
        let mut end = total;
        for (scale, share) in self.shares.iter().enumerate().skip(1).rev() {
            end -= (f64::from(total) * share) as u32;
            begins[scale] = end;
        }
        begins.into_iter()
    }

    /// Loss weight of a ray of scale `scale`.
    pub fn weight(&self, scale: usize) -> f32 {
        self.weights[scale]
    }

    /// Loss weights, fine to coarse.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scales(count: u32) -> Vec<Scale> {
        let scale = |j: u32| Scale {
            factor: 1 << j,
            weight: 4_f32.powi(j as i32),
            views: 0..1,
            pixels: 0..(1 << 12) >> (2 * j),
        };
        (0..count).map(scale).collect()
    }

    /// Rays of each scale.
    fn rays(balance: &Balance, total: u32) -> Vec<u32> {
        let begins: Vec<u32> = balance.begins(total).chain([total]).collect();
        begins.windows(2).map(|pair| pair[1] - pair[0]).collect()
    }

    #[test]
    fn every_scale_weighs_the_same_at_every_balance() {
        for balance in [0.0, 0.3, 0.5, 1.0] {
            let found = Balance::new(&scales(4), balance);
            let parts: Vec<f64> =
                found.shares.iter().zip(&found.weights).map(|(share, w)| share * f64::from(*w)).collect();
            assert!(parts.iter().all(|part| (part / parts[0] - 1.0).abs() < 1e-6), "{balance}: {parts:?}");
            assert!((found.shares.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn the_ends_are_pixels_alike_and_scales_alike() {
        let pixels = Balance::new(&scales(4), 0.0);
        assert_eq!(rays(&pixels, 8500), [6400, 1600, 400, 100]);
        assert_eq!(pixels.weights(), [1.0, 4.0, 16.0, 64.0]);
        let alike = Balance::new(&scales(4), 1.0);
        assert_eq!(rays(&alike, 8500), [2125; 4]);
        assert_eq!(alike.weights(), [1.0; 4]);
    }

    #[test]
    fn a_scale_without_pixels_has_no_ray() {
        let mut three = scales(3);
        three[1].pixels = 0..0;
        assert_eq!(rays(&Balance::new(&three, 1.0), 100), [50, 0, 50]);
    }
}
