//! The points at which a sample reads the grid (Zip-NeRF, Sections 2 and 3): one point, or six points on a helix whose
//! mean and variance along the ray are those of the conical frustum. Also the weight of a level's features for a sample
//! that is wider than the level's cells.

use super::Level;
use crate::Aabb;
use crate::config::HashGridConfig;
use crate::field::encoders::definition::SamplePosition;
use crate::math::{basis::across, scalar::Real};

/// Angle of each point around the ray, in sixths of a full turn.
pub const TURNS: [f64; 6] = [0.0, 2.0, 4.0, 3.0, 5.0, 1.0];

/// Standard deviation, in cells, below which the weight is 1, because the error function's argument is then above 4.
const WITHIN: f64 = 0.088;

/// The points of a sample.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Points<R> {
    /// Number of points: 1 or 6.
    pub count: usize,
    /// True to down-weight features of cells that are narrower than the sample.
    pub downweight: bool,
    /// Size of the box, in world units.
    pub extent: [R; 3],
    /// Longest side of the box.
    pub longest: R,
}

impl<R: Real> Points<R> {
    /// Creates the points of a configuration.
    pub fn new(config: &HashGridConfig, aabb: &Aabb<f64>) -> Self {
        Self {
            count: config.points as usize,
            downweight: config.downweight,
            extent: aabb.extent().map(R::from_f64),
            longest: R::from_f64(aabb.longest()),
        }
    }

    /// Returns true if a sample reads the grid at its centre with full weight, as instant-ngp does.
    pub fn is_plain(&self) -> bool {
        self.count == 1 && !self.downweight
    }

    /// Returns point `j` of a sample: its position in the unit cube, and the standard deviation of the Gaussian around
    /// it, as a fraction of the box's longest side.
    #[inline(always)]
    pub fn point(&self, j: usize, at: &SamplePosition<R>) -> [R; 4] {
        let SamplePosition { position, radius, direction, t, length } = *at;
        let number = R::from_f64;
        let [x, y, z] = position;
        let half_root = number(0.5 / std::f64::consts::SQRT_2);
        if self.count == 1 || !(t > R::zero()) {
            return [x, y, z, half_root * radius / self.longest];
        }
        let h = (number(0.5) * length).min(t);
        let (hh, tt) = (h * h, t * t);
        let spread = number(3.0 / 7_f64.sqrt() * (0.4 * j as f64 - 1.0))
            * ((hh - tt) * (hh - tt) + number(4.0) * tt * tt).sqrt();
        let end = t + h;
        let at = (t - h) + h / (hh + number(3.0) * tt) * (end * end + number(2.0) * tt + spread);
        // The cone's radius at the point.
        let radius = radius / t * at;
        let (sine, cosine) = (TURNS[j] * std::f64::consts::FRAC_PI_3).sin_cos();
        let offset_across = number(std::f64::consts::FRAC_1_SQRT_2) * radius;
        let [u, v] = across(direction);
        let place = std::array::from_fn(|axis| {
            let offset = (at - t) * direction[axis]
                + offset_across * (number(cosine) * u[axis] + number(sine) * v[axis]);
            (position[axis] + offset / self.extent[axis]).max(R::zero()).min(R::one())
        });
        let [x, y, z]: [R; 3] = place;
        [x, y, z, half_root * radius / self.longest]
    }

    /// Returns true if [`level_weight`](Self::level_weight) is the same at this deviation as at all smaller ones: cells
    /// are so wide that a sample does not leave them.
    #[inline(always)]
    pub fn is_within(&self, level: &Level, deviation: R) -> bool {
        !self.downweight || deviation * R::from_f64(f64::from(level.scale) + 1.0) < R::from_f64(WITHIN)
    }

    /// Returns the weight of a level's features at one point of a sample, divided by the number of points.
    #[inline(always)]
    pub fn level_weight(&self, level: &Level, deviation: R) -> R {
        let level_weight = if self.downweight { level_weight(level.scale, deviation) } else { R::one() };
        level_weight / R::from_u32(self.count as u32)
    }
}

/// Returns the weight erf(1/√(8σ²n²)) of a Gaussian of standard deviation σ in a grid of n = `scale` + 1 cells.
#[inline(always)]
pub fn level_weight<R: Real>(scale: f32, deviation: R) -> R {
    let cells = deviation * R::from_f64(f64::from(scale) + 1.0);
    let weight = erf(R::from_f64(8_f64.sqrt().recip()) / cells);
    // Below this deviation the error function is 1. Both values are computed, so that the choice between them is a
    // vector instruction.
    if !(cells > R::from_f64(1e-3)) { R::one() } else { weight }
}

