//! Patches of photographs around known points, and the pairs of patches of two photographs that show the same point.

use crate::{photograph::Photograph, points::Point};
use trimip_core::Result;

/// Longest side of a photograph in pixels: larger photographs are reduced before they are compared.
const LONGEST: u32 = 1200;

/// Number of samples along a side of a patch, and their spacing in pixels.
const SIDE: usize = 8;
const SPACING: f64 = 3.0;

/// Number of values of a patch.
const LENGTH: usize = SIDE * SIDE;

/// Least correlation of patches that match.
const ALIKE: f32 = 0.6;

/// Largest distance of a match relative to the second best one (Lowe 2004, section 7.1).
const RATIO: f32 = 0.8;

/// A grey photograph.
pub(crate) struct Gray {
    width: usize,
    height: usize,
    values: Vec<f32>,
    /// Pixels of the photograph per pixel of this image, along a side.
    reduction: f64,
}

impl Gray {
    /// Decodes a photograph.
    ///
    /// # Errors
    /// If the photograph cannot be decoded.
    pub(crate) fn open(photograph: &Photograph) -> Result<Self> {
        let pixels = photograph.decode()?;
        Ok(Self::new(pixels.as_chunks().0, photograph.width as usize, photograph.height as usize))
    }

    /// Creates a grey image of [height, width] pixels: the sum of red, green and blue, added over blocks if the
    /// photograph is larger than [`LONGEST`], and slightly blurred.
    pub(super) fn new(pixels: &[[u8; 4]], width: usize, height: usize) -> Self {
        let by = (width.max(height)).div_ceil(LONGEST as usize).max(1);
        let (wide, high) = (width / by, height / by);
        let mut values = vec![0.0_f32; wide * high];
        for (y, row) in values.chunks_exact_mut(wide.max(1)).enumerate() {
            for line in 0..by {
                let own = &pixels[(y * by + line) * width..][..wide * by];
                for (value, block) in row.iter_mut().zip(own.chunks_exact(by)) {
                    *value += block
                        .iter()
                        .map(|[r, g, b, _]| u32::from(*r) + u32::from(*g) + u32::from(*b))
                        .sum::<u32>() as f32;
                }
            }
        }
        let mut gray = Self { width: wide, height: high, values, reduction: by as f64 };
        gray.blur();
        gray
    }

    /// Applies the binomial filter 1 4 6 4 1 twice along each axis, which blurs by a standard deviation of 1.4 pixels.
    fn blur(&mut self) {
        for _ in 0..2 {
            self.blur_along(1, self.width, self.width, self.height);
            self.blur_along(self.width, self.height, 1, self.width);
        }
    }

    /// Blurs `lines` lines of `length` values. The values of a line are `stride` apart, the beginnings of lines `next` apart.
    fn blur_along(&mut self, stride: usize, length: usize, next: usize, lines: usize) {
        let mut line = vec![0.0; length];
        for first in (0..lines).map(|i| i * next) {
            (0..length).for_each(|i| line[i] = self.values[first + i * stride]);
            for i in 0..length {
                let at = |offset: isize| line[(i as isize + offset).clamp(0, length as isize - 1) as usize];
                self.values[first + i * stride] =
                    (at(-2) + at(2) + 4.0 * (at(-1) + at(1)) + 6.0 * at(0)) / 16.0;
            }
        }
    }

    /// Returns the patch around a place of the photograph, with a mean of 0 and a length of 1, or `None` at the border
    /// and in uniform parts.
    fn patch(&self, at: [f64; 2]) -> Option<[f32; LENGTH]> {
        let reach = 0.5 * SPACING * (SIDE - 1) as f64;
        let [x, y] = at.map(|place| place / self.reduction - 0.5 - reach);
        let (right, bottom) = (x + 2.0 * reach, y + 2.0 * reach);
        let inside =
            x >= 0.0 && y >= 0.0 && right < self.width as f64 - 1.0 && bottom < self.height as f64 - 1.0;
        if !inside {
            return None;
        }
        let mut patch = [0.0; LENGTH];
        for (i, value) in patch.iter_mut().enumerate() {
            let (x, y) = (x + SPACING * (i % SIDE) as f64, y + SPACING * (i / SIDE) as f64);
            let (left, top) = (x as usize, y as usize);
            let (right, down) = ((x - left as f64) as f32, (y - top as f64) as f32);
            let row = |line: usize| {
                let pair = &self.values[(top + line) * self.width + left..][..2];
                pair[0] + right * (pair[1] - pair[0])
            };
            *value = row(0) + down * (row(1) - row(0));
        }
        let mean = patch.iter().sum::<f32>() / LENGTH as f32;
        patch.iter_mut().for_each(|value| *value -= mean);
        let length = patch.iter().map(|value| value * value).sum::<f32>().sqrt();
        (length > 1.0).then(|| patch.map(|value| value / length))
    }
}

/// The patches of a photograph.
#[derive(Default)]
pub(super) struct Patches {
    /// The point of each patch.
    points: Vec<u32>,
    /// Places at which the photograph saw the points, pixels.
    places: Vec<[f64; 2]>,
    values: Vec<[f32; LENGTH]>,
}

/// A point of one photograph, and a point of another that looks the same.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Match {
    /// The points.
    pub(super) points: [u32; 2],
    /// Where the second photograph saw its point, pixels.
    pub(super) at: [f64; 2],
}

