//! A grey picture: its sharpness, its brightness, and its reduction to a small size.

/// A picture of grey levels, row by row.
#[derive(Clone, Debug, PartialEq)]
pub struct Grey {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Grey levels.
    pub pixels: Vec<u8>,
}

impl Grey {
    /// Returns the variance of the Laplacian over the picture, grey levels squared. Blur lowers it (Pech-Pacheco et al.
    /// 2000). Noise raises it, so only pictures from the same camera and of the same subject can be compared.
    pub fn sharpness(&self) -> f64 {
        let (width, height) = (self.width, self.height);
        if width < 3 || height < 3 {
            return 0.0;
        }
        let (mut sum, mut squares) = (0_i64, 0_i64);
        for y in 1..height - 1 {
            let row = |y: usize| &self.pixels[y * width..(y + 1) * width];
            let (above, here, below) = (row(y - 1), row(y), row(y + 1));
            for x in 1..width - 1 {
                let around = i32::from(above[x])
                    + i32::from(below[x])
                    + i32::from(here[x - 1])
                    + i32::from(here[x + 1]);
                let value = i64::from(around - 4 * i32::from(here[x]));
                sum += value;
                squares += value * value;
            }
        }
        let count = ((width - 2) * (height - 2)) as f64;
        let mean = sum as f64 / count;
        squares as f64 / count - mean * mean
    }

    /// Returns the mean grey level, 0 to 255.
    pub fn brightness(&self) -> f64 {
        let sum: u64 = self.pixels.iter().map(|&pixel| u64::from(pixel)).sum();
        sum as f64 / self.pixels.len().max(1) as f64
    }

    /// Returns the picture reduced by averaging squares of `side` pixels; incomplete squares at the edges are cut off.
    pub fn reduced(&self, side: usize) -> Self {
        let (width, height) = (self.width / side, self.height / side);
        let mut pixels = Vec::with_capacity(width * height);
        let area = (side * side) as u32;
        for y in 0..height {
            for x in 0..width {
                let mut sum = area / 2;
                for row in y * side..(y + 1) * side {
                    let start = row * self.width + x * side;
                    sum +=
                        self.pixels[start..start + side].iter().map(|&pixel| u32::from(pixel)).sum::<u32>();
                }
                pixels.push((sum / area) as u8);
            }
        }
        Self { width, height, pixels }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn blur_takes_sharpness_away_and_brightness_stays() {
        let side = 64;
        let pixel = |x: usize, y: usize| if (x / 4 + y / 4).is_multiple_of(2) { 40 } else { 200 };
        let pixels = (0..side * side).map(|i| pixel(i % side, i / side)).collect();
        let sharp = Grey { width: side, height: side, pixels };
        let near = |i: usize| {
            let (x, y) = (i % side, i / side);
            let sum: u32 = (0..3).map(|d| u32::from(pixel((x + d).min(side - 1), y))).sum();
            (sum / 3) as u8
        };
        let blurred = Grey { pixels: (0..side * side).map(near).collect(), ..sharp.clone() };
        assert!(
            blurred.sharpness() < 0.7 * sharp.sharpness(),
            "{} {}",
            blurred.sharpness(),
            sharp.sharpness()
        );
        assert!((sharp.brightness() - 120.0).abs() < 1e-9);
        let small = sharp.reduced(8);
        assert_eq!((small.width, small.height, small.pixels[0]), (8, 8, 120));
        assert_eq!(Grey { width: 2, height: 2, pixels: vec![0; 4] }.sharpness(), 0.0);
    }
}
