//! The depth term of a ray: the compositing weights should lie where a point of the scene is known to be (DS-NeRF, Deng
//! et al. 2022, arXiv 2107.02791, extended by a probability that the point is wrong). L = −ln((π + S) / (1 + π)), S = Σ
//! w_i·exp(−(t_i − D)² / (2·(s² + δ_i²))). Symbols: w is the compositing weight of a sample, t the sample's distance, δ
//! its length, D the distance of the point and s the point's standard deviation; lengths are in world units. S is the
//! probability that the ray ends at the point, π (`loss.depth_outliers`) the odds that the point is wrong: the
//! derivative with respect to S is at most 1/π, so a wrong point has little influence. `loss.depth` is the schedule of
//! the term's weight. Pixels without a point do not have this term.

use super::definition::{ConeSamples, Definition, RaySample, RayTerm};
use crate::config::schedule::Schedule;
use crate::geometry::elements::Target;
use crate::{
    Config,
    config::LossConfig,
    math::{compositing::weight, scalar::Real},
};

/// The probability that rays end at known points.
pub struct Depth;

impl Definition for Depth {
    fn name(&self) -> &'static str {
        "depth"
    }

    fn weight(&self, config: &LossConfig) -> f32 {
        self.weight_at(config, 0.0)
    }

    fn weight_at(&self, config: &LossConfig, progress: f64) -> f32 {
        config.depth.at(progress) as f32
    }

    fn numbers(&self, config: &LossConfig) -> [f32; 3] {
        [config.depth_outliers, 0.0, 0.0]
    }

    fn example(&self, config: &mut Config) {
        config.loss.depth = Schedule::new(vec![[0.0, 0.6]]);
        config.loss.depth_outliers = 0.2;
    }
}

impl RayTerm for Depth {
    fn evaluate(&self, config: &LossConfig, cone: &ConeSamples<'_, f32>, by_depth: &mut [f32]) -> f32 {
        let Target { distance, deviation, .. } = *cone.target;
        if deviation == 0.0 {
            return 0.0;
        }
        depth(cone.samples, [distance, deviation], config.depth_outliers, by_depth)
    }

    fn reference(&self, config: &LossConfig, cone: &ConeSamples<'_, f64>) -> f64 {
        let [distance, deviation] = [cone.target.distance, cone.target.deviation].map(f64::from);
        if deviation == 0.0 {
            return 0.0;
        }
        let samples = cone.samples;
        let before = |i: usize| samples[..i].iter().map(|sample| sample.depth).sum::<f64>();
        let ends = |i: usize| {
            let RaySample { depth, t, length, .. } = samples[i];
            let squared = (t - distance).powi(2) / (deviation.powi(2) + length.powi(2));
            (-before(i)).exp() * -(-depth).exp_m1() * (-squared / 2.0).exp()
        };
        let odds = f64::from(config.depth_outliers);
        -((odds + (0..samples.len()).map(ends).sum::<f64>()) / (1.0 + odds)).ln()
    }
}

/// Returns the loss of a ray's samples, front to back; `point` is the distance and standard deviation of the ray's
/// point, and `by_depth[i]` becomes ∂L/∂x_i. S is composited like a colour channel of the pixel: the colour of sample i
/// is its Gaussian, and the background is 0. See [`composite_gradient`](crate::math::compositing::composite_gradient).
#[inline]
pub fn depth<R: Real>(samples: &[RaySample<R>], point: [R; 2], odds: R, by_depth: &mut [R]) -> R {
    let mut total = R::zero();
    walk(samples, point, |_, weight, _, near| total += weight * near);
    let slope = -(odds + total).recip();
    let mut hidden = total;
    walk(samples, point, |i, weight, transmittance, near| {
        hidden = hidden - weight * near;
        by_depth[i] = slope * (transmittance * near - hidden.max(R::zero()).min(transmittance));
    });
    -((odds + total) / (R::one() + odds)).ln()
}

