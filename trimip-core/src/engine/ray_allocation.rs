//! Distribution of a step's pixels over the scales of a set: the number of pixels that each scale gets, and the loss
//! weight and cones of these pixels.

use crate::{
    Config, Scale, ViewSet,
    config::TrainConfig,
    scene::cones::{Division, PixelPattern},
};

/// The scales of a training set, and the schedules by which they share the pixels of a step.
#[derive(Clone, Debug)]
pub struct ScaleSampling {
    scales: Vec<Scale>,
    /// For each scale, the cones into which a pixel is divided when it is rendered.
    patterns: Vec<PixelPattern>,
    train: TrainConfig,
}

impl ScaleSampling {
    /// Creates the sampling of the scales of `views`. The views and the configuration's box must be in the same
    /// coordinates.
    pub fn new(config: &Config, views: &ViewSet) -> Self {
        let patterns = Division::new(config).patterns(views);
        Self { scales: views.scales.clone(), patterns, train: config.train.clone() }
    }

    /// Returns the weights of the scales at `progress` in [0, 1].
    pub fn at(&self, progress: f64) -> ScaleWeights {
        let most = self.train.cones.at(progress) as u32;
        let patterns = self.patterns.iter().map(|pattern| pattern.within(most)).collect();
        let finest = self.train.finest_scale.at(progress) as usize;
        ScaleWeights::new(&self.scales, self.train.scale_weighting.at(progress), finest, patterns)
    }
}

/// Pixels, loss weight and cones of each scale.
///
/// A scale of area weight w = 4^j has 1/w of the finest scale's pixels. At balance b the scale's fraction of a step's
/// pixels is proportional to w^(b−1), and each of its pixels has the loss weight w^(1−b). The expected loss is the same
/// at every b and weights all scales equally. At b = 0 all pixels are equally likely (as in the paper), and the
/// gradient of coarse scales comes from few pixels. At b = 1 all scales get equally many pixels, which minimises the
/// variance if the scales have equal variance. The finest scales can be left out (`train.finest_scale`).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScaleWeights {
    fractions: Vec<f64>,
    weights: Vec<f32>,
    patterns: Vec<PixelPattern>,
}

impl ScaleWeights {
    /// Computes the weights of `scales`, fine to coarse, at balance `balance` in [0, 1]; `patterns` are the cones of a
    /// pixel at each scale. A scale gets no pixels of a step if it has none or if its index is below `finest`, except
    /// that the coarsest scale with pixels stays in use.
    pub fn new(scales: &[Scale], balance: f64, finest: usize, patterns: Vec<PixelPattern>) -> Self {
        let weight = |scale: &Scale| f64::from(scale.weight);
        let coarsest = scales.iter().rposition(|scale| !scale.pixels.is_empty()).unwrap_or(0);
        let fraction = |(index, scale): (usize, &Scale)| match scale.pixels.is_empty() {
            false if index >= finest.min(coarsest) => weight(scale).powf(balance - 1.0),
            _ => 0.0,
        };
        let sum: f64 = scales.iter().enumerate().map(fraction).sum();
        Self {
            fractions: scales.iter().enumerate().map(|scale| fraction(scale) / sum).collect(),
            weights: scales.iter().map(|scale| weight(scale).powf(1.0 - balance) as f32).collect(),
            patterns,
        }
    }

    /// Divides a step of `pixels` pixels among the scales: coarse scales take their rounded-down fractions from the
    /// end, and the finest scale that has a fraction takes the rest.
    pub fn allocate(&self, pixels: u32) -> RayAllocation {
        let mut begins = vec![0; self.fractions.len()];
        let mut end = pixels;
        let finest = self.fractions.iter().position(|fraction| *fraction > 0.0).unwrap_or(0);
        for (scale, fraction) in self.fractions.iter().enumerate().skip(finest + 1).rev() {
            end -= (f64::from(pixels) * fraction) as u32;
            begins[scale] = end;
        }
        RayAllocation { pixels, begins, patterns: self.patterns.clone() }
    }

