//! SSIM of Wang et al. 2004: a Gaussian window of 11 taps, σ = 1.5, K1 = 0.01, K2 = 0.03, channels averaged, borders left out
//! as in the original.

/// Number of taps along each side of a window.
pub(super) const WINDOW: usize = 11;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Returns the structural similarity, averaged over all windows that fit and over the channels. Along a side shorter than
/// the window, the window is as long as that side. The images are RGB, [height, width], row by row.
pub fn ssim(image: &[[f32; 3]], target: &[[f32; 3]], width: usize, height: usize) -> f64 {
    assert_eq!(image.len(), width * height, "image of the stated size");
    assert_eq!(target.len(), width * height, "target of the stated size");
    let across = gaussian(WINDOW.min(width));
    let down = gaussian(WINDOW.min(height));
    (0..3).map(|channel| similarity(image, target, width, channel, &across, &down).whole).sum::<f64>() / 3.0
}

/// Means of one channel's similarities over all windows that fit.
pub(super) struct Similarity {
    /// Luminance times contrast and structure.
    pub whole: f64,
    /// Contrast and structure, without luminance.
    pub structure: f64,
}

/// Returns a normalised Gaussian of `length` taps.
pub(super) fn gaussian(length: usize) -> Vec<f64> {
    let centre = (length - 1) as f64 / 2.0;
    let taps: Vec<f64> =
        (0..length).map(|i| (-(i as f64 - centre).powi(2) / (2.0 * SIGMA * SIGMA)).exp()).collect();
    let sum: f64 = taps.iter().sum();
    taps.into_iter().map(|tap| tap / sum).collect()
}

/// Returns the similarity of one channel, computed from five filtered moments (μx, μy, x², y², xy). Rows are filtered
/// first, into a ring of `down.len()` rows.
pub(super) fn similarity(
    image: &[[f32; 3]],
    target: &[[f32; 3]],
    width: usize,
    channel: usize,
    across: &[f64],
    down: &[f64],
) -> Similarity {
    let columns = width + 1 - across.len();
    let filter_row = |row: usize| -> Vec<[f64; 5]> {
        let x = &image[row * width..][..width];
        let y = &target[row * width..][..width];
        let moments: Vec<[f64; 5]> = x
            .iter()
            .zip(y)
            .map(|(x, y)| {
                let (x, y) = (f64::from(x[channel].clamp(0.0, 1.0)), f64::from(y[channel].clamp(0.0, 1.0)));
                [x, y, x * x, y * y, x * y]
            })
            .collect();
        (0..columns).map(|column| weighted(across, &moments[column..])).collect()
    };
    let height = image.len() / width;
    let mut ring: std::collections::VecDeque<Vec<[f64; 5]>> = (0..down.len() - 1).map(&filter_row).collect();
    let (mut sum, mut structures, mut windows) = (0.0, 0.0, 0_usize);
    for row in down.len() - 1..height {
        ring.push_back(filter_row(row));
        for column in 0..columns {
            let mut moments = [0.0; 5];
            for (tap, line) in down.iter().zip(&ring) {
                for (sum, value) in moments.iter_mut().zip(line[column]) {
                    *sum += tap * value;
                }
            }
            let [mx, my, xx, yy, xy] = moments;
            let luminance = (2.0 * mx * my + C1) / (mx * mx + my * my + C1);
            let structure = (2.0 * (xy - mx * my) + C2) / (xx - mx * mx + yy - my * my + C2);
            sum += luminance * structure;
            structures += structure;
            windows += 1;
        }
        ring.pop_front();
    }
    let windows = windows as f64;
    Similarity { whole: sum / windows, structure: structures / windows }
}

fn weighted(taps: &[f64], values: &[[f64; 5]]) -> [f64; 5] {
    let mut sum = [0.0; 5];
    for (tap, value) in taps.iter().zip(values) {
        for (sum, value) in sum.iter_mut().zip(value) {
            *sum += tap * value;
        }
    }
    sum
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: usize, height: usize, f: impl Fn(usize, usize) -> f32) -> Vec<[f32; 3]> {
        (0..width * height).map(|i| [f(i % width, i / width); 3]).collect()
    }

    #[test]
    fn ssim_is_one_for_equal_images_and_known_for_constants() {
        let a = image(20, 17, |x, y| ((x * 7 + y * 3) % 11) as f32 / 10.0);
        assert!((ssim(&a, &a, 20, 17) - 1.0).abs() < 1e-12);
        // For constant images the structure term is 1 and the luminance term is (2ab + C1)/(a² + b² + C1).
        let (dark, light) = (image(20, 17, |_, _| 0.2), image(20, 17, |_, _| 0.6));
        let expected = (2.0 * 0.12 + C1) / (0.04 + 0.36 + C1);
        assert!((ssim(&dark, &light, 20, 17) - expected).abs() < 1e-6);
        assert!(ssim(&a[..9], &a[..9], 3, 3).is_finite(), "smaller than the window");
    }

    #[test]
    fn ssim_is_the_written_formula_on_one_window() {
        // An 11 × 11 image holds one window, so the literal double sum is the result.
        let a = image(11, 11, |x, y| ((x * x + 3 * y) % 13) as f32 / 12.0);
        let b = image(11, 11, |x, y| ((x + y * y) % 7) as f32 / 6.0);
        let weight =
            |x: usize, y: usize| (-((x as f64 - 5.0).powi(2) + (y as f64 - 5.0).powi(2)) / 4.5).exp();
        let total: f64 = (0..121).map(|i| weight(i % 11, i / 11)).sum();
        let mean =
            |f: &dyn Fn(usize) -> f64| (0..121).map(|i| weight(i % 11, i / 11) * f(i)).sum::<f64>() / total;
        let value = |image: &[[f32; 3]], i: usize| f64::from(image[i][0]);
        let (mx, my) = (mean(&|i| value(&a, i)), mean(&|i| value(&b, i)));
        let vx = mean(&|i| (value(&a, i) - mx).powi(2));
        let vy = mean(&|i| (value(&b, i) - my).powi(2));
        let vxy = mean(&|i| (value(&a, i) - mx) * (value(&b, i) - my));
        let expected = (2.0 * mx * my + C1) * (2.0 * vxy + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2));
        assert!((ssim(&a, &b, 11, 11) - expected).abs() < 1e-9);
    }
}
