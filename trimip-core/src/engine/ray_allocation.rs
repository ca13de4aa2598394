//! Distribution of a step's pixels over the scales of a set: how many each scale gets, their loss weight, and their
//! cones.

use crate::{
    Config, Scale, ViewSet,
    config::TrainConfig,
    scene::cones::{Division, PixelPattern},
};

/// The scales of a training set, and the schedules by which they share the pixels of a step.
#[derive(Clone, Debug)]
pub struct ScaleSampling {
    scales: Vec<Scale>,
    /// The cones of a pixel of each scale, when it is rendered.
    patterns: Vec<PixelPattern>,
    train: TrainConfig,
}

impl ScaleSampling {
    /// The sampling of the scales of `views`. They and the configuration's box are in the same coordinates.
    pub fn new(config: &Config, views: &ViewSet) -> Self {
        let patterns = Division::new(config).patterns(views);
        Self { scales: views.scales.clone(), patterns, train: config.train.clone() }
    }

    /// The weights of the scales at `progress` in [0, 1].
    pub fn at(&self, progress: f64) -> ScaleWeights {
        let most = self.train.cones.at(progress) as u32;
        let patterns = self.patterns.iter().map(|pattern| pattern.within(most)).collect();
        let finest = self.train.finest_scale.at(progress) as usize;
        ScaleWeights::new(&self.scales, self.train.scale_weighting.at(progress), finest, patterns)
    }
}

/// Pixels, loss weight and cones of each scale.
///
/// A scale of area weight w = 4^j has 1/w of the finest scale's pixels. At balance b its fraction of a step's pixels is
/// ∝ w^(b−1) and each of them has weight w^(1−b). The expected loss is the same at every b, with equal weight for all
/// scales. At 0 all pixels are equally likely (paper), and the gradient of coarse scales comes from few pixels. At 1 all
/// scales get equally many pixels, which minimises the variance if the scales have equal variance. The finest scales can be left
/// out (`train.finest_scale`).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ScaleWeights {
    fractions: Vec<f64>,
    weights: Vec<f32>,
    patterns: Vec<PixelPattern>,
}

impl ScaleWeights {
    /// The weights of `scales`, fine to coarse, at balance `balance` in [0, 1]; `patterns` are the cones of a pixel of
    /// each. Scales without pixels and those before number `finest` get none, except that the coarsest one with pixels
    /// stays in use.
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

    /// Divides a step of `pixels` pixels among the scales: coarse scales take their rounded-down fraction from the end,
    /// the finest that has a fraction the rest.
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

    /// Loss weight of a pixel of scale `scale`.
    pub fn weight(&self, scale: usize) -> f32 {
        self.weights[scale]
    }

    /// Loss weights, fine to coarse.
    pub fn weights(&self) -> &[f32] {
        &self.weights
    }

    /// Expected number of cones of a pixel.
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

/// The pixels of a step, fine scales first, and the cones of each.
#[derive(Clone, Debug, PartialEq)]
pub struct RayAllocation {
    pixels: u32,
    begins: Vec<u32>,
    patterns: Vec<PixelPattern>,
}

impl RayAllocation {
    /// Number of pixels.
    pub fn pixels(&self) -> u32 {
        self.pixels
    }

    /// Number of cones.
    pub fn cones(&self) -> u32 {
        self.cones_before(self.pixels)
    }

    /// The first pixel of each scale.
    pub fn begins(&self) -> &[u32] {
        &self.begins
    }

    /// The cones of a pixel of each scale.
    pub fn patterns(&self) -> &[PixelPattern] {
        &self.patterns
    }

    /// The scale of a pixel.
    #[inline]
    pub fn scale(&self, pixel: u32) -> usize {
        self.begins.iter().rposition(|&begin| pixel >= begin).unwrap_or(0)
    }

    /// Number of cones of all pixels before `pixel`: the index of its first cone.
    pub fn cones_before(&self, pixel: u32) -> u32 {
        self.parts().map(|(begin, end, cones)| (pixel.clamp(begin, end) - begin) * cones).sum()
    }

    /// The first pixel none of whose cones comes before cone number `cone`.
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

    /// First pixel, end, and cones of a pixel of each scale.
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

    /// Pixels of each scale.
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
        // The literal count: each pixel after the other.
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
