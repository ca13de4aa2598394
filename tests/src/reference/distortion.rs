//! The distortion loss written from its equation (mip-NeRF 360, Eq. 15), over all pairs of samples, in f64. A sample has a
//! weight w, a place m and a width d along its ray, in units of the longest side of the box.

use super::{Sample, contraction};
use trimip_core::{Config, batch::Ray, config::Contraction};

/// Place and width of a sample: distance and length in a bounded space, both as parameters of the ray in a contracted one.
pub fn along(config: &Config, ray: &Ray, sample: &Sample) -> [f64; 2] {
    if config.scene.contraction == Contraction::Ball {
        return contraction::along(config, ray, sample);
    }
    let (low, high) = (config.scene.aabb_min.map(f64::from), config.scene.aabb_max.map(f64::from));
    let longest = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f64::max);
    [sample.t / longest, sample.length / longest]
}

/// L = Σ_ij w_i·w_j·|m_i − m_j| + ⅓·Σ_i w_i²·d_i of samples with the given optical depths, places and widths.
pub fn distortion(depths: &[f64], places: &[[f64; 2]]) -> f64 {
    let before = |i: usize| depths[..i].iter().sum::<f64>();
    let w: Vec<f64> = (0..depths.len()).map(|i| (-before(i)).exp() * -(-depths[i]).exp_m1()).collect();
    let mut sum = 0.0;
    for i in 0..w.len() {
        for j in 0..w.len() {
            sum += w[i] * w[j] * (places[i][0] - places[j][0]).abs();
        }
        sum += w[i] * w[i] * places[i][1] / 3.0;
    }
    sum
}
