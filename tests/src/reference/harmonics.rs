//! Real spherical harmonics from Legendre's polynomials: Y_lm = (−1)^m·√2·K_lm·Re or Im (x + iy)^|m| · d^|m| P_l(z)/dz^|m|.

use std::f64::consts::PI;

/// Coefficients of P_0 to P_3, constant term first.
const LEGENDRE: [[f64; 4]; 4] =
    [[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0], [-0.5, 0.0, 1.5, 0.0], [0.0, -1.5, 0.0, 2.5]];

/// Returns the 16 harmonics of degrees 0 to 3 at a unit direction: l from 0, m from −l to l.
pub fn harmonics([x, y, z]: [f64; 3]) -> Vec<f64> {
    let degrees = (0..4_i32).flat_map(|l| (-l..=l).map(move |m| (l, m)));
    degrees
        .map(|(l, m)| {
            let order = m.unsigned_abs();
            let mut polynomial = LEGENDRE[l as usize].to_vec();
            // `real` is sin^|m| θ·cos |m|φ, `imaginary` is sin^|m| θ·sin |m|φ.
            let (mut real, mut imaginary) = (1.0, 0.0);
            for _ in 0..order {
                let rest = polynomial.iter().enumerate().skip(1);
                polynomial = rest.map(|(power, c)| power as f64 * c).collect();
                (real, imaginary) = (x * real - y * imaginary, x * imaginary + y * real);
            }
            let derivative: f64 =
                polynomial.iter().enumerate().map(|(power, c)| c * z.powi(power as i32)).sum();
            let factorial = |n: i32| (1..=n).map(f64::from).product::<f64>();
            let (less, more) = (factorial(l - order as i32), factorial(l + order as i32));
            let norm = (f64::from(2 * l + 1) / (4.0 * PI) * less / more).sqrt();
            let sign = if order % 2 == 1 { -1.0 } else { 1.0 };
            match m.signum() {
                0 => norm * derivative,
                1 => sign * 2.0_f64.sqrt() * norm * real * derivative,
                _ => sign * 2.0_f64.sqrt() * norm * imaginary * derivative,
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::harmonics;
    use trimip_core::math::sh::spherical_harmonics;

    #[test]
    fn the_basis_of_the_backends_has_these_signs_and_this_order() {
        for direction in [[0.48, -0.6, 0.64], [-0.36, 0.48, 0.8], [0.0, 0.0, -1.0]] {
            for (found, expected) in spherical_harmonics(direction).into_iter().zip(harmonics(direction)) {
                assert!((found - expected).abs() < 1e-12, "{found}, not {expected}");
            }
        }
    }
}
