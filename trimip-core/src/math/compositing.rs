//! Volume rendering along one ray (NeRF Eq. 3), with its gradient. Letters: x = σ·δ optical depth of a sample,
//! α = 1 − exp(−x), T transmittance before the sample, w = T·α, C = Σ w·c + T_end·background.

use crate::math::scalar::Real;

/// A composited ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Composite<R> {
    /// Colour on the background.
    pub rgb: [R; 3],
    /// 1 − T_end, in [0, 1].
    pub opacity: R,
    /// Σ w·t.
    pub distance: R,
}

impl<R: Real> Composite<R> {
    /// Returns [r, g, b, opacity].
    pub fn channels(&self) -> [R; 4] {
        let [r, g, b] = self.rgb;
        [r, g, b, self.opacity]
    }
}

/// Upper bound of a colour: a field without networks can have colours above 1.
pub const BRIGHTEST: f64 = 1024.0;

/// Returns the weight of a sample of optical depth `depth` behind transmittance `transmittance`, and the transmittance
/// behind the sample. `exp_m1` computes α, so that thin samples keep their relative accuracy.
#[inline]
pub fn weight<R: Real>(transmittance: R, depth: R) -> (R, R) {
    let alpha = -(-depth).exp_m1();
    (transmittance * alpha, transmittance * (-depth).exp())
}

/// Rule that selects the samples that get a colour. Samples behind an opaque one are dropped. A faint sample merges with the next
/// sample of its ray.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pruning<R> {
    /// Optical depth behind which samples are dropped: −ln of the minimum transmittance, or of the minimum weight if that
    /// is larger, because no weight exceeds the transmittance in front of its sample.
    pub max_depth: R,
    /// Weight up to which samples merge: they merge until T·(1 − exp(−Σ x)) reaches it. The last of the merged samples is
    /// kept, with the optical depth of all of them. Faint samples left at the end of a ray have less weight than this
    /// together, and are dropped.
    pub min_weight: R,
}

/// The optical depths that a ray has passed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Passed<R> {
    /// Optical depth of the kept samples, merged ones included.
    pub depth: R,
    /// Optical depth of the faint samples since the last kept sample. They merge with the next kept sample.
    pub faint: R,
    /// Optical depth below which a sample behind `depth` is faint. A sample of exactly this optical depth has the minimum
    /// weight.
    least: R,
}

/// Decision about a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Visibility<R> {
    /// The sample is kept. It represents an interval that is this many times (at least 1) as long as its own.
    Keep(R),
    /// The sample is dropped, and its optical depth is added to the next sample.
    Merge,
    /// The sample and all samples behind it are dropped.
    Terminate,
}

impl<R: Real> Pruning<R> {
    /// Returns the rule for a minimum transmittance and a minimum weight.
    pub fn new(min_transmittance: R, min_weight: R) -> Self {
        Self { max_depth: -min_transmittance.max(min_weight).ln(), min_weight }
    }

    /// Returns the state of a ray behind kept samples with a total optical depth of `depth`. A ray begins with 0.
    #[inline]
    pub fn behind(&self, depth: R) -> Passed<R> {
        // T·(1 − exp(−x)) = min_weight, solved for x, with T = exp(−depth).
        let least = -(-self.min_weight * depth.exp()).ln_1p();
        Passed { depth, faint: R::zero(), least }
    }

    /// Decides whether a sample of optical depth `depth` is kept, and adds the sample to `passed`.
    #[inline]
    pub fn decide(&self, passed: &mut Passed<R>, depth: R) -> Visibility<R> {
        if passed.depth > self.max_depth {
            return Visibility::Terminate;
        }
        let all = passed.faint + depth;
        // The comparison is false for NaN: such a sample is kept, and the step reports it.
        if all < passed.least {
            passed.faint = all;
            return Visibility::Merge;
        }
        let factor = if passed.faint > R::zero() { all / depth } else { R::one() };
        *passed = self.behind(passed.depth + all);
        Visibility::Keep(factor)
    }
}

/// Returns true if a sample of optical depth `depth` has at least the weight `least`. `before` is the optical depth in
/// front of the sample; the function adds the sample's own to it.
#[inline]
pub fn is_lit<R: Real>(before: &mut R, depth: R, least: R) -> bool {
    let transmittance = (-*before).exp();
    *before += depth;
    // The comparison is false for NaN: such a sample has a colour, and the step reports it.
    !(weight(transmittance, depth).0 < least)
}

