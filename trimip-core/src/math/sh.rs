//! Real spherical harmonics of the bands l = 0 to 3 (16 values): the colour network's encoding of the viewing direction.

use crate::math::scalar::Real;

/// Number of values: bands 0 to 3.
pub const COUNT: usize = 16;

/// Factors of the basis functions, in the order of their first use.
pub const FACTORS: [f64; 11] = [
    0.282_094_791_773_878_14,
    0.488_602_511_902_919_9,
    1.092_548_430_592_079_2,
    0.946_174_695_757_56,
    0.315_391_565_252_52,
    0.546_274_215_296_039_6,
    0.590_043_589_926_643_5,
    2.890_611_442_640_554,
    0.457_045_799_464_465_7,
    0.373_176_332_590_115_4,
    1.445_305_721_320_277,
];

/// Returns the 16 basis functions at a unit direction, in the usual order (l from 0, m from −l) and with the usual signs.
#[inline]
pub fn spherical_harmonics<R: Real>(direction: [R; 3]) -> [R; COUNT] {
    let [x, y, z] = direction;
    let f = |factor: usize| R::from_f64(FACTORS[factor]);
    let [one, three, five] = [1.0, 3.0, 5.0].map(R::from_f64);
    let (xx, yy, zz, xy, yz, xz) = (x * x, y * y, z * z, x * y, y * z, x * z);
    [
        f(0),
        -f(1) * y,
        f(1) * z,
        -f(1) * x,
        f(2) * xy,
        -f(2) * yz,
        f(3) * zz - f(4),
        -f(2) * xz,
        f(5) * (xx - yy),
        f(6) * y * (yy - three * xx),
        f(7) * xy * z,
        f(8) * y * (one - five * zz),
        f(9) * z * (five * zz - three),
        f(8) * x * (one - five * zz),
        f(10) * z * (xx - yy),
        f(6) * x * (three * yy - xx),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_and_signs_are_the_published_ones() {
        let found = spherical_harmonics([1.0, 2.0, 2.0].map(|x: f64| x / 3.0));
        let published = [
            0.282_095, -0.325_735, 0.325_735, -0.162_868, 0.242_789, -0.485_577, 0.105_131, -0.242_789,
            -0.182_091,
        ];
        assert!(found.iter().zip(published).all(|(a, b): (&f64, f64)| (a - b).abs() < 1e-6), "{found:?}");
        let squares: f64 = found[..9].iter().map(|value| value * value).sum();
        assert!((squares - 9.0 / (4.0 * std::f64::consts::PI)).abs() < 1e-12);
    }

    #[test]
    fn the_basis_is_orthonormal_on_the_sphere() {
        // Product quadrature, exact for these polynomials: midpoints in φ, Gauss–Legendre (8 nodes) in cosθ.
        let nodes = [
            (0.183_434_642_495_65, 0.362_683_783_378_362),
            (0.525_532_409_916_329, 0.313_706_645_877_887),
            (0.796_666_477_413_627, 0.222_381_034_453_374),
            (0.960_289_856_497_536, 0.101_228_536_290_376),
        ];
        let mut gram = [[0.0; COUNT]; COUNT];
        for (node, weight) in nodes.into_iter().flat_map(|(x, w)| [(x, w), (-x, w)]) {
            for k in 0..16 {
                let phi = std::f64::consts::TAU * (f64::from(k) + 0.5) / 16.0;
                let radius = (1.0_f64 - node * node).sqrt();
                let values = spherical_harmonics([radius * phi.cos(), radius * phi.sin(), node]);
                for (row, a) in gram.iter_mut().zip(values) {
                    for (sum, b) in row.iter_mut().zip(values) {
                        *sum += weight * std::f64::consts::TAU / 16.0 * a * b;
                    }
                }
            }
        }
        for (i, row) in gram.iter().enumerate() {
            for (j, &value) in row.iter().enumerate() {
                assert!((value - f64::from(u8::from(i == j))).abs() < 1e-9, "<{i}, {j}> = {value}");
            }
        }
    }
}
