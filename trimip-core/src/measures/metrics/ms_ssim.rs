//! MS-SSIM of Wang, Simoncelli and Bovik 2003: contrast and structure at five scales, luminance at the coarsest, each raised
//! to the power of its weight. Windows and constants are those of SSIM.

use super::ssim::{WINDOW, gaussian, similarity};

/// The published weights, fine to coarse. They add up to 1.0001.
const WEIGHTS: [f64; 5] = [0.0448, 0.2856, 0.3001, 0.2363, 0.1333];

/// Smallest side, in pixels, of an image that can be measured: one window at the coarsest scale.
pub const LEAST_SIDE: usize = WINDOW << (WEIGHTS.len() - 1);

/// Returns the multi-scale structural similarity, averaged over the channels; NaN for images with a side below
/// [`LEAST_SIDE`], which have no window at the coarsest scale. The images are RGB, [height, width], row by row. The
/// pixels of a scale are means of 2×2 pixels of the next finer scale; a last odd row or column counts twice. A scale
/// whose mean contrast and structure are negative counts as zero, because a power of a negative number is not real.
pub fn ms_ssim(image: &[[f32; 3]], target: &[[f32; 3]], width: usize, height: usize) -> f64 {
    assert_eq!(image.len(), width * height, "image of the stated size");
    assert_eq!(target.len(), width * height, "target of the stated size");
    if width.min(height) < LEAST_SIDE {
        return f64::NAN;
    }
    let window = gaussian(WINDOW);
    let clipped = |image: &[[f32; 3]]| -> Vec<[f32; 3]> {
        image.iter().map(|rgb| rgb.map(|c| c.clamp(0.0, 1.0))).collect()
    };
    let (mut image, mut target, mut width) = (clipped(image), clipped(target), width);
    let mut products = [1.0; 3];
    for (scale, weight) in WEIGHTS.into_iter().enumerate() {
        if scale > 0 {
            (image, target) = (halved(&image, width), halved(&target, width));
            width = width.div_ceil(2);
        }
        for (channel, product) in products.iter_mut().enumerate() {
            let found = similarity(&image, &target, width, channel, &window, &window);
            let last = scale + 1 == WEIGHTS.len();
            let factor = if last { found.whole } else { found.structure };
            // NaN stays NaN.
            *product *= if factor < 0.0 { 0.0 } else { factor.powf(weight) };
        }
    }
    products.iter().sum::<f64>() / 3.0
}