/// Calls `visit(i, w_i, transmittance behind the sample, its Gaussian)` for every sample.
#[inline(always)]
fn walk<R: Real>(
    samples: &[RaySample<R>],
    [distance, deviation]: [R; 2],
    mut visit: impl FnMut(usize, R, R, R),
) {
    let half = R::from_f64(0.5);
    let (mut x, mut transmittance) = (R::zero(), R::one());
    for (i, sample) in samples.iter().enumerate() {
        let off = sample.t - distance;
        let variance = deviation * deviation + sample.length * sample.length;
        let own = weight(transmittance, sample.depth).0;
        x += sample.depth;
        transmittance = (-x).exp();
        visit(i, own, transmittance, (-half * off * off / variance).exp());
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a wall of one sample at distance `t` behind thin air.
    fn wall(t: f64) -> Vec<RaySample<f64>> {
        let sample = |i: u32| {
            let at = 1.0 + 0.1 * f64::from(i);
            let depth = if (at - t).abs() < 0.05 { 9.0 } else { 1e-3 };
            RaySample { depth, t: at, length: 0.1, place: at, width: 0.1 }
        };
        (0..40).map(sample).collect()
    }

    fn found(samples: &[RaySample<f64>], distance: f64) -> (f64, Vec<f64>) {
        let mut by_depth = vec![0.0; samples.len()];
        let value = depth(samples, [distance, 0.05], 0.1, &mut by_depth);
        (value, by_depth)
    }

    #[test]
    fn a_ray_that_ends_at_its_point_has_no_loss() {
        assert!(found(&wall(3.0), 3.0).0 < 0.03, "{}", found(&wall(3.0), 3.0).0);
        // The loss is −ln(0.1 / 1.1) if no weight is near the point, however far away the point is.
        for distance in [2.0, 4.5, 1e9] {
            let value = found(&wall(3.0), distance).0;
            assert!((value - 11.0_f64.ln()).abs() < 0.05, "{distance}: {value}");
        }
    }

    /// Checks that rounding errors do not enlarge the gradient of an opaque sample: the gradient goes to 0, and so does
    /// its product with the depth.
    #[test]
    fn opaque_samples_have_no_gradient() {
        let sample = |i: u32, depth| {
            let at = 2.0 + 0.1 * i as f32;
            RaySample { depth, t: at, length: 0.1, place: at, width: 0.1 }
        };
        for (k, opaque) in (0..90_u8).zip([30.0_f32, 1e4, 1e10].into_iter().cycle()) {
            let thin = 0.011 * f32::from(k);
            let samples = [sample(0, thin), sample(1, 0.07), sample(2, opaque), sample(3, 0.9)];
            let mut by_depth = [0.0; 4];
            depth(&samples, [2.1, 0.15], 0.1, &mut by_depth);
            for (sample, by_depth) in samples.iter().zip(by_depth).skip(2) {
                assert!((by_depth * sample.depth).abs() < 1e-5, "{sample:?}: {by_depth}");
            }
        }
    }

    #[test]
    fn density_in_front_of_a_point_and_behind_it_is_driven_away() {
        let (_, by_depth) = found(&wall(2.0), 3.0);
        assert!(by_depth[10] > 0.0 && by_depth[5] >= 0.0, "the wall in front: {by_depth:?}");
        let (_, by_depth) = found(&wall(4.0), 3.0);
        assert!(by_depth[20] < 0.0, "the point itself: {by_depth:?}");
        assert!(by_depth[5] > 0.0 && by_depth[15] > 0.0, "what is in front: {by_depth:?}");
    }

    #[test]
    fn extremes_stay_finite() {
        let sample = |depth: f32, t: f32| RaySample { depth, t, length: 1e-3, place: t, width: 0.1 };
        for samples in [vec![], vec![sample(f32::MAX, 0.1), sample(1e30, 0.2)], vec![sample(0.0, 1.0); 3]] {
            for distance in [0.0, 0.1, 1e30] {
                let mut by_depth = vec![0.0; samples.len()];
                let value = depth(&samples, [distance, 1e-6], 1e-3, &mut by_depth);
                assert!(value.is_finite() && value >= -1e-6, "{samples:?}: {value}");
                assert!(by_depth.iter().all(|x| x.is_finite()), "{samples:?}: {by_depth:?}");
            }
        }
    }
}
