//! Powers of a symmetric positive definite matrix.

/// Number of sweeps of Jacobi rotations. A matrix with six rows is diagonal to the last bit after about six sweeps.
const SWEEPS: usize = 12;

/// Returns the powers −1/2 and 1/2 of a symmetric positive definite matrix `a`, by Jacobi's eigenvalue method (Golub and
/// Van Loan, section 8.5).
pub fn inverse_root_and_root<const N: usize>(a: [[f64; N]; N]) -> [[[f64; N]; N]; 2] {
    let (values, vectors) = eigen(a);
    [-0.5, 0.5].map(|power| {
        let scaled = values.map(|value| value.max(f64::MIN_POSITIVE).powf(power));
        std::array::from_fn(|i| {
            std::array::from_fn(|j| (0..N).map(|k| vectors[i][k] * scaled[k] * vectors[j][k]).sum())
        })
    })
}

/// Returns the eigenvalues of a symmetric matrix, and the eigenvectors as columns.
pub fn eigen<const N: usize>(mut a: [[f64; N]; N]) -> ([f64; N], [[f64; N]; N]) {
    let mut vectors = std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))));
    for _ in 0..SWEEPS {
        for p in 0..N {
            for q in p + 1..N {
                if a[p][q] != 0.0 {
                    rotate(&mut a, &mut vectors, p, q);
                }
            }
        }
    }
    (std::array::from_fn(|i| a[i][i]), vectors)
}

/// Rotates the axes `p` and `q` so that a[p][q] becomes zero.
fn rotate<const N: usize>(a: &mut [[f64; N]; N], vectors: &mut [[f64; N]; N], p: usize, q: usize) {
    let theta = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
    let tangent = theta.signum() / (theta.abs() + theta.hypot(1.0));
    let cosine = tangent.hypot(1.0).recip();
    let sine = tangent * cosine;
    let turn = |row: &mut [f64; N]| {
        (row[p], row[q]) = (cosine * row[p] - sine * row[q], sine * row[p] + cosine * row[q]);
    };
    a.iter_mut().for_each(turn);
    for column in 0..N {
        (a[p][column], a[q][column]) =
            (cosine * a[p][column] - sine * a[q][column], sine * a[p][column] + cosine * a[q][column]);
    }
    vectors.iter_mut().for_each(turn);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn product<const N: usize>(a: &[[f64; N]; N], b: &[[f64; N]; N]) -> [[f64; N]; N] {
        std::array::from_fn(|i| std::array::from_fn(|j| (0..N).map(|k| a[i][k] * b[k][j]).sum()))
    }

    #[test]
    fn the_roots_multiply_to_the_matrix_and_to_one() {
        // BᵀB + 0.01·I for an arbitrary matrix B: positive definite, with eigenvalues of different sizes.
        let b: [[f64; 6]; 6] = std::array::from_fn(|i| {
            std::array::from_fn(|j| (((7 * i + 3 * j * j + 5) % 11) as f64 - 5.0) * 10_f64.powi(j as i32 - 3))
        });
        let a: [[f64; 6]; 6] = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                (0..6).map(|k| b[k][i] * b[k][j]).sum::<f64>() + if i == j { 0.01 } else { 0.0 }
            })
        });
        let [inverse, root] = inverse_root_and_root(a);
        let (squared, one) = (product(&root, &root), product(&inverse, &root));
        for i in 0..6 {
            for j in 0..6 {
                let scale = (a[i][i] * a[j][j]).sqrt();
                assert!((squared[i][j] - a[i][j]).abs() < 1e-9 * scale, "{i}, {j}: {squared:?}");
                assert!((one[i][j] - f64::from(u8::from(i == j))).abs() < 1e-6, "{i}, {j}: {one:?}");
            }
        }
    }

    #[test]
    fn a_diagonal_matrix_has_the_roots_of_its_numbers() {
        let [inverse, root] = inverse_root_and_root([[4.0, 0.0], [0.0, 9.0]]);
        assert_eq!(root, [[2.0, 0.0], [0.0, 3.0]]);
        assert!((inverse[0][0] - 0.5).abs() < 1e-15 && (inverse[1][1] - 1.0 / 3.0).abs() < 1e-15);
    }
}