    /// Returns the loss weight of a pixel of scale `scale`.
    pub fn weight(&self, scale: usize) -> f32 {
        self.weights[scale]
    }

    /// Returns the loss weight of a pixel of each scale, fine to coarse.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Returns the expected number of cones per pixel.
    pub fn cones_per_pixel(&self) -> f64 {
        if self.patterns.iter().all(|&pattern| pattern == PixelPattern::WHOLE) {
            return 1.0;
        }
        self.fractions
            .iter()
            .zip(&self.patterns)
            .map(|(fraction, pattern)| fraction * f64::from(pattern.count()))
            .sum()
    }
}

/// The pixels of a step, fine scales first, and the cones of each pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct RayAllocation {
    pixels: u32,
    begins: Vec<u32>,
    patterns: Vec<PixelPattern>,
}

impl RayAllocation {
    /// Returns the number of pixels.
    pub fn pixels(&self) -> u32 {
        self.pixels
    }

    /// Returns the number of cones.
    pub fn cones(&self) -> u32 {
        self.cones_before(self.pixels)
    }

    /// Returns the first pixel of each scale.
    pub fn begins(&self) -> &[u32] {
        &self.begins
    }

    /// Returns the cones of a pixel of each scale.
    pub fn patterns(&self) -> &[PixelPattern] {
        &self.patterns
    }

    /// Returns the scale of a pixel.
    #[inline]
    pub fn scale(&self, pixel: u32) -> usize {
        self.begins.iter().rposition(|&begin| pixel >= begin).unwrap_or(0)
    }

    /// Returns the number of cones of all pixels before `pixel`, which is the index of the pixel's first cone.
    pub fn cones_before(&self, pixel: u32) -> u32 {
        self.parts().map(|(begin, end, cones)| (pixel.clamp(begin, end) - begin) * cones).sum()
    }

    /// Returns the first pixel whose cones all have the number `cone` or a higher one.
    pub fn pixel_from(&self, cone: u32) -> u32 {
        let mut before = 0;
        for (begin, end, cones) in self.parts() {
            let pixels = (cone - before).div_ceil(cones);
            if pixels <= end - begin {
                return begin + pixels;
            }
            before += (end - begin) * cones;
        }
        self.pixels
    }

    /// Returns, for each scale, its first pixel, the end of its pixels, and the number of cones per pixel.
    fn parts(&self) -> impl Iterator<Item = (u32, u32, u32)> + '_ {
        let ends = self.begins.iter().copied().skip(1).chain([self.pixels]);
        let scales = self.begins.iter().zip(ends).zip(&self.patterns);
        scales.map(|((&begin, end), pattern)| (begin, end, pattern.count()))
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

    fn balance(scales: &[Scale], balance: f64) -> ScaleWeights {
        ScaleWeights::new(scales, balance, 0, vec![PixelPattern::WHOLE; scales.len()])
    }

    /// Returns the number of pixels of each scale.
    fn pixels(balance: &ScaleWeights, total: u32) -> Vec<u32> {
        let begins = [balance.allocate(total).begins(), &[total]].concat();
        begins.windows(2).map(|pair| pair[1] - pair[0]).collect()
    }

    #[test]
    fn every_scale_weighs_the_same_at_every_balance() {
        for b in [0.0, 0.3, 0.5, 1.0] {
            let found = balance(&scales(4), b);
            let parts: Vec<f64> = found
                .fractions
                .iter()
                .zip(&found.weights)
                .map(|(fraction, w)| fraction * f64::from(*w))
                .collect();
            assert!(parts.iter().all(|part| (part / parts[0] - 1.0).abs() < 1e-6), "{b}: {parts:?}");
            assert!((found.fractions.iter().sum::<f64>() - 1.0).abs() < 1e-12);
        }
    }

    #[test]
    fn the_ends_are_pixels_alike_and_scales_alike() {
        let equal = balance(&scales(4), 0.0);
        assert_eq!(pixels(&equal, 8500), [6400, 1600, 400, 100]);
        assert_eq!(equal.weights(), [1.0, 4.0, 16.0, 64.0]);
        let alike = balance(&scales(4), 1.0);
        assert_eq!(pixels(&alike, 8500), [2125; 4]);
        assert_eq!(alike.weights(), [1.0; 4]);
    }

