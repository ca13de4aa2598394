//! Measures how far the picture of a film has moved, by block matching between reduced pictures. The chosen frames are spread over the sum
//! of this motion, so a camera at rest yields few frames and a moving camera many.

use crate::grey::Grey;

/// Longest side of the reduced pictures, pixels.
const LONGEST: usize = 160;
/// Side of a block, and radius of the search for it, pixels of the reduced picture.
const SQUARE: usize = 16;
const REACH: usize = 12;
/// Minimum variance of a block that can be matched, grey levels squared.
const TEXTURE: f64 = 20.0;
/// Mean absolute difference at the best match above which a block counts as lost, grey levels.
const LOST: f64 = 24.0;
/// Motion below which the picture counts as still, pixels. Noise shifts blocks by less.
const STILL: f64 = 0.3;
/// Motion after which the anchor is renewed, pixels. The anchor is the picture that later ones are compared with.
const RENEW: f64 = 4.0;

/// Tracks the motion of a film.
#[derive(Default)]
pub struct Follower {
    anchor: Option<Grey>,
    /// Motion up to the anchor, and largest motion so far, pixels of the reduced picture.
    before: f64,
    largest: f64,
}

impl Follower {
    /// Returns the motion of the picture from the first frame to this one, in units of the picture's longest side. It never decreases.
    pub fn follow(&mut self, frame: &Grey) -> f64 {
        let side = frame.width.max(frame.height).div_ceil(LONGEST).max(1);
        let small = frame.reduced(side);
        let longest = small.width.max(small.height).max(1) as f64;
        let Some(anchor) = &self.anchor else {
            self.anchor = Some(small);
            return 0.0;
        };
        let moved = displacement(anchor, &small);
        if moved >= STILL {
            self.largest = self.largest.max(self.before + moved);
        }
        if moved >= RENEW {
            self.before += moved;
            self.anchor = Some(small);
        }
        self.largest / longest
    }
}

/// Returns the median distance by which blocks of `from` have moved in `to`, pixels; for a lost block the distance is [`REACH`].
fn displacement(from: &Grey, to: &Grey) -> f64 {
    let mut found = Vec::new();
    let corners = |side: usize| (REACH..(side.saturating_sub(SQUARE + REACH - 1)).max(REACH)).step_by(SQUARE);
    if from.width < SQUARE + 2 * REACH || from.height < SQUARE + 2 * REACH {
        return 0.0;
    }
    for top in corners(from.height) {
        for left in corners(from.width) {
            if variance(from, left, top) < TEXTURE {
                continue;
            }
            found.push(search(from, to, left, top).unwrap_or(REACH as f64));
        }
    }
    found.sort_by(f64::total_cmp);
    found.get(found.len() / 2).copied().unwrap_or(0.0)
}

fn square(picture: &Grey, left: usize, top: usize) -> impl Iterator<Item = &[u8; SQUARE]> {
    (top..top + SQUARE)
        .filter_map(move |y| picture.pixels.get(y * picture.width + left..)?.first_chunk::<SQUARE>())
}

fn variance(picture: &Grey, left: usize, top: usize) -> f64 {
    let (mut sum, mut squares) = (0_u64, 0_u64);
    for row in square(picture, left, top) {
        for &pixel in row {
            sum += u64::from(pixel);
            squares += u64::from(pixel) * u64::from(pixel);
        }
    }
    let count = (SQUARE * SQUARE) as f64;
    let mean = sum as f64 / count;
    squares as f64 / count - mean * mean
}

/// Returns the distance to the best match of a block, pixels; `None` if the block is lost. A parabola through the smallest difference and
/// its neighbours gives subpixel precision.
fn search(from: &Grey, to: &Grey, left: usize, top: usize) -> Option<f64> {
    const SIDE: usize = 2 * REACH + 1;
    let difference = |x: usize, y: usize| -> u32 {
        let rows = square(from, left, top).zip(square(to, left + x - REACH, top + y - REACH));
        rows.map(|(a, b)| a.iter().zip(b).map(|(a, b)| u32::from(a.abs_diff(*b))).sum::<u32>()).sum()
    };
    let table: Vec<u32> = (0..SIDE * SIDE).map(|i| difference(i % SIDE, i / SIDE)).collect();
    // If matches are equal, the nearest wins, so that a block without texture has not moved.
    let far = |i: usize| (i % SIDE).abs_diff(REACH).pow(2) + (i / SIDE).abs_diff(REACH).pow(2);
    let best = (0..table.len()).min_by_key(|&i| (table[i], far(i)))?;
    if f64::from(table[best]) > LOST * (SQUARE * SQUARE) as f64 {
        return None;
    }
    let at = |index: usize, before: Option<u32>, after: Option<u32>| {
        let (here, fine) = (f64::from(table[best]), index as f64 - REACH as f64);
        let Some((before, after)) = before.zip(after) else { return fine };
        let (before, after) = (f64::from(before), f64::from(after));
        let bend = before + after - 2.0 * here;
        if bend > 0.0 { fine + 0.5 * (before - after) / bend } else { fine }
    };
    let (x, y) = (best % SIDE, best / SIDE);
    let along = |index: usize, step: usize| {
        let before = (index > 0).then(|| table[best - step]);
        let after = (index + 1 < SIDE).then(|| table[best + step]);
        at(index, before, after)
    };
    Some(along(x, 1).hypot(along(y, SIDE)))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns a picture of smooth random waves, shifted by `dx`, `dy`.
    fn waves(dx: f64, dy: f64, noise: u32) -> Grey {
        let (width, height) = (320, 180);
        let mut random = 1_u32;
        let mut pixel = |i: usize| {
            let (x, y) = ((i % width) as f64 + dx, (i / width) as f64 + dy);
            let wave = (0.11 * x).sin() + (0.07 * x + 0.13 * y).sin() + (0.17 * y - 0.05 * x).sin();
            random = random.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (128.0 + 35.0 * wave) as u8 + ((random >> 16) % (noise + 1)) as u8
        };
        let pixels = (0..width * height).map(&mut pixel).collect();
        Grey { width, height, pixels }
    }

    #[test]
    fn motion_is_measured_to_a_fraction_of_a_pixel() {
        for (dx, dy) in [(0.0, 0.0), (3.0, 0.0), (0.0, -5.0), (7.5, 4.0), (1.3, 0.7)] {
            let moved = displacement(&waves(0.0, 0.0, 0).reduced(2), &waves(dx, dy, 0).reduced(2));
            let expected = 0.5 * f64::hypot(dx, dy);
            assert!((moved - expected).abs() < 0.2, "{dx} {dy}: {moved} for {expected}");
        }
    }

    #[test]
    fn a_slow_camera_adds_up_and_a_still_one_does_not() {
        let mut follower = Follower::default();
        let slow = (0..100).map(|i| follower.follow(&waves(0.4 * f64::from(i), 0.0, 3))).last().unwrap();
        assert!((slow - 99.0 * 0.4 / 320.0).abs() < 0.02, "{slow}");
        let mut follower = Follower::default();
        let still = (0..100).map(|i| follower.follow(&waves(0.0, 0.0, 1 + i % 4))).last().unwrap();
        assert_eq!(still, 0.0);
    }

    #[test]
    fn another_picture_is_far_away() {
        let black = Grey { width: 160, height: 90, pixels: vec![0; 160 * 90] };
        assert_eq!(displacement(&waves(0.0, 0.0, 0).reduced(2), &black), REACH as f64);
        assert_eq!(displacement(&black, &black), 0.0);
    }
}
