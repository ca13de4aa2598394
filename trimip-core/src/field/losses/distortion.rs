//! The distortion loss of a ray (mip-NeRF 360, Barron et al. 2022, Eq. 15): L = Σ_ij w_i·w_j·|m_i − m_j| + ⅓·Σ_i
//! w_i²·d_i. The loss is small if the weights of a ray are concentrated. Symbols: w is the compositing weight of a
//! sample, m the ray parameter of the sample's midpoint and d the sample's width; m and d are in units of the box's
//! longest side. `loss.distortion` is the weight of the term.

use super::definition::{ConeSamples, Definition, RaySample, RayTerm};
use crate::{
    Config,
    config::LossConfig,
    math::{compositing::weight, scalar::Real},
};

/// The distortion of the weights of a ray's samples.
pub struct Distortion;

impl Definition for Distortion {
    fn name(&self) -> &'static str {
        "distortion"
    }

    fn weight(&self, config: &LossConfig) -> f32 {
        config.distortion
    }

    fn example(&self, config: &mut Config) {
        config.loss.distortion = 0.8;
    }
}

impl RayTerm for Distortion {
    fn evaluate(&self, _: &LossConfig, cone: &ConeSamples<'_, f32>, by_depth: &mut [f32]) -> f32 {
        distortion(cone.samples, |i, derivative| by_depth[i] = derivative)
    }

    fn reference(&self, _: &LossConfig, cone: &ConeSamples<'_, f64>) -> f64 {
        let samples = cone.samples;
        let before = |i: usize| samples[..i].iter().map(|sample| sample.depth).sum::<f64>();
        let w: Vec<_> =
            (0..samples.len()).map(|i| (-before(i)).exp() * -(-samples[i].depth).exp_m1()).collect();
        let mut sum = 0.0;
        for (i, a) in samples.iter().enumerate() {
            for (j, b) in samples.iter().enumerate() {
                sum += w[i] * w[j] * (a.place - b.place).abs();
            }
            sum += w[i] * w[i] * a.width / 3.0;
        }
        sum
    }
}

/// Returns the loss of samples, front to back, and calls `out(i, ∂L/∂x_i)` in the order of the samples. Without samples
/// the loss is 0.
///
/// The positions m are sorted, so the sums over the samples in front of and behind a sample follow from the sums of its
/// neighbour (Sun et al. 2022, DVGO v2): ∂L/∂w_i = 2·Σ_j w_j·|m_i − m_j| + ⅔·w_i·d_i. The derivatives with respect to
/// x_i then equal the derivatives of one colour channel of a pixel: sample i has the colour ∂L/∂w_i there, and the
/// background is 0. The value of this channel is Σ w_i·∂L/∂w_i = 2·L. See
/// [`composite_gradient`](crate::math::compositing::composite_gradient), also for the bound on the colour that a sample
/// hides.
#[inline]
pub fn distortion<R: Real>(samples: &[RaySample<R>], mut out: impl FnMut(usize, R)) -> R {
    let (two, third) = (R::from_f64(2.0), R::from_f64(1.0 / 3.0));
    // Σ_j w_j·(m_j − m_0), and Σ_j w_j.
    let (mut value, mut behind, mut total) = (R::zero(), R::zero(), R::zero());
    let mut widest = R::zero();
    let mut walk = Walk::new();
    for sample in samples {
        widest = widest.max(sample.width);
        walk.advance(sample);
        value += walk.weight * (two * walk.in_front + third * walk.weight * sample.width);
        behind += walk.weight * walk.from_first;
        total += walk.weight;
    }
    let mut hidden = two * value;
    let most_by_weight = two * (walk.from_first + widest);
    let mut walk = Walk::new();
    for (i, sample) in samples.iter().enumerate() {
        walk.advance(sample);
        behind = behind - (total - walk.before) * walk.gap;
        let by_weight = two * (walk.in_front + behind + third * walk.weight * sample.width);
        hidden = hidden - walk.weight * by_weight;
        out(
            i,
            walk.transmittance * by_weight - hidden.max(R::zero()).min(walk.transmittance * most_by_weight),
        );
    }
    value
}