impl Patches {
    /// Creates the patches of frame `view` around at most `most` of the points `own`: those with the longest tracks.
    pub(super) fn new(gray: &Gray, view: u32, own: &[u32], points: &[Point], most: usize) -> Self {
        let mut own = own.to_vec();
        own.sort_by_key(|&point| (std::cmp::Reverse(points[point as usize].track.len()), point));
        let mut patches = Self::default();
        for point in own {
            if patches.points.len() == most {
                break;
            }
            let seen = points[point as usize].track.iter().find(|seen| seen.view == view);
            if let Some((at, patch)) = seen.and_then(|seen| Some((seen.at, gray.patch(seen.at)?))) {
                patches.points.push(point);
                patches.places.push(at);
                patches.values.push(patch);
            }
        }
        patches
    }

    /// Returns the pairs of patches of `self` and `other` that are each other's best match, clearly better than the second best.
    pub(super) fn matches(&self, other: &Self) -> Vec<Match> {
        let mut back = vec![(f32::MIN, 0); other.values.len()];
        let mut forth = Vec::with_capacity(self.values.len());
        for (i, patch) in self.values.iter().enumerate() {
            let (mut best, mut second) = ((f32::MIN, 0), f32::MIN);
            for (j, (theirs, back)) in other.values.iter().zip(&mut back).enumerate() {
                let alike = correlation(patch, theirs);
                if alike > best.0 {
                    (best, second) = ((alike, j), best.0);
                } else {
                    second = second.max(alike);
                }
                if alike > back.0 {
                    *back = (alike, i);
                }
            }
            forth.push((best, second));
        }
        // For patches of length 1, the squared distance is 2 − 2·correlation.
        let is_clear = |best: f32, second: f32| 1.0 - best < RATIO * RATIO * (1.0 - second);
        let pairs = forth.into_iter().enumerate().filter_map(|(i, ((alike, j), second))| {
            let mutual = back.get(j).is_some_and(|back| back.1 == i);
            (mutual && alike > ALIKE && is_clear(alike, second))
                .then(|| Match { points: [self.points[i], other.points[j]], at: other.places[j] })
        });
        pairs.collect()
    }
}

/// Returns Σ aᵢ·bᵢ, in sixteen partial sums that the compiler vectorises.
fn correlation(a: &[f32; LENGTH], b: &[f32; LENGTH]) -> f32 {
    let mut sums = [0.0; 16];
    for (a, b) in a.as_chunks::<16>().0.iter().zip(b.as_chunks::<16>().0) {
        (0..16).for_each(|i| sums[i] += a[i] * b[i]);
    }
    sums.iter().sum()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::points::Observation;

    /// Returns a picture of waves that repeat nowhere, shifted by `shift` pixels along x.
    fn picture(shift: f64, brightness: f64) -> Gray {
        let (width, height) = (160, 120);
        let value = |x: f64, y: f64| {
            let waves =
                (0.21 * x + 0.0012 * x * y).sin() + (0.3 * y - 0.002 * x * x).sin() + (0.11 * (x - y)).cos();
            (brightness * (127.0 + 40.0 * waves)) as u8
        };
        let pixels: Vec<[u8; 4]> = (0..width * height)
            .map(|i| [value((i % width) as f64 + shift, (i / width) as f64); 3])
            .map(|[r, g, b]| [r, g, b, 255])
            .collect();
        Gray::new(&pixels, width, height)
    }

    fn points(shift: f64, view: u32) -> Vec<Point> {
        let places =
            (0..60).map(|i| [40.0 + f64::from(i % 10) * 8.0 - shift, 20.0 + f64::from(i / 10) * 15.0]);
        let point = |at| Point {
            position: [0.0; 3],
            color: [0; 3],
            error: None,
            seen: None,
            track: vec![Observation { view, at }],
        };
        places.map(point).collect()
    }

    #[test]
    fn patches_match_where_pictures_show_the_same() {
        let all: Vec<u32> = (0..60).collect();
        let one = Patches::new(&picture(0.0, 1.0), 3, &all, &points(0.0, 3), 100);
        let other = Patches::new(&picture(7.0, 0.5), 4, &all, &points(7.0, 4), 100);
        let found = one.matches(&other);
        assert!(found.len() > 40, "{} matches", found.len());
        assert!(found.iter().all(|found| found.points[0] == found.points[1]), "{found:?}");
        let [x, y] = found[0].at;
        assert_eq!([x, y], points(7.0, 4)[found[0].points[1] as usize].track[0].at);
        assert_eq!(Patches::new(&picture(0.0, 1.0), 3, &all, &points(0.0, 3), 5).points.len(), 5);
        // A view that saw none of the points has no patches, and so no matches.
        assert!(Patches::new(&picture(0.0, 1.0), 9, &all, &points(0.0, 3), 100).matches(&one).is_empty());
    }

    #[test]
    fn there_is_no_patch_at_the_border_nor_where_nothing_is_seen() {
        assert!(picture(0.0, 1.0).patch([80.0, 60.0]).is_some());
        assert!(picture(0.0, 1.0).patch([5.0, 60.0]).is_none());
        assert!(picture(0.0, 1.0).patch([80.0, 119.0]).is_none());
        assert!(picture(0.0, 1.0).patch([f64::NAN, 60.0]).is_none());
        assert!(picture(0.0, 0.0).patch([80.0, 60.0]).is_none());
    }

    #[test]
    fn large_photographs_are_reduced() {
        let gray = Gray::new(&vec![[10, 20, 30, 255]; 2500 * 10], 2500, 10);
        assert_eq!((gray.width, gray.height, gray.reduction), (833, 3, 3.0));
        assert!(gray.values.iter().all(|value| (value - 9.0 * 60.0).abs() < 0.01));
    }
}
