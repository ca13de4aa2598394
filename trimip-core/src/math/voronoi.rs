//! Soft Voronoi cells of the sphere: the weight of each of 16 unit sites for a direction, an encoding of the viewing direction
//! (after Spherical Voronoi, which places its sites by training; these are fixed).

use crate::math::scalar::Real;

/// Number of sites.
pub const COUNT: usize = 16;

/// Coordinates of the sites: [site, 3]. Site i has z = 1 − (2i + 1)/16 and the azimuth i·π·(3 − √5), a Fibonacci lattice.
pub const SITES: [f64; 3 * COUNT] = [
    0.347_985_272_676_876_34,
    0.0,
    0.937_5,
    -0.429_857_439_236_707_55,
    0.393_784_626_328_733_6,
    0.812_5,
    0.063_487_195_473_543_7,
    -0.723_403_847_108_172_4,
    0.687_5,
    0.503_055_598_167_96,
    0.656_146_946_309_952_6,
    0.562_5,
    -0.885_472_495_182_538_1,
    -0.156_627_616_578_974,
    0.437_5,
    0.801_498_139_297_282_9,
    -0.509_847_509_264_283_2,
    0.312_5,
    -0.255_000_119_450_616_24,
    0.948_587_733_992_049_7,
    0.187_5,
    -0.460_005_934_849_126_55,
    -0.885_713_435_544_240_2,
    0.062_5,
    0.937_484_889_296_233_6,
    0.342_367_977_972_865_5,
    -0.062_5,
    -0.907_951_920_590_184_9,
    0.374_789_354_033_161_7,
    -0.187_5,
    0.402_618_838_030_566_9,
    -0.860_373_070_977_303_5,
    -0.312_5,
    0.269_121_560_910_669_85,
    0.858_001_943_734_980_5,
    -0.437_5,
    -0.715_354_278_922_621_5,
    -0.414_562_426_694_817_96,
    -0.562_5,
    0.709_246_688_607_407,
    -0.155_925_894_896_991_88,
    -0.687_5,
    -0.335_278_136_885_808_26,
    0.476_898_648_484_540_4,
    -0.812_5,
    -0.044_719_827_431_596_14,
    -0.345_099_821_840_707_75,
    -0.937_5,
];

/// Returns the softmax of `sharpness`·(site·direction) over the sites, for a unit direction. The weights are positive and their sum
/// is 1. A larger sharpness gives smaller transitions between the cells.
#[inline]
pub fn soft_voronoi<R: Real>(direction: [R; 3], sharpness: R) -> [R; COUNT] {
    let mut weights = [R::zero(); COUNT];
    for (weight, site) in weights.iter_mut().zip(SITES.chunks_exact(3)) {
        let cosine = site.iter().zip(direction).fold(R::zero(), |sum, (s, d)| sum + R::from_f64(*s) * d);
        // No exponential is above 1, because no cosine is.
        *weight = (sharpness * (cosine - R::one())).exp();
    }
    let sum = weights.iter().fold(R::zero(), |sum, weight| sum + *weight);
    weights.map(|weight| weight / sum)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sites_are_a_fibonacci_lattice() {
        for (i, site) in SITES.chunks_exact(3).enumerate() {
            let z = 1.0 - (2 * i + 1) as f64 / COUNT as f64;
            let (sin, cos) = (i as f64 * std::f64::consts::PI * (3.0 - 5_f64.sqrt())).sin_cos();
            let radius = (1.0 - z * z).sqrt();
            for (found, expected) in site.iter().zip([radius * cos, radius * sin, z]) {
                assert!((found - expected).abs() < 1e-14, "site {i}");
            }
        }
    }

    #[test]
    fn weights_are_a_softmax() {
        let direction = [2.0, -3.0, 6.0].map(|x: f64| x / 7.0);
        for sharpness in [0.0, 1.0, 8.0, 1000.0] {
            let found = soft_voronoi(direction, sharpness);
            let cosines =
                SITES.chunks_exact(3).map(|site| (0..3).map(|k| site[k] * direction[k]).sum::<f64>());
            let cosines: Vec<f64> = cosines.collect();
            let largest = cosines.iter().copied().fold(f64::NEG_INFINITY, f64::max);
            let exponentials = cosines.iter().map(|cosine| (sharpness * (cosine - largest)).exp());
            let sum: f64 = exponentials.clone().sum();
            for (found, exponential) in found.iter().zip(exponentials) {
                assert!((found - exponential / sum).abs() < 1e-13);
            }
            let single = soft_voronoi(direction.map(|x| x as f32), sharpness as f32);
            assert!(
                single.iter().zip(found).all(|(single, found)| (f64::from(*single) - found).abs() < 2e-4)
            );
        }
    }
}