/// Composites samples, given as optical depth, colour and distance, front to back.
#[inline]
pub fn composite<R: Real>(samples: impl Iterator<Item = (R, [R; 3], R)>, background: [R; 3]) -> Composite<R> {
    let (mut rgb, mut opacity, mut distance) = ([R::zero(); 3], R::zero(), R::zero());
    let mut depth_before = R::zero();
    let mut transmittance = R::one();
    for (depth, color, t) in samples {
        let (w, _) = weight(transmittance, depth);
        for (sum, c) in rgb.iter_mut().zip(color) {
            *sum += w * c;
        }
        opacity += w;
        distance += w * t;
        depth_before += depth;
        transmittance = (-depth_before).exp();
    }
    for (sum, c) in rgb.iter_mut().zip(background) {
        *sum += transmittance * c;
    }
    Composite { rgb, opacity: opacity.min(R::one()), distance }
}

/// Computes the gradient of a loss with respect to each sample from the loss' `gradient` with respect to the `pixel` [r, g,
/// b, opacity]. Calls `out(i, ∂L/∂x_i, ∂L/∂c_i)` front to back; `sample(i)` returns (x_i, c_i).
///
/// ∂C/∂x_i = T_{i+1}·c_i − Σ_{k>i} w_k·c_k − T_end·background: the colour that the sample shows minus the colours that it
/// hides. Opacity is the fourth channel, 1 for every sample and 0 for the background.
///
/// The sum behind a sample is computed by subtraction, which leaves a rounding error behind an opaque sample. The true sum is at most
/// the transmittance times the brightest colour, so the computed one is clamped to this bound. Without the clamp, an opaque sample
/// would have a gradient of that error times its density.
#[inline]
pub fn composite_gradient<R: Real>(
    count: usize,
    sample: impl Fn(usize) -> (R, [R; 3]),
    pixel: [R; 4],
    gradient: [R; 4],
    mut out: impl FnMut(usize, R, [R; 3]),
) {
    let [r, g, b, opacity] = gradient;
    let shade = |[red, green, blue]: [R; 3], fraction: R| red * r + green * g + blue * b + fraction * opacity;
    let brightest = R::from_f64(BRIGHTEST) * gradient.iter().fold(R::zero(), |sum, g| sum + g.abs());
    // The contribution of everything behind the sample, including the background; at first the whole pixel.
    let mut behind = shade([pixel[0], pixel[1], pixel[2]], pixel[3]);
    let mut transmittance = R::one();
    let mut depth_before = R::zero();
    for i in 0..count {
        let (depth, color) = sample(i);
        let shade = shade(color, R::one());
        let (w, _) = weight(transmittance, depth);
        depth_before += depth;
        transmittance = (-depth_before).exp();
        behind = behind - w * shade;
        let most = transmittance * brightest;
        out(i, transmittance * shade - behind.max(-most).min(most), [r, g, b].map(|g| g * w));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Optical depth, colour and distance.
    type Sample = (f64, [f64; 3], f64);

    fn ray() -> (Vec<Sample>, [f64; 3]) {
        let samples = (0..12)
            .map(|i| {
                let x = f64::from(i);
                ((0.7 * x).sin().powi(2) * 0.4, [0.1 + 0.05 * x, (x * 0.3).cos().abs(), 0.5], 2.0 + 0.1 * x)
            })
            .collect();
        (samples, [0.9, 0.2, 1.0])
    }

    #[test]
    fn the_literal_sums_agree() {
        let (samples, background) = ray();
        let result = composite(samples.iter().copied(), background);
        let mut expected = [0.0; 3];
        let mut weights = 0.0;
        for i in 0..samples.len() {
            // T_i = exp(−Σ_{k<i} σ_k·δ_k), α_i = 1 − exp(−σ_i·δ_i)
            let transmittance = (-samples[..i].iter().map(|s| s.0).sum::<f64>()).exp();
            let w = transmittance * (1.0 - (-samples[i].0).exp());
            weights += w;
            for c in 0..3 {
                expected[c] += w * samples[i].1[c];
            }
        }
        for c in 0..3 {
            expected[c] += (1.0 - weights) * background[c];
            assert!((result.rgb[c] - expected[c]).abs() < 1e-12);
        }
        assert!((result.opacity - weights).abs() < 1e-12);
    }

    #[test]
    fn gradients_are_finite_differences() {
        let (samples, background) = ray();
        let g = [0.3, -1.2, 0.7, 0.4];
        let pixel = |samples: &[Sample]| composite(samples.iter().copied(), background).channels();
        let loss = |samples: &[Sample]| -> f64 {
            let pixel = pixel(samples);
            (0..4).map(|k| pixel[k] * g[k]).sum()
        };
        let mut seen = 0;
        composite_gradient(
            samples.len(),
            |i| (samples[i].0, samples[i].1),
            pixel(&samples),
            g,
            |i, by_depth, by_color| {
                let h = 1e-6;
                let numeric = |change: &dyn Fn(&mut Sample, f64)| {
                    let (mut up, mut down) = (samples.clone(), samples.clone());
                    change(&mut up[i], h);
                    change(&mut down[i], -h);
                    (loss(&up) - loss(&down)) / (2.0 * h)
                };
                assert!((by_depth - numeric(&|s, h| s.0 += h)).abs() < 1e-8, "depth {i}");
                for c in 0..3 {
                    assert!((by_color[c] - numeric(&|s, h| s.1[c] += h)).abs() < 1e-8, "color {i}");
                }
                seen += 1;
            },
        );
        assert_eq!(seen, samples.len());
    }

    #[test]
    fn a_homogeneous_medium_follows_beer_and_lambert_however_it_is_cut() {
        for count in [1_u32, 7, 1000] {
            let x = 1.3 / f64::from(count);
            let result = composite((0..count).map(|_| (x, [1.0, 0.5, 0.0], 1.0)), [0.0; 3]);
            assert!((result.opacity - (1.0 - (-1.3_f64).exp())).abs() < 1e-12);
            assert!((result.rgb[1] - 0.5 * result.opacity).abs() < 1e-12);
        }
    }

    #[test]
    fn faint_samples_merge_and_hidden_ones_are_dropped() {
        use Visibility::{Keep, Merge, Terminate};
        let pruning = Pruning::new(0.01_f64, 0.05);
        let depths = [0.04, 1.0, 0.0625, 3.0, 2.0, 0.1];
        let mut passed = pruning.behind(0.0);
        let seen = depths.map(|depth| pruning.decide(&mut passed, depth));
        // The weights are 0.039, 1 − e^-1.04 = 0.647, e^-1.04·0.061 = 0.021 and e^-1.04·0.95 = 0.34. The transmittance behind
        // these samples, e^-4.1 = 0.017, is below the minimum weight.
        assert_eq!(seen, [Merge, Keep(1.04), Merge, Keep(3.0625 / 3.0), Terminate, Terminate]);
        let mut passed = pruning.behind(2.9);
        let opaque = pruning.decide(&mut passed, 9.0);
        assert_eq!(opaque, Keep(1.0), "e^-2.9 = 0.055 is enough for an opaque sample");
        let all = Pruning::new(0.01_f64, 0.0);
        let mut passed = all.behind(0.0);
        let seen = [0.0, 4.0, 0.7, 1.0].map(|depth| all.decide(&mut passed, depth));
        assert_eq!(seen, [Keep(1.0), Keep(1.0), Keep(1.0), Terminate]);
        let all = Pruning::new(0.0_f32, 0.0);
        assert_eq!(all.decide(&mut all.behind(1e30), 1.0), Keep(1.0));
    }

    /// Checks that the samples of a medium merge to the same opacity, however thin they are, up to faint samples at the end below
    /// the minimum weight.
    #[test]
    fn merging_keeps_the_optical_depth_of_fog() {
        for (count, total) in [(10_u32, 0.3), (1000, 0.3), (1000, 2.0), (100_000, 0.02)] {
            let pruning = Pruning::new(0.0, 0.01);
            let own = total / f64::from(count);
            let (mut passed, mut depth, mut kept) = (pruning.behind(0.0), 0.0, 0);
            for _ in 0..count {
                if let Visibility::Keep(factor) = pruning.decide(&mut passed, own) {
                    depth += factor * own;
                    kept += 1;
                }
            }
            assert!((depth - passed.depth).abs() < 1e-12 && (depth + passed.faint - total).abs() < 1e-9);
            let lost = (-depth).exp() - (-total).exp();
            assert!((0.0..0.01).contains(&lost), "{count} samples of {total}: {lost} is lost");
            assert!(kept <= 100, "{kept} samples of at least 0.01");
        }
    }

    /// Checks that the gradient of an opaque sample goes to 0, even multiplied by the sample's optical depth: no rounding
    /// error may make it grow.
    #[test]
    fn opaque_samples_have_no_gradient() {
        for depth in [30.0_f32, 1e3, 1e8, 1e30] {
            let samples = [(0.3, [0.2, 0.7, 0.4], 1.0), (depth, [0.9, 0.1, 0.3], 2.0), (0.1, [0.6; 3], 3.0)];
            let pixel = composite(samples.into_iter(), [1.0; 3]).channels();
            let sample = |i: usize| (samples[i].0, samples[i].1);
            composite_gradient(3, sample, pixel, [0.31, -1.27, 0.73, 0.41], |i, by_depth, _| {
                assert!(
                    i == 0 || (by_depth * samples[i].0).abs() < 1e-5,
                    "depth {depth}, sample {i}: {by_depth}"
                );
            });
        }
    }

    #[test]
    fn thin_and_thick_samples_keep_their_accuracy() {
        let (w, after) = weight(1.0_f32, 1e-12);
        assert_eq!((w, after), (1e-12, 1.0));
        let opaque = composite([(1e12_f32, [0.25; 3], 1.0)].into_iter(), [1.0; 3]);
        assert_eq!((opaque.rgb, opaque.opacity), ([0.25; 3], 1.0));
    }
}
