//! SSIM of Wang et al. 2004: Gaussian window 11, σ = 1.5, K1 = 0.01, K2 = 0.03, channels averaged, borders left out as in the
//! original.

/// Taps along each side of a window.
pub(super) const WINDOW: usize = 11;
const SIGMA: f64 = 1.5;
const C1: f64 = 0.01 * 0.01;
const C2: f64 = 0.03 * 0.03;

/// Structural similarity, the mean over all windows that fit and over the channels. An image smaller than the window is
/// one window of its own size.
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
    /// Contrast and structure alone.
    pub structure: f64,
}

/// Normalised Gaussian of `length` taps.
pub(super) fn gaussian(length: usize) -> Vec<f64> {
    let centre = (length - 1) as f64 / 2.0;
    let taps: Vec<f64> =
        (0..length).map(|i| (-(i as f64 - centre).powi(2) / (2.0 * SIGMA * SIGMA)).exp()).collect();
    let sum: f64 = taps.iter().sum();
    taps.into_iter().map(|tap| tap / sum).collect()
}

/// One channel: five filtered moments (μx, μy, x², y², xy), rows first into a ring of `down.len()` rows.
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
