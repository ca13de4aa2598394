//! The difference between a rendering and its photograph as a picture with a scale: the mean absolute difference over
//! red, green and blue, as a fraction of the full range. The colours run from black (zero) over red to pale yellow (a
//! quarter or more).

use image::{Rgb, RgbImage};
use trimip::view::flip_colors;

/// Difference at the bright end of the scale, as a fraction of the full range.
const MOST: f32 = 0.25;

/// Colours from zero to [`MOST`], evenly spaced. Brighter is worse, so the scale also reads without colour vision (six
/// entries of matplotlib's `inferno`, by S. van der Walt and N. Smith).
const COLORS: [[u8; 3]; 6] =
    [[0, 0, 4], [66, 10, 104], [147, 38, 103], [221, 81, 58], [252, 165, 10], [252, 255, 164]];

/// Returns the difference map of two pictures of the same size.
pub fn map(rendered: &RgbImage, photograph: &RgbImage) -> RgbImage {
    RgbImage::from_fn(rendered.width(), rendered.height(), |x, y| {
        let (a, b) = (rendered.get_pixel(x, y).0, photograph.get_pixel(x, y).0);
        let sum: u32 = a.iter().zip(b).map(|(&a, b)| u32::from(a.abs_diff(b))).sum();
        Rgb(color(sum as f32 / (3.0 * 255.0)))
    })
}

/// Returns the colour of a difference, interpolated linearly between [`COLORS`].
fn color(difference: f32) -> [u8; 3] {
    let last = COLORS.len() - 1;
    let place = (difference / MOST).clamp(0.0, 1.0) * last as f32;
    let before = (place as usize).min(last - 1);
    let fraction = place - before as f32;
    std::array::from_fn(|c| {
        let (a, b) = (f32::from(COLORS[before][c]), f32::from(COLORS[before + 1][c]));
        (a + fraction * (b - a)).round() as u8
    })
}

/// Returns the scale as HTML: a bar of the colours with the differences that they stand for below.
pub fn bar() -> String {
    let steps = COLORS.len() - 1;
    let label = |i: usize| {
        let more = if i == steps { "≥ " } else { "" };
        format!("{more}{:.0} %", 100.0 * MOST * i as f32 / steps as f32)
    };
    bar_of(&COLORS, (0..=steps).map(label))
}

/// Returns the scale of FLIP errors as HTML; `None` if this build has no FLIP.
pub fn flip_bar() -> Option<String> {
    let errors: [f32; 6] = std::array::from_fn(|i| i as f32 / 5.0);
    let colors = flip_colors(6, 1, &errors)?;
    let colors: Vec<[u8; 3]> = colors.pixels().map(|pixel| pixel.0).collect();
    Some(bar_of(&colors, errors.iter().map(|error| format!("{error:.1}"))))
}

/// Returns a bar of evenly spaced colours with labels below.
fn bar_of(colors: &[[u8; 3]], labels: impl Iterator<Item = String>) -> String {
    let stops: Vec<String> = colors.iter().map(|[r, g, b]| format!("rgb({r},{g},{b})")).collect();
    format!(
        "<div class=\"bar\"><i style=\"background:linear-gradient(to right,{})\"></i><div>{}</div></div>",
        stops.join(","),
        labels.map(|label| format!("<span>{label}</span>")).collect::<String>()
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_pictures_are_black_and_a_quarter_of_the_range_is_brightest() {
        let grey = |value| RgbImage::from_pixel(2, 1, Rgb([value; 3]));
        assert_eq!(map(&grey(100), &grey(100)).get_pixel(1, 0).0, COLORS[0]);
        assert_eq!(map(&grey(0), &grey(64)).get_pixel(0, 0).0, COLORS[5]);
        assert_eq!(map(&grey(255), &grey(0)).get_pixel(0, 0).0, COLORS[5]);
    }

    #[test]
    fn brightness_rises_with_the_difference() {
        let brightness = |i: usize| color(i as f32 / 400.0).iter().map(|&c| u32::from(c)).sum::<u32>();
        assert!((0..100).all(|i| brightness(i) <= brightness(i + 1)));
    }

    #[test]
    fn the_scale_names_its_ends() {
        assert!(bar().contains("<span>0 %</span>") && bar().contains("<span>≥ 25 %</span>"));
    }
}