/// Computes the error function of a number above zero, within 3e-7 (Abramowitz and Stegun, 7.1.28). The formula needs
/// only sums, products and a quotient, which every processor computes for many numbers at once.
#[inline(always)]
fn erf<R: Real>(x: R) -> R {
    // Above 4 the function differs from 1 by less than 2e-8.
    let x = x.min(R::from_f64(4.0));
    let factors = [4.306_38e-5, 2.765_672e-4, 1.520_143e-4, 9.270_527_2e-3, 4.228_201_23e-2, 7.052_307_84e-2];
    let sum = factors.into_iter().fold(R::zero(), |sum, factor| (sum + R::from_f64(factor)) * x);
    let by_2 = (R::one() + sum) * (R::one() + sum);
    let (by_4, one) = (by_2 * by_2, R::one());
    let by_8 = by_4 * by_4;
    one - (by_8 * by_8).recip()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn points() -> Points<f64> {
        Points { count: 6, downweight: true, extent: [10.0; 3], longest: 10.0 }
    }

    #[test]
    fn levels_weigh_as_much_as_the_gaussian_stays_in_a_cell() {
        // The published weight is the mass of a Gaussian within half a cell of its mean. The standard deviation is half
        // a cell here, then a whole cell.
        assert!((level_weight(63.0, 0.5 / 64.0) - 0.682_689_f64).abs() < 1e-6);
        assert!((level_weight(63.0, 1.0 / 64.0) - 0.382_925_f64).abs() < 1e-6);
        assert_eq!(level_weight(63.0, 0.0_f64), 1.0);
    }

    #[test]
    fn a_sample_within_wide_cells_has_the_weight_of_a_point() {
        let level = Level { scale: 63.0, side: 64, first: 0, entries: 1 << 18, hashed: false };
        let points = Points { count: 6, downweight: true, extent: [10.0; 3], longest: 10.0_f32 };
        let whole = points.level_weight(&level, 0.0);
        let deviations = (0..2000).map(|i| 1e-6 * i as f32);
        let within: Vec<f32> = deviations.filter(|&deviation| points.is_within(&level, deviation)).collect();
        assert!(within.len() > 1370 && within.len() < 1380, "{}", within.len());
        assert!(within.iter().all(|&deviation| points.level_weight(&level, deviation) == whole));
    }

    /// Checks that mean and variance along the ray, and the trace of the covariance across the ray, equal those of the
    /// frustum.
    #[test]
    fn six_points_have_the_moments_of_the_frustum() {
        let direction = [2.0 / 3.0, -1.0 / 3.0, 2.0 / 3.0_f64];
        for (t, length, radius) in [(1.5, 1.0, 0.15), (4.0, 0.1, 0.02), (2.0, 3.9, 0.3)] {
            let all: Vec<[f64; 3]> = (0..6)
                .map(|j| {
                    let [x, y, z, _] = points()
                        .point(j, &SamplePosition { position: [0.5; 3], radius, direction, t, length });
                    [x, y, z].map(|place| (place - 0.5) * 10.0)
                })
                .collect();
            let along = |p: &[f64; 3]| (0..3).map(|i| p[i] * direction[i]).sum::<f64>();
            let mean = all.iter().map(along).sum::<f64>() / 6.0;
            let variance = all.iter().map(|p| (along(p) - mean).powi(2)).sum::<f64>() / 6.0;
            let across = |p: &[f64; 3]| p.iter().map(|x| x * x).sum::<f64>() - along(p).powi(2);
            let trace = all.iter().map(across).sum::<f64>() / 6.0;
            let (s, h) = (t, 0.5 * length);
            let below = 3.0 * s * s + h * h;
            let expected = h * h / 3.0 - 4.0 * h.powi(4) * (12.0 * s * s - h * h) / (15.0 * below * below);
            assert!((mean - 2.0 * s * h * h / below).abs() < 1e-12, "{t} {length}: {mean}");
            assert!((variance / expected - 1.0).abs() < 1e-9, "{t} {length}: {variance}, not {expected}");
            let r = radius / t;
            let expected =
                2.0 * r * r * (s * s / 4.0 + 5.0 * h * h / 12.0 - 4.0 * h.powi(4) / (15.0 * below));
            assert!((trace / expected - 1.0).abs() < 1e-9, "{t} {length}: {trace}, not {expected}");
        }
    }

    #[test]
    fn the_error_function_is_its_integral() {
        for x in [0.01, 0.3, 1.0, 2.5] {
            let steps = 20_000;
            let step = x / f64::from(steps);
            let sum: f64 = (0..steps).map(|i| (-((f64::from(i) + 0.5) * step).powi(2)).exp() * step).sum();
            assert!((erf(x) - 2.0 / std::f64::consts::PI.sqrt() * sum).abs() < 3e-7, "{x}");
        }
    }
}
