//! Lens distortion: how the image of a direction differs from its image in a pinhole camera. (x, y) stands for an undistorted
//! direction, x right and y down. For a perspective lens it is the point where the direction meets the plane at distance 1.
//! For a fisheye it is the vector towards that point whose length is the angle to the optical axis. (X, Y) is the image of the
//! direction relative to the principal point, in units of the focal lengths.
//!
//! With r² = x² + y² and f = (1 + k₁r² + k₂r⁴ + k₃r⁶ + k₄r⁸) / (1 + d₁r² + d₂r⁴ + d₃r⁶):
//!
//! X = x·f + 2p₁xy + p₂(r² + 2x²) + s₁r², Y = y·f + p₁(r² + 2y²) + 2p₂xy + s₂r².
//!
//! These are the models of OpenCV, COLMAP and nerfstudio. A perspective lens has k₁ to k₃, p₁ and p₂, and in addition either
//! d₁ to d₃ (OpenCV's k₄ to k₆) or k₄ (nerfstudio's). A fisheye has k₁ to k₄; COLMAP's thin-prism fisheye also has p₁, p₂, s₁
//! and s₂.

use crate::geometry::projections::Model;
use crate::math::scalar::Real;
use serde::{Deserialize, Deserializer, Serialize};

/// Largest number of steps of Newton's method. Lenses converge within about five.
pub const MOST_ROUNDS: u32 = 24;

/// Undistorted radius up to which the domain of a perspective lens is searched: 84 degrees.
const WIDEST: f64 = 10.0;

/// Number of steps in the search for the domain of a lens.
const DOMAIN_STEPS: u32 = 4096;

/// The camera model of a lens, and its distortion.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// The camera model, which defines the undistorted coordinates. Files of earlier versions have a flag `fisheye` instead.
    #[serde(default, alias = "fisheye", deserialize_with = "model_or_flag")]
    pub model: Model,
    /// k₁ to k₄.
    pub radial: [f64; 4],
    /// d₁ to d₃.
    pub denominator: [f64; 3],
    /// p₁, p₂.
    pub tangential: [f64; 2],
    /// s₁, s₂.
    pub prism: [f64; 2],
    /// Undistorted radius up to which larger circles have larger images. The lens has no rays beyond it.
    domain: f64,
}

/// An undistorted direction.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unbent<R> {
    /// Undistorted coordinates.
    pub at: [R; 2],
    /// Area of the image of a small surface around `at`, divided by the surface's own area.
    pub area: R,
}

/// Reads a model from its name, or from the flag `fisheye`.
fn model_or_flag<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Model, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Stated {
        Fisheye(bool),
        Model(Model),
    }
    Ok(match Stated::deserialize(deserializer)? {
        Stated::Fisheye(true) => Model::Fisheye,
        Stated::Fisheye(false) => Model::Perspective,
        Stated::Model(model) => model,
    })
}

impl Lens {
    /// Returns a perspective lens; coefficients that a model does not have are 0.
    pub fn perspective(radial: [f64; 4], tangential: [f64; 2], denominator: [f64; 3]) -> Self {
        Self { radial, denominator, tangential, ..Self::default() }.with_domain()
    }

    /// Returns a fisheye with OpenCV's coefficients and the thin prism of COLMAP's model.
    pub fn fisheye(radial: [f64; 4], tangential: [f64; 2], prism: [f64; 2]) -> Self {
        Self { model: Model::Fisheye, radial, tangential, prism, ..Self::default() }.with_domain()
    }

    /// Returns a lens of this model without distortion.
    pub fn of(model: Model) -> Self {
        Self { model, ..Self::default() }.with_domain()
    }

    /// Returns the lens without distortion: a pinhole if its model has coefficients, otherwise the same model.
    pub fn without_distortion(&self) -> Self {
        if self.model.definition().distorted { Self::default() } else { Self::of(self.model) }
    }

    /// Returns the lens with `by` added to k₁.
    pub(crate) fn with_more_k1(mut self, by: f64) -> Self {
        if by == 0.0 {
            return self;
        }
        self.radial[0] += by;
        self.with_domain()
    }

    /// Returns true for a pinhole: a perspective lens without distortion.
    pub fn is_straight(&self) -> bool {
        self.model == Model::Perspective
            && [&self.radial[..], &self.denominator, &self.tangential, &self.prism]
                .iter()
                .all(|part| part.iter().all(|&k| k == 0.0))
    }

    /// Returns the largest undistorted radius that has rays.
    pub fn domain(&self) -> f64 {
        self.domain
    }

