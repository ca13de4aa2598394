//! Rank correlation (Spearman): whether one value falls or rises with another, linearly or not.

/// Minimum number of pairs; a correlation of fewer is meaningless.
const LEAST: usize = 4;

/// Returns Spearman's rank correlation of pairs of finite values, -1 to 1: Pearson's correlation of their ranks, where
/// equal values share the mean of their ranks. `None` for fewer than four pairs, or if all first or all second values
/// are equal.
pub(super) fn rank_correlation(pairs: &[(f64, f64)]) -> Option<f64> {
    if pairs.len() < LEAST {
        return None;
    }
    let [a, b] = [ranks(pairs.iter().map(|pair| pair.0)), ranks(pairs.iter().map(|pair| pair.1))];
    let covariance = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let variance = covariance(&a, &a) * covariance(&b, &b);
    (variance > 0.0).then(|| covariance(&a, &b) / variance.sqrt())
}

/// Returns the rank of each value minus the mean rank.
fn ranks(values: impl Iterator<Item = f64>) -> Vec<f64> {
    let values: Vec<f64> = values.collect();
    // Twice the difference between rank and mean rank: the number of smaller values minus the number of greater values.
    let rank = |value: &f64| {
        let below = values.iter().filter(|other| *other < value).count() as f64;
        let above = values.iter().filter(|other| *other > value).count() as f64;
        0.5 * (below - above)
    };
    values.iter().map(rank).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_that_falls_everywhere_has_minus_one() {
        let falling: Vec<(f64, f64)> = (1..9).map(|i| (f64::from(i), 30.0 - f64::from(i).exp())).collect();
        assert_eq!(rank_correlation(&falling), Some(-1.0));
        let rising: Vec<(f64, f64)> = falling.iter().map(|(a, b)| (-a, *b)).collect();
        assert_eq!(rank_correlation(&rising), Some(1.0));
    }

    #[test]
    fn equal_values_share_their_ranks() {
        // Ranks 1, 2.5, 2.5, 4 and 1, 2, 3, 4: 4.5 / sqrt(4.5 · 5).
        let pairs = [(1.0, 1.0), (2.0, 2.0), (2.0, 3.0), (5.0, 9.0)];
        assert!((rank_correlation(&pairs).unwrap() - 0.9_f64.sqrt()).abs() < 1e-15);
    }

    #[test]
    fn few_or_constant_values_have_no_correlation() {
        assert_eq!(rank_correlation(&[(1.0, 2.0), (2.0, 3.0), (3.0, 4.0)]), None);
        assert_eq!(rank_correlation(&[(1.0, 2.0), (1.0, 3.0), (1.0, 4.0), (1.0, 5.0)]), None);
    }
}
