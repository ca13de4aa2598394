//! Smooth-L1 per channel, with its derivative (β = 1).

use crate::scalar::Real;

/// Value and derivative at `difference`: d²/(2β) within β, |d| − β/2 beyond.
#[inline]
pub fn smooth_l1<R: Real>(difference: R, beta: R) -> (R, R) {
    let half = R::from_f64(0.5);
    let size = difference.abs();
    if size < beta {
        (half * difference * difference / beta, difference / beta)
    } else {
        (size - half * beta, difference.signum())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn value_and_slope_are_continuous_and_consistent() {
        for beta in [0.05_f64, 1.0] {
            for d in [-2.0, -0.3, -0.01, 0.02, 0.7, 1.5] {
                let h = 1e-7;
                let numeric = (smooth_l1(d + h, beta).0 - smooth_l1(d - h, beta).0) / (2.0 * h);
                assert!((smooth_l1(d, beta).1 - numeric).abs() < 1e-6);
            }
            let (inside, outside) = (smooth_l1(beta * (1.0 - 1e-12), beta), smooth_l1(beta, beta));
            assert!((inside.0 - outside.0).abs() < 1e-11 && (inside.1 - outside.1).abs() < 1e-11);
        }
    }
}
