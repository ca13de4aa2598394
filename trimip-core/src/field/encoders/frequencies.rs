//! Positional encoding (Mildenhall et al. 2020, NeRF, Eq. 4) and its integral over a sample's Gaussian (Barron et al.
//! 2021, mip-NeRF, Eq. 14): coordinates, and their sines and cosines at rising frequencies. It has no parameters.
//! Coordinates are in world units, relative to the middle of the box.

use super::definition::{Definition, Reference, SamplePosition};
use super::rip_map::Gaussian;
use crate::config::FrequenciesConfig;
use crate::math::scalar::Real;
use crate::{Aabb, Config, Slot};

/// Ratio of two radii for a pixel: the radius of mip-NeRF's cone, 2/√12 of the pixel's width, to the radius of a disc
/// of the pixel's area, 1/√π of its width.
pub const RADIUS: f64 = 1.023_326_707_946_488_5;

/// Positional encodings as an encoder.
pub struct Frequencies;

/// The encoding of a configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoding<R> {
    /// Number of frequencies, 2^0, 2^1, …
    pub count: usize,
    /// True to replace sines and cosines by their means over the sample's Gaussian.
    pub integrated: bool,
    /// True to put the coordinates themselves first.
    pub identity: bool,
    /// Size of the box, in world units.
    pub extent: [R; 3],
}

impl<R: Real> Encoding<R> {
    /// Creates the encoding of a configuration.
    pub fn new(config: &FrequenciesConfig, aabb: &Aabb<f64>) -> Self {
        Self {
            count: config.count as usize,
            integrated: config.integrated,
            identity: config.identity,
            extent: aabb.extent().map(R::from_f64),
        }
    }

    /// Returns the number of features.
    pub fn width(&self) -> usize {
        6 * self.count + if self.identity { 3 } else { 0 }
    }

    /// Returns the mean of a sample, in world units relative to the middle of the box, and its variance along each
    /// axis.
    #[inline(always)]
    pub fn moments(&self, position: [R; 3], radius: R, direction: [R; 3], t: R, length: R) -> [[R; 3]; 2] {
        let half = R::from_f64(0.5);
        let world = |place: [R; 3]| std::array::from_fn(|axis| (place[axis] - half) * self.extent[axis]);
        if !self.integrated {
            return [world(position), [R::zero(); 3]];
        }
        let radius = R::from_f64(RADIUS) * radius;
        let Gaussian { mean, across, along, .. } =
            Gaussian::new(position, self.extent, radius, direction, t, length);
        let variance = direction.map(|d| along * d * d + across * (R::one() - d * d));
        [world(mean), variance]
    }

    /// Writes the features of a sample to the first [`width`](Self::width) numbers of `out`.
    #[inline(always)]
    pub fn write(&self, [mean, variance]: [[R; 3]; 2], out: &mut [R]) {
        let first = if self.identity { 3 } else { 0 };
        out[..first].copy_from_slice(&mean[..first]);
        let mut factor = R::one();
        for out in out[first..self.width()].chunks_exact_mut(6) {
            for axis in 0..3 {
                let (sine, cosine) = (factor * mean[axis]).sin_cos();
                let attenuation = (R::from_f64(-0.5) * factor * factor * variance[axis]).exp();
                (out[axis], out[3 + axis]) = (attenuation * sine, attenuation * cosine);
            }
            factor = factor + factor;
        }
    }
}

impl Definition for Frequencies {
    fn describe(&self, config: &Config) -> String {
        let Encoding { count, integrated, .. } = configured(config);
        let how = if integrated { "integrated positional encoding" } else { "positional encoding" };
        format!("{how} of {count} frequencies, without parameters")
    }

    fn width(&self, config: &Config) -> usize {
        configured(config).width()
    }

    fn slots(&self, _: &Config) -> Vec<Slot> {
        Vec::new()
    }

    fn reference(&self, config: &Config, _: Vec<Vec<f64>>) -> Box<dyn Reference> {
        Box::new(configured(config))
    }
}

fn configured(config: &Config) -> Encoding<f64> {
    Encoding::new(&config.frequencies, &Aabb::new(&config.scene))
}

impl Reference for Encoding<f64> {
    fn features(&self, at: &SamplePosition) -> Vec<f64> {
        let mut features = vec![0.0; self.width()];
        self.write(self.moments(at.position, at.radius, at.direction, at.t, at.length), &mut features);
        features
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn encoding(count: usize, integrated: bool) -> Encoding<f64> {
        Encoding { count, integrated, identity: false, extent: [1.0; 3] }
    }

    #[test]
    fn the_ratio_of_radii_is_that_of_disc_and_square() {
        assert!((RADIUS - 2.0 * std::f64::consts::PI.sqrt() / 12_f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn means_over_gaussians_are_the_published_ones() {
        let mut features = [0.0; 18];
        encoding(3, true).write([[0.7; 3], [0.04; 3]], &mut features);
        let expected = [[0.631_461, 0.749_697], [0.909_685, 0.156_899], [0.243_251, -0.684_194]];
        for (found, expected) in features.chunks_exact(6).zip(expected) {
            assert!((found[0] - expected[0]).abs() < 1e-6 && (found[3] - expected[1]).abs() < 1e-6);
        }
    }

    #[test]
    fn without_width_the_integral_is_the_encoding() {
        let (mut plain, mut integrated) = ([0.0; 24], [0.0; 24]);
        let direction = [0.6, 0.0, 0.8];
        let place = [0.2, 0.9, 0.4];
        let [a, b] = [false, true].map(|integrated| encoding(4, integrated));
        a.write(a.moments(place, 0.1, direction, 2.0, 0.3), &mut plain);
        b.write(b.moments(place, 0.0, direction, 2.0, 0.0), &mut integrated);
        assert!(plain.iter().zip(integrated).all(|(a, b)| (a - b).abs() < 1e-14));
    }

    /// Checks mean and variances against those of points spread evenly over the frustum of a cone, computed by
    /// integration over slices.
    #[test]
    fn variances_are_those_of_points_in_the_frustum() {
        let (t0, t1, slope) = (1.0, 2.0, 0.1);
        let (t, length) = (0.5 * (t0 + t1), t1 - t0);
        let radius = slope * t / RADIUS;
        let [mean, variance] =
            encoding(1, true).moments([0.5, 0.5, 0.5 + t], radius, [0.0, 0.0, 1.0], t, length);
        let slices = 20_000;
        let mut sums = [0.0; 4];
        for i in 0..slices {
            let z = t0 + length * (f64::from(i) + 0.5) / f64::from(slices);
            // The weight of a slice is the area of its disc. Over the disc, the mean square of a coordinate is a
            // quarter of the squared radius.
            let (weight, square) = (z * z, (slope * z).powi(2) / 4.0);
            let terms = [weight, weight * z, weight * z * z, weight * square];
            sums.iter_mut().zip(terms).for_each(|(sum, term)| *sum += term);
        }
        let [all, first, second, across] = sums;
        let middle = first / all;
        assert!((mean[2] - middle).abs() < 1e-8 && (middle - 1.607_143).abs() < 1e-6);
        let along = second / all - middle * middle;
        assert!((variance[2] - along).abs() < 1e-8 && (along - 0.074_234_7).abs() < 1e-7);
        assert!((variance[0] - across / all).abs() < 1e-8 && (across / all - 0.006_642_86).abs() < 1e-8);
        assert!(mean[0].abs() < 1e-15);
    }
}