    /// Finds the domain: the undistorted radius up to which larger circles have larger images.
    fn with_domain(mut self) -> Self {
        if self.is_straight() {
            return Self::default();
        }
        let widest = if self.model == Model::Fisheye { std::f64::consts::PI } else { WIDEST };
        let image = |r: f64| r * self.factor(r * r)[0];
        let step = widest / f64::from(DOMAIN_STEPS);
        let grows = |i: u32| {
            let (before, after) = (image(f64::from(i) * step), image(f64::from(i + 1) * step));
            after > before && after.is_finite()
        };
        let last = (0..DOMAIN_STEPS).find(|&i| !grows(i)).unwrap_or(DOMAIN_STEPS);
        self.domain = f64::from(last) * step;
        self
    }

    /// Returns f and its derivative with respect to r².
    fn factor<R: Real>(&self, r2: R) -> [R; 2] {
        let real = R::from_f64;
        let [k1, k2, k3, k4] = self.radial.map(real);
        let [d1, d2, d3] = self.denominator.map(real);
        let (two, three, four) = (real(2.0), real(3.0), real(4.0));
        let above = R::one() + r2 * (k1 + r2 * (k2 + r2 * (k3 + r2 * k4)));
        let below = R::one() + r2 * (d1 + r2 * (d2 + r2 * d3));
        let above_slope = k1 + r2 * (two * k2 + r2 * (three * k3 + r2 * four * k4));
        let below_slope = d1 + r2 * (two * d2 + r2 * three * d3);
        [above / below, (above_slope * below - above * below_slope) / (below * below)]
    }

    /// Returns the image of undistorted coordinates, and its derivatives [[∂X/∂x, ∂X/∂y], [∂Y/∂x, ∂Y/∂y]].
    pub fn bend<R: Real>(&self, [x, y]: [R; 2]) -> ([R; 2], [[R; 2]; 2]) {
        let real = R::from_f64;
        let ([p1, p2], [s1, s2]) = (self.tangential.map(real), self.prism.map(real));
        let (two, six) = (real(2.0), real(6.0));
        let r2 = x * x + y * y;
        let [f, slope] = self.factor(r2);
        let image = [
            x * f + two * p1 * x * y + p2 * (r2 + two * x * x) + s1 * r2,
            y * f + p1 * (r2 + two * y * y) + two * p2 * x * y + s2 * r2,
        ];
        let mixed = two * (x * y * slope + p1 * x + p2 * y);
        let derivatives = [
            [f + two * x * x * slope + two * p1 * y + six * p2 * x + two * s1 * x, mixed + two * s1 * y],
            [mixed + two * s2 * x, f + two * y * y * slope + six * p1 * y + two * p2 * x + two * s2 * y],
        ];
        (image, derivatives)
    }

    /// Returns the largest factor by which the image stretches lengths around a point of the plane at distance 1.
    pub fn stretch(&self, [x, y]: [f64; 2]) -> f64 {
        let (at, inner) = if self.model == Model::Fisheye {
            let radius = x.hypot(y);
            // The map from the plane to angles scales lengths by at most this fraction, in every direction.
            let fraction = if radius > 0.0 { radius.atan() / radius } else { 1.0 };
            ([x * fraction, y * fraction], fraction)
        } else {
            ([x, y], 1.0)
        };
        let [[a, b], [c, d]] = self.bend(at).1;
        // The larger singular value of the derivatives.
        let (sum, area) = (a * a + b * b + c * c + d * d, a * d - b * c);
        inner * (0.5 * (sum + (sum * sum - 4.0 * area * area).max(0.0).sqrt())).sqrt()
    }

