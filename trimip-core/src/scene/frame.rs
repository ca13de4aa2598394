//! A rendered image: colour, opacity and depth per pixel.

use crate::scene::edge_exponents;

/// A rendered view, row by row from the upper left pixel.
#[derive(Clone, Debug, PartialEq)]
pub struct Frame {
    /// Width in pixels.
    pub width: u32,
    /// Height in pixels.
    pub height: u32,
    /// `width · height` pixels.
    pub pixels: Vec<Pixel>,
}

/// One composited pixel.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq, bytemuck::Pod, bytemuck::Zeroable)]
pub struct Pixel {
    /// RGB on the background, in the colour values of the training images.
    pub rgb: [f32; 3],
    /// 1 − transmittance of the whole ray, in [0, 1].
    pub opacity: f32,
    /// Σ w·t·cosθ: distance along the optical axis weighted by the samples' weights, world units (not divided by opacity).
    pub depth: f32,
}

impl Pixel {
    /// Returns the mean of a pixel's cones.
    #[inline]
    pub fn mean(cones: &[Self]) -> Self {
        if let [one] = cones {
            return *one;
        }
        let fraction = (cones.len() as f32).recip();
        let mean = |pick: fn(&Self) -> f32| cones.iter().map(pick).sum::<f32>() * fraction;
        Self {
            rgb: [mean(|cone| cone.rgb[0]), mean(|cone| cone.rgb[1]), mean(|cone| cone.rgb[2])],
            opacity: mean(|cone| cone.opacity),
            depth: mean(|cone| cone.depth),
        }
    }

    /// Returns [r, g, b, opacity].
    pub fn channels(&self) -> [f32; 4] {
        let [r, g, b] = self.rgb;
        [r, g, b, self.opacity]
    }
}

impl Frame {
    /// Returns the RGB of every pixel, row by row.
    pub fn rgb(&self) -> Vec<[f32; 3]> {
        self.pixels.iter().map(|pixel| pixel.rgb).collect()
    }

    /// Converts this picture, rendered on `background`, to the picture that photographs of a set with this edge exponent
    /// show, see [`edge_exponents`].
    pub fn shown(mut self, background: [f32; 3], exponent: f32) -> Self {
        for pixel in &mut self.pixels {
            pixel.rgb = edge_exponents::shown(pixel.rgb, pixel.opacity, background, exponent);
        }
        self
    }

    /// Converts this picture, rendered on the background `from`, to the background `to`.
    pub fn moved(&self, from: [f32; 3], to: [f32; 3]) -> Self {
        let moved = |pixel: &Pixel| {
            let clear = 1.0 - pixel.opacity;
            Pixel { rgb: std::array::from_fn(|c| pixel.rgb[c] + clear * (to[c] - from[c])), ..*pixel }
        };
        Self { pixels: self.pixels.iter().map(moved).collect(), ..*self }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn another_background_is_seen_as_far_as_a_pixel_is_clear() {
        let pixel = |rgb, opacity| Pixel { rgb, opacity, depth: 0.0 };
        // (0.4, 0.2, 0.8) with opacity 0.75, composited by hand on white and then on (0, 1, 0.5).
        let frame = Frame {
            width: 3,
            height: 1,
            pixels: vec![pixel([0.55, 0.4, 0.85], 0.75), pixel([0.1; 3], 1.0), pixel([1.0; 3], 0.0)],
        };
        let moved = frame.moved([1.0; 3], [0.0, 1.0, 0.5]).rgb();
        let expected = [[0.3, 0.4, 0.725], [0.1; 3], [0.0, 1.0, 0.5]];
        for (found, expected) in moved.iter().flatten().zip(expected.iter().flatten()) {
            assert!((found - expected).abs() < 1e-6, "{moved:?}");
        }
    }
}
