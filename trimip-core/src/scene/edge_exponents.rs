//! Silhouettes in the public multi-scale sets, whose coarse photographs are means of straight RGBA. Let P be the mean of
//! colour·α within a pixel, and A the pixel's opacity. Such a pixel then adds about P·A to the background, although the
//! scene itself would add P. The edge exponent γ interpolates: C = P·A^γ + (1 − A)·background. It is 0 if edge pixels are
//! as in the scene, and 1 if colour and alpha of a block are independent. One value per scale is fitted to the training
//! photographs.

use crate::math::scalar::Real;
use crate::{Alpha, ViewSet};

/// Opacity below which A^γ is taken as constant, because its slope is infinite at 0.
pub const LEAST_OPACITY: f64 = 1e-4;

/// Largest number of views per scale that the fit reads.
const FITTED_VIEWS: usize = 16;

/// Number of candidates for an exponent in [0, 1]; the best one is then refined.
const CANDIDATES: usize = 65;

/// Returns the colour that a photograph of the set shows for a pixel whose composited colour is `rgb` = P + (1 −
/// A)·background.
#[inline]
pub fn shown<R: Real>(rgb: [R; 3], opacity: R, background: [R; 3], exponent: R) -> [R; 3] {
    if exponent == R::zero() {
        return rgb;
    }
    let factor = opacity.max(R::from_f64(LEAST_OPACITY)).powf(exponent);
    let left = R::one() - opacity;
    std::array::from_fn(|c| {
        let behind = left * background[c];
        (rgb[c] - behind) * factor + behind
    })
}

/// Returns the gradient with respect to [r, g, b, opacity] of a pixel, given the `gradient` with respect to the colour
/// [`shown`].
#[inline]
pub fn shown_gradient<R: Real>(
    rgb: [R; 3],
    opacity: R,
    background: [R; 3],
    exponent: R,
    gradient: [R; 3],
) -> [R; 4] {
    let [r, g, b] = gradient;
    if exponent == R::zero() {
        return [r, g, b, R::zero()];
    }
    let least = R::from_f64(LEAST_OPACITY);
    let base = opacity.max(least);
    let factor = base.powf(exponent);
    let slope = if opacity > least { exponent * factor / base } else { R::zero() };
    let left = R::one() - opacity;
    let mut by_opacity = R::zero();
    for c in 0..3 {
        let own = rgb[c] - left * background[c];
        by_opacity += gradient[c] * (own * slope - background[c] * (R::one() - factor));
    }
    [r * factor, g * factor, b * factor, by_opacity]
}

/// Fits the edge exponent of each scale of `views`, fine to coarse. Least squares fit P·A^γ of the finest photographs to the
/// colour·α of the coarser ones, over partly transparent pixels. Returns `None` if alpha is not straight, if there is only
/// one scale, or if the scales have different numbers of views.
pub fn fit(views: &ViewSet) -> Option<Vec<f64>> {
    let finest = views.scales.first()?;
    let whole = |scale: &crate::Scale| scale.views.len() == finest.views.len();
    if views.alpha != Alpha::Straight || views.scales.len() < 2 || !views.scales.iter().all(whole) {
        return None;
    }
    let stride = finest.views.len().div_ceil(FITTED_VIEWS).max(1);
    let exponent = |scale: &crate::Scale| {
        let pairs = (0..finest.views.len()).step_by(stride).flat_map(|i| {
            let (fine, coarse) = (finest.views.start + i, scale.views.start + i);
            edge_pixels(views, fine, coarse, scale.factor / finest.factor)
        });
        best(&pairs.collect::<Vec<_>>())
    };
    Some(std::iter::once(0.0).chain(views.scales.iter().skip(1).map(exponent)).collect())
}

/// A partly transparent pixel of a coarse photograph.
struct EdgePixel {
    /// P and A: means of colour·α and of α over the pixel's area in the finest photograph.
    colour: [f64; 3],
    opacity: f64,
    /// Colour·α of the coarse photograph.
    stored: [f64; 3],
}

fn edge_pixels(views: &ViewSet, fine: usize, coarse: usize, factor: u32) -> Vec<EdgePixel> {
    let means = views.means(fine, factor);
    let edge = |(mean, pixel): (&[f64; 4], &[u8; 4])| {
        let [r, g, b, opacity] = *mean;
        let [red, green, blue, alpha] = pixel.map(|byte| f64::from(byte) / 255.0);
        let stored = [red * alpha, green * alpha, blue * alpha];
        (opacity > 0.0 && opacity < 1.0).then_some(EdgePixel { colour: [r, g, b], opacity, stored })
    };
    means.iter().zip(views.pixels_of(coarse)).filter_map(edge).collect()
}

