//! Solves symmetric positive definite systems of many unknowns.

use rayon::prelude::*;

/// Columns that are eliminated at once.
const BLOCK: usize = 64;

/// Solves A·x = b for a symmetric positive definite A, whose lower triangle, [n, n] row by row, is overwritten by its
/// Cholesky factor. `None` if A is not positive definite. The solution has the same bits for any number of threads.
pub(super) fn solve(a: &mut [f64], b: &[f64]) -> Option<Vec<f64>> {
    let n = b.len();
    for first in (0..n).step_by(BLOCK) {
        let last = (first + BLOCK).min(n);
        let (above, below) = a.split_at_mut(last * n);
        // Factors the block on the diagonal.
        for i in first..last {
            for j in first..=i {
                let sum = above[i * n + j]
                    - dot(&above[i * n + first..i * n + j], &above[j * n + first..j * n + j]);
                let value = if i == j { sum.sqrt() } else { sum / above[j * n + j] };
                if !value.is_finite() || (i == j && value <= 0.0) {
                    return None;
                }
                above[i * n + j] = value;
            }
        }
        // Factors the rows below it.
        let diagonal = &above[first * n..];
        below.par_chunks_exact_mut(n).for_each(|row| {
            for j in first..last {
                let factor = &diagonal[(j - first) * n..][..n];
                row[j] = (row[j] - dot(&row[first..j], &factor[first..j])) / factor[j];
            }
        });
        // Subtracts the contribution of these columns from the remaining matrix.
        let width = last - first;
        let panel: Vec<f64> =
            below.chunks_exact(n).flat_map(|row| row[first..last].iter().copied()).collect();
        below.par_chunks_exact_mut(n).enumerate().for_each(|(i, row)| {
            let own = &panel[i * width..][..width];
            for (value, other) in row[last..].iter_mut().zip(panel.chunks_exact(width)).take(i + 1) {
                *value -= dot(own, other);
            }
        });
    }
    let mut x = b.to_vec();
    for i in 0..n {
        x[i] = (x[i] - dot(&a[i * n..][..i], &x[..i])) / a[i * n + i];
    }
    for i in (0..n).rev() {
        x[i] /= a[i * n + i];
        let value = x[i];
        (0..i).for_each(|j| x[j] -= a[i * n + j] * value);
    }
    Some(x)
}

/// Returns Σ aᵢ·bᵢ, in eight partial sums that the compiler vectorises.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let ((a, a_rest), (b, b_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut sums = [0.0; 8];
    for (a, b) in a.iter().zip(b) {
        (0..8).for_each(|i| sums[i] += a[i] * b[i]);
    }
    sums.iter().sum::<f64>() + a_rest.iter().zip(b_rest).map(|(a, b)| a * b).sum::<f64>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_solution_solves_the_system() {
        for n in [1, 5, 64, 65, 200] {
            let value = |i: usize, j: usize| ((i * 7 + j * j * 3 + 11) % 23) as f64 / 23.0 - 0.4;
            // MᵀM + I is positive definite.
            let a: Vec<f64> = (0..n * n)
                .map(|at| {
                    let (i, j) = (at / n, at % n);
                    (0..n).map(|k| value(k, i) * value(k, j)).sum::<f64>() + f64::from(u8::from(i == j))
                })
                .collect();
            let expected: Vec<f64> = (0..n).map(|i| (i as f64 * 0.7).sin()).collect();
            let b: Vec<f64> = (0..n).map(|i| (0..n).map(|j| a[i * n + j] * expected[j]).sum()).collect();
            let found = solve(&mut a.clone(), &b).unwrap();
            for (found, expected) in found.iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-8, "{n}: {found} {expected}");
            }
        }
    }

    #[test]
    fn a_matrix_that_is_not_positive_definite_has_no_solution() {
        assert_eq!(solve(&mut [1.0, 0.0, 2.0, 1.0], &[1.0, 1.0]), None);
        assert_eq!(solve(&mut [f64::NAN], &[1.0]), None);
    }
}
