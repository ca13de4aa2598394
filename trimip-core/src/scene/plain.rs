//! Plain backgrounds: photographs without alpha that show an object in front of a single colour.

use crate::ViewSet;

/// Largest difference of a channel (0 to 255) from the background colour, which allows for noise and compression.
const NEAR: u8 = 6;

/// Smallest share of all border pixels that must have the background colour: an object may reach the border of some
/// photographs.
const MOST: f64 = 0.95;

/// Smallest share of all pixels that must have another colour: the object.
const LEAST_OBJECT: f64 = 0.005;

/// Returns the colour that the borders of all photographs share, in [0, 1]; `None` if the borders have several colours or
/// alpha, or if no object stands out from the colour.
pub fn colour(views: &ViewSet) -> Option<[f32; 3]> {
    let [finest, coarsest] = [views.scales.first()?, views.scales.last()?];
    let mut borders = Vec::new();
    for index in finest.views.clone() {
        let k = &views.views[index].camera.intrinsics;
        let (width, height) = (k.width as usize, k.height as usize);
        let pixels = views.pixels_of(index);
        let (top, bottom) = (0..width, width * (height - 1)..width * height);
        let sides = (1..height.max(2) - 1).flat_map(|y| [y * width, y * width + width - 1]);
        borders.extend(top.chain(bottom).chain(sides).map(|place| pixels[place]));
    }
    if borders.is_empty() || borders.iter().any(|pixel| pixel[3] < 255) {
        return None;
    }
    let middle: [u8; 3] = std::array::from_fn(|channel| {
        let mut values: Vec<u8> = borders.iter().map(|pixel| pixel[channel]).collect();
        let middle = values.len() / 2;
        *values.select_nth_unstable(middle).1
    });
    let is_near = |pixel: &&[u8; 4]| (0..3).all(|channel| pixel[channel].abs_diff(middle[channel]) <= NEAR);
    let near = borders.iter().filter(is_near).count();
    let pixels = &views.pixels[coarsest.pixels.clone()];
    let others = pixels.iter().filter(|pixel| !is_near(pixel)).count();
    let plain =
        near as f64 >= MOST * borders.len() as f64 && others as f64 >= LEAST_OBJECT * pixels.len() as f64;
    plain.then(|| middle.map(|value| f32::from(value) / 255.0))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Alpha, Camera, Intrinsics, Scale, View};
    use glam::DVec3;

    /// Returns two photographs of 8 × 6 pixels.
    fn views(pixel: impl Fn(usize, u32, u32) -> [u8; 4]) -> ViewSet {
        let camera =
            Camera::look_at(Intrinsics::from_angle(8, 6, 0.7), 4.0 * DVec3::X, DVec3::ZERO, DVec3::Z);
        let view = |i: usize| View { name: format!("{i}"), camera, offset: 48 * i };
        let places = (0..96).map(|i| (i / 48, (i % 8) as u32, (i % 48 / 8) as u32));
        let pixels: Vec<[u8; 4]> = places.map(|(view, x, y)| pixel(view, x, y)).collect();
        let scale = Scale { factor: 1, weight: 1.0, views: 0..2, pixels: 0..96 };
        ViewSet {
            views: (0..2).map(view).collect(),
            pixels: pixels.into(),
            alpha: Alpha::Straight,
            scales: vec![scale],
            depths: Vec::new(),
        }
    }

    #[test]
    fn borders_of_one_colour_are_plain() {
        let inner = |x: u32, y: u32| (1..7).contains(&x) && (1..5).contains(&y);
        let object = |x, y| if inner(x, y) { [9, 99, 200, 255] } else { [250, 252, 249, 255] };
        let white = [250, 252, 249].map(|value: u8| f32::from(value) / 255.0);
        assert_eq!(colour(&views(|_, x, y| object(x, y))), Some(white));
        // The photographs have noise, and one pixel of the object lies at the border of one view.
        let noisy = |view: usize, x: u32, y: u32| match object(x, y) {
            [250, g, b, a] if (view, x, y) != (1, 0, 3) => [250 - (x % 5) as u8, g, b, a],
            _ => [9, 99, 200, 255],
        };
        let found = colour(&views(noisy)).unwrap();
        assert!((found[0] - white[0]).abs() < 0.02, "{found:?}");
        let other = |view: usize, x: u32, y: u32| {
            if view == 1 && !inner(x, y) { [90, 90, 90, 255] } else { object(x, y) }
        };
        assert_eq!(colour(&views(other)), None, "each view has its own colour");
        assert_eq!(colour(&views(|_, _, _| [250, 252, 249, 255])), None, "there is nothing before it");
        let clear = |_: usize, x: u32, y: u32| if inner(x, y) { [9, 99, 200, 255] } else { [0; 4] };
        assert_eq!(colour(&views(clear)), None, "alpha tells more");
    }
}