/// Returns the exponent in [0, 1] with the least squared error, to a thousandth; 0 without pixels.
fn best(pixels: &[EdgePixel]) -> f64 {
    let error = |exponent: f64| {
        let of = |pixel: &EdgePixel| {
            let factor = pixel.opacity.powf(exponent);
            (0..3).map(|c| (pixel.colour[c] * factor - pixel.stored[c]).powi(2)).sum::<f64>()
        };
        pixels.iter().map(of).sum::<f64>()
    };
    let least = |from: f64, step: f64, count: usize| {
        let candidates = (0..count).map(|i| (from + step * i as f64).clamp(0.0, 1.0));
        let by_error = |a: &f64, b: &f64| error(*a).total_cmp(&error(*b));
        candidates.min_by(by_error).unwrap_or(0.0)
    };
    let coarse = 1.0 / (CANDIDATES - 1) as f64;
    let near = least(0.0, coarse, CANDIDATES);
    let fine = least(near - coarse, coarse / 16.0, 33);
    (1e3 * fine).round() * 1e-3
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, Intrinsics, Scale, View};

    #[test]
    fn the_gradient_is_the_slope() {
        let (rgb, background, weights) = ([0.55, 0.3, 0.8], [1.0, 0.25, 0.0], [0.7, -1.3, 0.4]);
        for opacity in [0.02, 0.4, 0.97] {
            for exponent in [0.0, 0.03, 0.5, 1.0] {
                let value = |rgb: [f64; 3], opacity: f64| {
                    let colour = shown(rgb, opacity, background, exponent);
                    (0..3).map(|c| weights[c] * colour[c]).sum::<f64>()
                };
                let found = shown_gradient(rgb, opacity, background, exponent, weights);
                let h = 1e-6;
                for (i, found) in found.iter().enumerate() {
                    let at = |shift: f64| {
                        let (mut rgb, mut opacity) = (rgb, opacity);
                        if i < 3 {
                            rgb[i] += shift;
                        } else {
                            opacity += shift;
                        }
                        value(rgb, opacity)
                    };
                    let slope = (at(h) - at(-h)) / (2.0 * h);
                    assert!((found - slope).abs() < 1e-7, "{opacity} {exponent} {i}: {found}, not {slope}");
                }
            }
        }
    }

    #[test]
    fn only_partly_transparent_pixels_change() {
        let (rgb, background) = ([0.2, 0.5, 0.9], [1.0; 3]);
        let near = |a: [f64; 3], b: [f64; 3]| (0..3).all(|c| (a[c] - b[c]).abs() < 1e-12);
        assert!(near(shown(rgb, 1.0, background, 0.5), rgb));
        assert!(near(shown(background, 0.0, background, 0.5), background));
        // (0.4, 0, 0.8) with opacity 0.5 on white, calculated by hand: exponent 1 halves the colour again.
        assert!(near(shown([0.7, 0.5, 0.9], 0.5, background, 1.0), [0.6, 0.5, 0.7]));
    }

    /// Returns views at two scales with one colour per 2×2 block; `alpha` holds the opacities of the block's four pixels.
    fn set(alpha: [u8; 4], colour: impl Fn(usize) -> [u8; 3]) -> ViewSet {
        let size = 16_usize;
        let fine = |i: usize| {
            let (x, y) = (i % size, i / size);
            let [r, g, b] = colour(x / 2 + 8 * (y / 2));
            // A transparent pixel has no colour, as in the public set.
            let a = alpha[x % 2 + 2 * (y % 2)];
            if a == 0 { [0; 4] } else { [r, g, b, a] }
        };
        let finest: Vec<[u8; 4]> = (0..size * size).map(fine).collect();
        let mean = |i: usize| {
            let (x, y) = (2 * (i % 8), 2 * (i / 8));
            let block = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(u, v)| finest[(y + v) * size + x + u]);
            std::array::from_fn(|c| (block.iter().map(|p| f64::from(p[c])).sum::<f64>() / 4.0) as u8)
        };
        let coarse: Vec<[u8; 4]> = (0..64).map(mean).collect();
        let view = |level: u32, offset: usize| View {
            name: String::new(),
            camera: Camera {
                intrinsics: Intrinsics::from_angle(16, 16, 0.7).reduced(level),
                rotation: glam::DMat3::IDENTITY,
                origin: glam::DVec3::ZERO,
            },
            offset,
        };
        ViewSet {
            views: vec![view(0, 0), view(1, 256)],
            pixels: [finest, coarse].concat().into(),
            alpha: Alpha::Straight,
            depths: Vec::new(),
            scales: vec![
                Scale { factor: 1, weight: 1.0, views: 0..1, pixels: 0..256 },
                Scale { factor: 2, weight: 4.0, views: 1..2, pixels: 256..320 },
            ],
        }
    }

    #[test]
    fn exponents_of_known_sets_are_found() {
        let colour = |i: usize| [200, 40 + 3 * i as u8, 255 - 3 * i as u8];
        // Opaque and transparent pixels: the mean of straight colours is P already, and colour·α is P·A.
        let opaque = fit(&set([255, 0, 255, 0], colour)).unwrap();
        assert!(opaque[0] == 0.0 && (opaque[1] - 1.0).abs() < 0.02, "{opaque:?}");
        // All pixels have the same alpha: means of straight colours lose nothing.
        let veil = fit(&set([128; 4], colour)).unwrap();
        assert!(veil[1] < 0.02, "{veil:?}");
        // No pixel is partly transparent.
        assert_eq!(fit(&set([255; 4], colour)), Some(vec![0.0, 0.0]));
        let premultiplied = ViewSet { alpha: Alpha::Premultiplied, ..set([255, 0, 255, 0], colour) };
        assert_eq!(fit(&premultiplied), None);
        assert_eq!(fit(&ViewSet { alpha: Alpha::Kept, ..premultiplied }), None, "no opacity, no edge");
    }
}
