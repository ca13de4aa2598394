//! Image metrics on RGB values in [0, 1]: PSNR, SSIM of Wang et al. 2004 (a Gaussian window of 11 taps, σ = 1.5, K1 = 0.01,
//! K2 = 0.03, channels averaged, borders left out as in the original), and MS-SSIM at five scales.

mod ms_ssim;
mod ssim;

pub use ms_ssim::{LEAST_SIDE, ms_ssim};
pub use ssim::ssim;

/// Returns −10·log10 of the mean squared error over pixels and channels, in dB; infinite for equal images. Values are
/// clipped to [0, 1], not rounded. The images have one RGB value per pixel, in the same order.
pub fn psnr(image: &[[f32; 3]], target: &[[f32; 3]]) -> f64 {
    psnr_of_error(mean_squared_error(image, target))
}

/// Returns the PSNR in dB, as [`psnr`] does, of `image` rounded to 8 bits, as in a picture file. `target` is not
/// rounded.
pub fn psnr_8bit(image: &[[f32; 3]], target: &[[f32; 3]]) -> f64 {
    let rounded: Vec<[f32; 3]> =
        image.iter().map(|rgb| rgb.map(|c| (255.0 * c.clamp(0.0, 1.0)).round() / 255.0)).collect();
    psnr(&rounded, target)
}

/// Returns the PSNR, in dB, of the best constant image for `target`, its mean colour: the level of a model that learned
/// nothing else. `target` has one RGB value per pixel.
pub fn psnr_of_constant(target: &[[f32; 3]]) -> f64 {
    let count = target.len().max(1) as f64;
    let values = |c: usize| target.iter().map(move |rgb| f64::from(rgb[c].clamp(0.0, 1.0)));
    let variance = (0..3).map(|c| {
        let mean = values(c).sum::<f64>() / count;
        values(c).map(|value| (value - mean).powi(2)).sum::<f64>() / count
    });
    psnr_of_error(variance.sum::<f64>() / 3.0)
}

/// Returns the PSNR of a mean squared error, in dB.
pub fn psnr_of_error(mean_squared_error: f64) -> f64 {
    -10.0 * mean_squared_error.log10()
}

/// Returns the mean over pixels and channels of the squared difference of values clipped to [0, 1]. The images are as in
/// [`psnr`].
pub fn mean_squared_error(image: &[[f32; 3]], target: &[[f32; 3]]) -> f64 {
    assert_eq!(image.len(), target.len(), "images of one size");
    let sum: f64 = image
        .iter()
        .zip(target)
        .flat_map(|(a, b)| {
            (0..3).map(|c| (f64::from(a[c].clamp(0.0, 1.0)) - f64::from(b[c].clamp(0.0, 1.0))).powi(2))
        })
        .sum();
    sum / (3 * image.len()) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(width: usize, height: usize, f: impl Fn(usize, usize) -> f32) -> Vec<[f32; 3]> {
        (0..width * height).map(|i| [f(i % width, i / width); 3]).collect()
    }

    #[test]
    fn psnr_of_a_known_error() {
        let black = image(4, 4, |_, _| 0.0);
        assert!((psnr(&black, &image(4, 4, |_, _| 0.1)) - 20.0).abs() < 1e-5);
        assert_eq!(psnr(&black, &black), f64::INFINITY);
        assert!(
            (psnr(&image(4, 4, |_, _| 7.0), &image(4, 4, |_, _| 0.5)) - 6.0206).abs() < 1e-4,
            "values are clipped"
        );
    }

    #[test]
    fn rounding_to_8_bits_is_a_picture_files() {
        // Rounding changes a value by at most half a step of 1/255; values outside of [0, 1] are clipped.
        let target = [[0.0, 0.5, 1.0]];
        let image = [[-0.2, 127.6 / 255.0, 1.3]];
        let expected = ((128.0 / 255.0 - 0.5_f64).powi(2) / 3.0).log10() * -10.0;
        let found = psnr_8bit(&image, &target);
        assert!((found - expected).abs() < 1e-3, "{found}, not {expected}");
        assert!(psnr(&image, &target) > expected);
    }
}