    #[test]
    fn a_scale_without_pixels_gets_none() {
        let mut three = scales(3);
        three[1].pixels = 0..0;
        assert_eq!(pixels(&balance(&three, 1.0), 100), [50, 0, 50]);
    }

    #[test]
    fn fine_scales_are_left_out_and_the_coarsest_never() {
        let of = |finest, count| {
            ScaleWeights::new(&scales(count), 0.0, finest, vec![PixelPattern::WHOLE; count as usize])
        };
        assert_eq!(pixels(&of(1, 4), 2103), [0, 1603, 400, 100]);
        assert_eq!(pixels(&of(2, 4), 500), [0, 0, 400, 100]);
        assert_eq!(pixels(&of(7, 3), 500), [0, 0, 500]);
        assert_eq!((0..2103).map(|i| of(1, 4).allocate(2103).scale(i)).min(), Some(1));
        let mut empty = scales(3);
        empty[2].pixels = 0..0;
        let left = ScaleWeights::new(&empty, 0.5, 2, vec![PixelPattern::WHOLE; 3]);
        assert_eq!(pixels(&left, 500), [0, 500, 0]);
    }

    #[test]
    fn cones_are_counted_pixel_by_pixel() {
        let balance = ScaleWeights::new(&scales(4), 1.0, 0, [1, 1, 2, 3].map(PixelPattern::Grid).to_vec());
        assert!((balance.cones_per_pixel() - 3.75).abs() < 1e-12);
        let allocation = balance.allocate(42);
        assert_eq!((allocation.begins(), allocation.cones()), (&[0, 12, 22, 32][..], 22 + 40 + 90));
        // The expected values come from counting the cones pixel by pixel.
        let mut before = 0;
        for pixel in 0..42 {
            assert_eq!(allocation.cones_before(pixel), before);
            let own = [1, 1, 4, 9][allocation.scale(pixel)];
            assert_eq!(allocation.pixel_from(before), pixel);
            for cone in before + 1..=before + own {
                assert_eq!(allocation.pixel_from(cone), pixel + 1, "cone {cone}");
            }
            before += own;
        }
        assert_eq!((allocation.cones_before(42), allocation.pixel_from(before)), (before, 42));
    }

    #[test]
    fn scales_get_the_cones_of_the_rule_within_the_schedule() {
        let mut config = Config::default();
        let views = |factor: u32| crate::View {
            name: String::new(),
            camera: crate::Camera {
                intrinsics: crate::Intrinsics::from_angle(64, 64, 0.7).reduced(factor),
                rotation: glam::DMat3::IDENTITY,
                origin: glam::DVec3::new(0.0, 0.0, 4.0),
            },
            offset: 0,
        };
        let set = ViewSet {
            views: (0..4).map(views).collect(),
            pixels: Vec::new().into(),
            alpha: crate::Alpha::Straight,
            depths: Vec::new(),
            scales: (0..4).map(|j| Scale { views: j..j + 1, ..scales(4)[j].clone() }).collect(),
        };
        let finest = crate::scene::cones::footprint(&set.views[0].camera, &crate::Aabb::new(&config.scene));
        (config.renderer.cones, config.renderer.cone_width) = (8, 2.0 * finest as f32);
        config.train.cones =
            crate::config::schedule::Schedule::new(vec![[0.0, 1.0], [0.25, 2.0], [0.5, 8.0]]);
        let fractions = ScaleSampling::new(&config, &set);
        let found = [0.0, 0.3, 0.6].map(|progress| fractions.at(progress).allocate(4).patterns().to_vec());
        let sides = [[1, 1, 1, 1], [1, 1, 2, 2], [1, 1, 2, 4]];
        assert_eq!(found, sides.map(|sides| sides.map(PixelPattern::Grid).to_vec()));
    }
}