/// Returns the means of 2×2 pixels. The last row and column repeat beyond the image.
fn halved(image: &[[f32; 3]], width: usize) -> Vec<[f32; 3]> {
    let height = image.len() / width;
    let half = |x: usize, y: usize| -> [f32; 3] {
        let (right, below) = ((2 * x + 1).min(width - 1), (2 * y + 1).min(height - 1));
        let four = [(2 * x, 2 * y), (right, 2 * y), (2 * x, below), (right, below)]
            .map(|(x, y)| image[y * width + x]);
        std::array::from_fn(|c| 0.25 * (four[0][c] + four[1][c] + four[2][c] + four[3][c]))
    };
    (0..height.div_ceil(2))
        .flat_map(|y| (0..width.div_ceil(2)).map(move |x| (x, y)))
        .map(|(x, y)| half(x, y))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the colours of a smooth pattern with some noise, computed in integers so that other programs get the same
    /// values.
    fn pattern(width: usize, height: usize, seed: u32) -> Vec<[f32; 3]> {
        let byte = |i: usize, c: u32| {
            let (x, y) = ((i % width) as u32, (i / width) as u32);
            let noise = (x * 7919 + y * 104_729 + c * 31 + seed * 613).wrapping_mul(2_654_435_761) >> 27;
            ((x * (2 + c) + y * 3 + x * y / 64) % 200) + noise * seed
        };
        (0..width * height).map(|i| [0, 1, 2].map(|c| byte(i, c).min(255) as f32 / 255.0)).collect()
    }

    /// Evaluates the published formula in f64: every window as its double sum, every scale from its blocks, for images
    /// whose sides are multiples of 16.
    fn literal(image: &[[f32; 3]], target: &[[f32; 3]], width: usize, height: usize) -> f64 {
        let weight =
            |x: usize, y: usize| (-((x as f64 - 5.0).powi(2) + (y as f64 - 5.0).powi(2)) / 4.5).exp();
        let total: f64 = (0..121).map(|i| weight(i % 11, i / 11)).sum();
        let channel = |c: usize| -> f64 {
            let (mut result, exponents) = (1.0, [0.0448, 0.2856, 0.3001, 0.2363, 0.1333]);
            for (scale, exponent) in exponents.into_iter().enumerate() {
                let block = 1 << scale;
                let (columns, rows) = (width / block, height / block);
                let coarse = |image: &[[f32; 3]]| -> Vec<f64> {
                    let at = |i: usize, j: usize| {
                        (i / columns * block + j / block) * width + i % columns * block + j % block
                    };
                    let mean =
                        |i: usize| (0..block * block).map(|j| f64::from(image[at(i, j)][c])).sum::<f64>();
                    (0..columns * rows).map(|i| mean(i) / (block * block) as f64).collect()
                };
                let (a, b) = (coarse(image), coarse(target));
                let (mut sum, mut count) = (0.0, 0);
                for (left, top) in
                    (0..=rows - 11).flat_map(|top| (0..=columns - 11).map(move |left| (left, top)))
                {
                    let mean = |f: &dyn Fn(usize) -> f64| {
                        let at = |i: usize| (top + i / 11) * columns + left + i % 11;
                        (0..121).map(|i| weight(i % 11, i / 11) * f(at(i))).sum::<f64>() / total
                    };
                    let (ma, mb) = (mean(&|i| a[i]), mean(&|i| b[i]));
                    let (va, vb) = (mean(&|i| (a[i] - ma).powi(2)), mean(&|i| (b[i] - mb).powi(2)));
                    let cov = mean(&|i| (a[i] - ma) * (b[i] - mb));
                    let luminance = (2.0 * ma * mb + 0.0001) / (ma * ma + mb * mb + 0.0001);
                    let structure = (2.0 * cov + 0.0009) / (va + vb + 0.0009);
                    sum += if scale == 4 { luminance * structure } else { structure };
                    count += 1;
                }
                result *= (sum / f64::from(count)).powf(exponent);
            }
            result
        };
        (channel(0) + channel(1) + channel(2)) / 3.0
    }

    #[test]
    fn it_is_the_written_formula() {
        let (width, height) = (192, 176);
        let (a, b) = (pattern(width, height, 1), pattern(width, height, 3));
        let (found, expected) = (ms_ssim(&a, &b, width, height), literal(&a, &b, width, height));
        assert!((found - expected).abs() < 1e-6, "{found}, not {expected}");
        // TensorFlow 2.21 gives this value for these pictures (tf.image.ssim_multiscale), in f32.
        assert!((found - 0.867_602).abs() < 1e-5, "{found}");
    }

    #[test]
    fn it_is_one_for_equal_images_and_known_for_constants() {
        let a = pattern(177, 190, 2);
        assert!((ms_ssim(&a, &a, 177, 190) - 1.0).abs() < 1e-9);
        // Constant images have no contrast, so only the luminance at the coarsest scale is left: (2ab + C1)/(a² + b² + C1).
        let grey = |value: f32| vec![[value; 3]; 176 * 176];
        let expected = ((2.0 * 0.12 + 0.0001) / (0.04 + 0.36 + 0.0001_f64)).powf(0.1333);
        assert!((ms_ssim(&grey(0.2), &grey(0.6), 176, 176) - expected).abs() < 1e-6);
    }

    #[test]
    fn opposed_contrasts_are_zero_and_small_images_are_not_measured() {
        let a = pattern(176, 176, 1);
        let opposed: Vec<[f32; 3]> = a.iter().map(|rgb| rgb.map(|c| 1.0 - c)).collect();
        assert_eq!(ms_ssim(&a, &opposed, 176, 176), 0.0);
        assert!(ms_ssim(&a[..175 * 176], &a[..175 * 176], 176, 175).is_nan());
        assert_eq!(LEAST_SIDE, 176);
    }

    #[test]
    fn means_of_two_by_two_pixels_repeat_the_last_odd_row_and_column() {
        let image = [0.0, 0.2, 0.4, 0.6, 0.8, 1.0].map(|value| [value; 3]);
        let halves: Vec<f32> = halved(&image, 3).iter().map(|rgb| rgb[1]).collect();
        assert_eq!(halves.len(), 2);
        assert!((halves[0] - 0.4).abs() < 1e-6 && (halves[1] - 0.7).abs() < 1e-6, "{halves:?}");
    }
}