    /// Finds the undistorted coordinates of an image by Newton's method. Returns `None` if the lens has no ray there:
    /// outside of its domain, or if the method does not converge.
    pub fn unbend<R: Real>(&self, image: [R; 2]) -> Option<Unbent<R>> {
        let domain = R::from_f64(self.domain);
        let scale = R::one() + image[0].abs() + image[1].abs();
        let enough = R::from_f64(8.0) * R::epsilon() * scale;
        // The image of a point lies in about the same direction as the point, so the search starts at the image, moved into
        // the domain.
        let radius = image[0].hypot(image[1]);
        let shrink = if radius > domain { domain / radius } else { R::one() };
        let mut at = image.map(|c| c * shrink);
        for _ in 0..MOST_ROUNDS {
            let (found, [[a, b], [c, d]]) = self.bend(at);
            let error = [found[0] - image[0], found[1] - image[1]];
            let area = a * d - b * c;
            if error[0].abs().max(error[1].abs()) <= enough {
                let inside = at[0].hypot(at[1]) < domain && area > R::zero();
                return inside.then_some(Unbent { at, area });
            }
            let step = [(d * error[0] - b * error[1]) / area, (a * error[1] - c * error[0]) / area];
            // Steps are limited to half of the domain, so that the method does not diverge.
            let length = step[0].hypot(step[1]);
            let most = R::from_f64(0.5) * domain;
            let part = if length > most { most / length } else { R::one() };
            at = [at[0] - part * step[0], at[1] - part * step[1]];
            if !(at[0].is_finite() && at[1].is_finite()) {
                return None;
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a phone's lens (the fox photographs), a lens with strong barrel distortion, a rational model, and fisheyes.
    fn lenses() -> Vec<Lens> {
        vec![
            Lens::perspective([0.0578421, -0.0805099, 0.0, 0.0], [-0.000980296, 0.00015575], [0.0; 3]),
            Lens::perspective([-0.28, 0.07, -0.008, 0.0], [0.001, -0.002], [0.0; 3]),
            Lens::perspective([0.1, 0.02, 0.003, 0.0], [0.0; 2], [0.3, 0.02, 0.001]),
            Lens::fisheye([0.0; 4], [0.0; 2], [0.0; 2]),
            Lens::fisheye([-0.02, 0.004, -0.002, 0.0003], [0.0; 2], [0.0; 2]),
            Lens::fisheye([0.03, -0.01, 0.002, -0.0002], [0.001, -0.0005], [0.002, -0.001]),
        ]
    }

    /// Returns points within a fraction of the domain of a lens.
    fn places(lens: &Lens, fraction: f64) -> Vec<[f64; 2]> {
        let radius = fraction * lens.domain().min(1.2);
        (0..80)
            .map(|i| {
                let (r, angle) = (radius * f64::from(i) / 79.0, 2.399_963 * f64::from(i));
                [r * angle.cos(), r * angle.sin()]
            })
            .collect()
    }

    #[test]
    fn images_come_back_to_where_they_came_from() {
        for lens in lenses() {
            for at in places(&lens, 0.95) {
                let found = lens.unbend(lens.bend(at).0).unwrap_or_else(|| panic!("{lens:?} {at:?}"));
                assert!(
                    (found.at[0] - at[0]).hypot(found.at[1] - at[1]) < 1e-11,
                    "{lens:?} {at:?} {found:?}"
                );
                let narrow = lens.unbend(lens.bend(at).0.map(|c| c as f32)).expect("in f32 too");
                let apart = (f64::from(narrow.at[0]) - at[0]).hypot(f64::from(narrow.at[1]) - at[1]);
                assert!(apart < 2e-5, "{lens:?} {at:?} {narrow:?}");
            }
        }
    }

    #[test]
    fn derivatives_are_finite_differences() {
        let h = 1e-6;
        for lens in lenses() {
            for [x, y] in places(&lens, 0.9) {
                let derivatives = lens.bend([x, y]).1;
                let by = |d: [f64; 2]| {
                    let (ahead, back) =
                        (lens.bend([x + d[0], y + d[1]]).0, lens.bend([x - d[0], y - d[1]]).0);
                    [0, 1].map(|i| (ahead[i] - back[i]) / (2.0 * h))
                };
                let (by_x, by_y) = (by([h, 0.0]), by([0.0, h]));
                for i in 0..2 {
                    assert!((derivatives[i][0] - by_x[i]).abs() < 1e-8, "{lens:?} {x} {y}");
                    assert!((derivatives[i][1] - by_y[i]).abs() < 1e-8, "{lens:?} {x} {y}");
                }
            }
        }
    }

    #[test]
    fn there_are_no_rays_beyond_the_domain() {
        // r(1 − r²/3) grows up to r = 1, where the image has radius 2/3.
        let lens = Lens::perspective([-1.0 / 3.0, 0.0, 0.0, 0.0], [0.0; 2], [0.0; 3]);
        assert!((lens.domain() - 1.0).abs() < 5e-3, "{}", lens.domain());
        assert!(lens.unbend([0.66, 0.0]).is_some());
        for radius in [0.67, 0.7, 1.0, 5.0] {
            assert!(lens.unbend([0.0, radius]).is_none() && lens.unbend([radius as f32, 0.0]).is_none());
        }
        assert!(lens.unbend([f64::NAN, 0.0]).is_none());
        // An ideal fisheye sees behind itself, up to π from its axis.
        let lens = Lens::fisheye([0.0; 4], [0.0; 2], [0.0; 2]);
        assert!(lens.unbend([3.1, 0.0]).is_some() && lens.unbend([3.2, 0.0]).is_none());
        assert!(Lens::perspective([0.0; 4], [0.0; 2], [0.0; 3]).is_straight() && !lens.is_straight());
    }

    #[test]
    fn stored_lenses_come_back_also_those_with_the_flag_of_a_fisheye() {
        for lens in lenses() {
            let stored = serde_json::to_value(lens).unwrap();
            assert_eq!(serde_json::from_value::<Lens>(stored.clone()).unwrap(), lens);
            let mut flagged = stored;
            flagged.as_object_mut().unwrap().remove("model");
            flagged["fisheye"] = (lens.model == Model::Fisheye).into();
            assert_eq!(serde_json::from_value::<Lens>(flagged).unwrap(), lens);
        }
    }
}