/// A sample, and sums over the samples in front of it.
struct Walk<R> {
    /// w_i.
    weight: R,
    /// Transmittance behind the sample.
    transmittance: R,
    /// Optical depth of the samples up to and including this one.
    depth: R,
    place: R,
    /// m_i − m_{i−1}; 0 at the first sample.
    gap: R,
    /// m_i − m_0.
    from_first: R,
    /// Σ_{j<i} w_j.
    before: R,
    /// Σ_{j<i} w_j·(m_i − m_j).
    in_front: R,
    begun: bool,
}

impl<R: Real> Walk<R> {
    fn new() -> Self {
        let o = R::zero();
        Self {
            weight: o,
            transmittance: R::one(),
            depth: o,
            place: o,
            gap: o,
            from_first: o,
            before: o,
            in_front: o,
            begun: false,
        }
    }

    /// Moves on to the next sample.
    #[inline(always)]
    fn advance(&mut self, sample: &RaySample<R>) {
        self.gap = if self.begun { sample.place - self.place } else { R::zero() };
        (self.begun, self.place) = (true, sample.place);
        self.before += self.weight;
        self.from_first += self.gap;
        self.in_front += self.before * self.gap;
        self.weight = weight(self.transmittance, sample.depth).0;
        self.depth += sample.depth;
        self.transmittance = (-self.depth).exp();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::engine::batch::Target;

    /// Returns samples of all thicknesses at uneven positions; two samples share a position.
    fn ray() -> Vec<RaySample<f64>> {
        let part = |i: u32| {
            let x = f64::from(i);
            RaySample {
                t: x,
                length: 0.1,
                depth: (1.7 * x).sin().powi(2) * 0.5,
                place: 0.2 + 0.03 * x + 0.02 * x.cos(),
                width: 0.01 + 0.002 * x,
            }
        };
        let mut parts: Vec<_> = (0..14).map(part).collect();
        parts[6].place = parts[5].place;
        parts[9].depth = 1e-9;
        parts
    }

    fn weights(parts: &[RaySample<f64>]) -> Vec<f64> {
        let before = |i: usize| parts[..i].iter().map(|part| part.depth).sum::<f64>();
        (0..parts.len()).map(|i| (-before(i)).exp() * (1.0 - (-parts[i].depth).exp())).collect()
    }

    /// Computes Eq. 15 as written, over all pairs.
    fn literal(samples: &[RaySample<f64>]) -> f64 {
        let target = &Target::default();
        Distortion.reference(&Config::default().loss, &ConeSamples { target, samples })
    }

    fn found<R: Real>(parts: &[RaySample<R>]) -> (R, Vec<R>) {
        let mut gradient = Vec::new();
        let value = distortion(parts, |i, by_depth| {
            assert_eq!(i, gradient.len());
            gradient.push(by_depth);
        });
        (value, gradient)
    }

    #[test]
    fn the_sum_over_all_pairs_and_its_derivatives() {
        let parts = ray();
        let (value, gradient) = found(&parts);
        let w = weights(&parts);
        assert!((value - literal(&parts)).abs() < 1e-15, "{value}");
        for i in 0..parts.len() {
            let h = 1e-6;
            let at = |by: f64| {
                let mut parts = parts.clone();
                parts[i].depth += by;
                literal(&parts)
            };
            let expected = (at(h) - at(-h)) / (2.0 * h);
            assert!((gradient[i] - expected).abs() < 1e-9, "{i}: {}, not {expected}", gradient[i]);
            // The chain rule as written: ∂w_i/∂x_i = T_{i+1}, and ∂w_j/∂x_i = −w_j for every sample j behind sample i.
            let by_weight = |i: usize| {
                let pairs = |j: usize| w[j] * (parts[i].place - parts[j].place).abs();
                2.0 * (0..w.len()).map(pairs).sum::<f64>() + 2.0 / 3.0 * w[i] * parts[i].width
            };
            let after = (-parts[..=i].iter().map(|part| part.depth).sum::<f64>()).exp();
            let hidden: f64 = (i + 1..w.len()).map(|j| w[j] * by_weight(j)).sum();
            assert!((gradient[i] - (after * by_weight(i) - hidden)).abs() < 1e-14, "{i}");
        }
    }

    #[test]
    fn one_sample_has_its_width_alone_and_none_nothing() {
        assert_eq!(found::<f64>(&[]), (0.0, vec![]));
        let part = RaySample { t: 1.0, length: 0.1, depth: 0.7, place: 0.4, width: 0.03 };
        let w = 1.0 - (-0.7_f64).exp();
        let (value, gradient) = found(&[part]);
        assert!((value - w * w * 0.03 / 3.0).abs() < 1e-17);
        assert!((gradient[0] - 2.0 / 3.0 * w * 0.03 * (1.0 - w)).abs() < 1e-17);
    }

    /// Checks that moving all samples changes nothing, and that stretching a ray stretches its loss.
    #[test]
    fn only_differences_of_places_count() {
        let (value, gradient) = found(&ray());
        let mut moved = ray();
        moved.iter_mut().for_each(|part| part.place += 3.0);
        let mut stretched = ray();
        stretched.iter_mut().for_each(|part| (part.place, part.width) = (4.0 * part.place, 4.0 * part.width));
        for (other, factor) in [(found(&moved), 1.0), (found(&stretched), 4.0)] {
            assert!((other.0 - factor * value).abs() < 1e-14);
            assert!(other.1.iter().zip(&gradient).all(|(a, b)| (a - factor * b).abs() < 1e-14));
        }
    }

    /// Checks that rounding errors do not enlarge the gradient of an opaque sample: the gradient goes to 0, and so does
    /// its product with the depth.
    #[test]
    fn opaque_samples_have_no_gradient() {
        let part =
            |i: u32, depth| RaySample { t: 1.0, length: 0.1, depth, place: 0.137 * i as f32, width: 0.071 };
        for (k, depth) in (0..90_u8).zip([30.0_f32, 1e4, 1e10].into_iter().cycle()) {
            let thin = 0.011 * f32::from(k);
            let parts = [part(0, thin), part(1, 0.07), part(2, depth), part(3, 0.9), part(4, 0.2)];
            let (_, gradient) = found(&parts);
            for (part, by_depth) in parts.iter().zip(gradient).skip(2) {
                assert!((by_depth * part.depth).abs() < 1e-5, "{part:?}: {by_depth}");
            }
        }
    }

    #[test]
    fn single_precision_is_near_and_extremes_stay_finite() {
        let narrow = |part: &RaySample<f64>| RaySample {
            t: part.t as f32,
            length: part.length as f32,
            depth: part.depth as f32,
            place: part.place as f32,
            width: part.width as f32,
        };
        let (value, gradient) = found(&ray());
        let (near, by_depth) = found(&ray().iter().map(narrow).collect::<Vec<_>>());
        assert!((f64::from(near) - value).abs() < 1e-6 * value);
        assert!(by_depth.iter().zip(gradient).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-6));
        let part = |depth, place| RaySample { t: place, length: 0.1, depth, place, width: 0.1 };
        for parts in [
            vec![part(f32::MAX, 0.1), part(f32::MAX, 0.2)],
            vec![part(0.0, 0.0), part(1e-38, 0.5), part(0.0, 1.0)],
            vec![part(1e30, 0.3); 5],
        ] {
            let (value, gradient) = found(&parts);
            assert!(
                value.is_finite() && gradient.iter().all(|g| g.is_finite()),
                "{parts:?}: {value} {gradient:?}"
            );
        }
    }
}
