//! Deferred shading (SNeRG, Hedman et al. 2021, Section 4): a ray has one colour, computed from the mean of the features of
//! its samples. Letters as in [`compositing`](crate::math::compositing): w_i is the compositing weight of sample i, f_i its
//! features, W = Σ w_i the opacity of the ray, and F = Σ w_i·f_i / W the mean. The pixel is W·colour(F) + T_end·background.

use crate::math::{compositing::weight, scalar::Real};

/// Least opacity of a ray that has a colour. Below it, the divisions by W could overflow in f32.
pub const LEAST_OPACITY: f64 = 1e-30;

/// Writes the fraction w_i / W of each sample of a ray; `depths` are the optical depths of its samples, front to back.
/// Returns W. Below [`LEAST_OPACITY`] all fractions are 0.
pub fn fractions<R: Real>(depths: impl Iterator<Item = R>, fractions: &mut [R]) -> R {
    let (mut sum, mut before, mut transmittance) = (R::zero(), R::zero(), R::one());
    for (depth, out) in depths.zip(fractions.iter_mut()) {
        *out = weight(transmittance, depth).0;
        sum += *out;
        before += depth;
        transmittance = (-before).exp();
    }
    let factor = if sum < R::from_f64(LEAST_OPACITY) { R::zero() } else { sum.recip() };
    fractions.iter_mut().for_each(|fraction| *fraction = *fraction * factor);
    sum
}

/// Maps the gradient of the mean F to the derivatives with respect to the optical depths x_i. `sample(i)` returns x_i, the
/// fraction w_i / W and the slope ∂L/∂F·f_i of sample i; `opacity` is W. Calls `out(i, ∂L/∂x_i)` front to back.
///
/// With u_i = (slope_i − Σ fraction·slope) / W = ∂L/∂w_i: ∂L/∂x_i = T_{i+1}·u_i − Σ_{k>i} w_k·u_k. The sum over all samples
/// is 0, so the sum behind a sample is the negated sum up to it. Its size is at most the transmittance times the largest
/// |u|, and it is clamped to this bound: a rounding error behind an opaque sample would be multiplied by its density.
pub fn mean_gradient<R: Real>(
    count: usize,
    opacity: R,
    sample: impl Fn(usize) -> (R, R, R),
    mut out: impl FnMut(usize, R),
) {
    let mean = (0..count).map(&sample).fold(R::zero(), |sum, (_, fraction, slope)| sum + fraction * slope);
    let largest =
        (0..count).map(&sample).fold(R::zero(), |most, (_, _, slope)| most.max((slope - mean).abs()));
    let (mut passed, mut before) = (R::zero(), R::zero());
    for i in 0..count {
        let (depth, fraction, slope) = sample(i);
        before += depth;
        let light = (-before).exp() / opacity;
        passed += fraction * (slope - mean);
        let most = light * largest;
        out(i, light * (slope - mean) + passed.max(-most).min(most));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Optical depths and features, two per sample.
    fn ray() -> Vec<(f64, [f64; 2])> {
        let sample = |i| {
            let x = f64::from(i);
            ((0.9 * x).sin().powi(2) * 0.6, [(1.3 * x).cos(), 0.2 * x - 1.0])
        };
        (0..9).map(sample).collect()
    }

    fn mean(ray: &[(f64, [f64; 2])]) -> ([f64; 2], f64, Vec<f64>) {
        let mut own = vec![0.0; ray.len()];
        let opacity = fractions(ray.iter().map(|sample| sample.0), &mut own);
        let mean = [0, 1].map(|c| own.iter().zip(ray).map(|(fraction, (_, f))| fraction * f[c]).sum());
        (mean, opacity, own)
    }

    #[test]
    fn the_literal_mean_agrees() {
        let ray = ray();
        let (found, opacity, own) = mean(&ray);
        let weights: Vec<f64> = (0..ray.len())
            .map(|i| {
                let before = ray[..i].iter().map(|sample| sample.0).sum::<f64>();
                (-before).exp() * (1.0 - (-ray[i].0).exp())
            })
            .collect();
        let sum: f64 = weights.iter().sum();
        assert!((opacity - sum).abs() < 1e-14 && (own.iter().sum::<f64>() - 1.0).abs() < 1e-14);
        for c in 0..2 {
            let expected = weights.iter().zip(&ray).map(|(w, (_, f))| w * f[c]).sum::<f64>() / sum;
            assert!((found[c] - expected).abs() < 1e-14);
        }
    }

    #[test]
    fn gradients_are_finite_differences() {
        let (ray, by_mean) = (ray(), [0.7, -1.9]);
        let loss = |ray: &[(f64, [f64; 2])]| {
            let (mean, ..) = mean(ray);
            mean[0] * by_mean[0] + mean[1] * by_mean[1]
        };
        let (_, opacity, own) = mean(&ray);
        let slope = |i: usize| ray[i].1[0] * by_mean[0] + ray[i].1[1] * by_mean[1];
        let mut seen = 0;
        mean_gradient(
            ray.len(),
            opacity,
            |i| (ray[i].0, own[i], slope(i)),
            |i, by_depth| {
                let moved = |h: f64| {
                    let mut ray = ray.clone();
                    ray[i].0 += h;
                    loss(&ray)
                };
                let numeric = (moved(1e-6) - moved(-1e-6)) / 2e-6;
                assert!((by_depth - numeric).abs() < 1e-8, "sample {i}: {by_depth}, not {numeric}");
                seen += 1;
            },
        );
        assert_eq!(seen, ray.len());
    }

    /// Checks that the same features everywhere have no gradient, and that nothing overflows for the thinnest and the
    /// thickest rays.
    #[test]
    fn extreme_rays_are_finite() {
        for depth in [0.0_f32, 1e-38, 1e-31, 1e-29, 1e-6, 1.0, 1e4, 1e30] {
            let (depths, mut own) = ([depth, depth * 0.5, depth * 2.0], [0.0_f32; 3]);
            let opacity = fractions(depths.into_iter(), &mut own);
            assert!(own.iter().all(|fraction| (0.0..=1.0).contains(fraction)), "{depth}: {own:?}");
            if f64::from(opacity) < LEAST_OPACITY {
                assert_eq!(own, [0.0; 3]);
                continue;
            }
            let slopes = [3.0, -7.0, 11.0];
            let sample = |i: usize| (depths[i], own[i], slopes[i]);
            mean_gradient(3, opacity, sample, |i, by_depth| {
                // The gradient of a logit: the density is the exponential of it.
                let by_logit = by_depth * depths[i];
                assert!(by_logit.abs() < 20.0, "{depth}, sample {i}: {by_logit}");
            });
            mean_gradient(
                3,
                opacity,
                |i| (depths[i], own[i], 5.0),
                |i, by_depth| {
                    assert!((by_depth * depths[i]).abs() < 1e-5, "{depth}, sample {i}: {by_depth}");
                },
            );
        }
    }
}
