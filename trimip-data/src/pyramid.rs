//! An image at 1, 1/2, 1/4, ..: repeated 2×2 means of RGBA in f32 of value/255. Each level is made from the unrounded
//! level before it. An odd last row or column is cropped at each level. Where alpha is the kept share of a pixel,
//! colours are means with these shares as weights.

use trimip_core::{Alpha, config::Convention};

/// Builds `scales` levels, fine to coarse, of an image of `width` × `height` pixels, stored as `convention` says: straight
/// RGBA truncated to 8 bits, or premultiplied RGBA rounded to 8 bits. Pixels lie row by row; level j has `height >> j` rows
/// of `width >> j` pixels. A level without pixels is empty.
pub fn build(
    base: &[[u8; 4]],
    width: usize,
    height: usize,
    scales: u32,
    convention: Convention,
) -> Vec<Vec<[u8; 4]>> {
    let mut levels: Vec<Vec<[u8; 4]>> = (0..scales)
        .map(|level| {
            let side = |length: usize| length.checked_shr(level).unwrap_or(0);
            vec![[0; 4]; side(width) * side(height)]
        })
        .collect();
    let mut slices: Vec<&mut [[u8; 4]]> = levels.iter_mut().map(Vec::as_mut_slice).collect();
    fill(base, width, height, convention.into(), &mut slices);
    levels
}

/// Builds levels as [`build`] does, for any kind of alpha and into given slices. `levels[j]` holds (width >> j)·(height >>
/// j) pixels, or none if the level is not wanted. For [`Alpha::Kept`], colours are rounded, and black where nothing is kept.
pub(crate) fn fill(
    base: &[[u8; 4]],
    width: usize,
    height: usize,
    alpha: Alpha,
    levels: &mut [&mut [[u8; 4]]],
) {
    let Some((finest, coarser)) = levels.split_first_mut() else { return };
    let unit = |&pixel: &[u8; 4]| match alpha {
        Alpha::Straight => straight(pixel),
        Alpha::Premultiplied | Alpha::Kept => premultiplied(pixel),
    };
    if alpha == Alpha::Straight && !finest.is_empty() {
        finest.copy_from_slice(base);
    } else {
        for (stored, pixel) in finest.iter_mut().zip(base) {
            *stored = store(unit(pixel), alpha);
        }
    }
    let Some((second, coarser)) = coarser.split_first_mut() else { return };
    let mut means = halve(base, width, height, unit);
    write(&means, second, alpha);
    let (mut width, mut height) = (width / 2, height / 2);
    for level in coarser {
        means = halve(&means, width, height, |&pixel| pixel);
        (width, height) = (width / 2, height / 2);
        write(&means, level, alpha);
    }
}

/// Returns 2×2 means, added in reading order: another order rounds differently from the public converter.
fn halve<P>(pixels: &[P], width: usize, height: usize, value: impl Fn(&P) -> [f32; 4]) -> Vec<[f32; 4]> {
    let mut means = Vec::with_capacity((width / 2) * (height / 2));
    for y in 0..height / 2 {
        let upper = &pixels[2 * y * width..][..width];
        let lower = &pixels[(2 * y + 1) * width..][..width];
        for (upper, lower) in upper.chunks_exact(2).zip(lower.chunks_exact(2)) {
            let [a, b] = [value(&upper[0]), value(&upper[1])];
            let [c, d] = [value(&lower[0]), value(&lower[1])];
            means.push(std::array::from_fn(|i| (((a[i] + b[i]) + c[i]) + d[i]) * 0.25));
        }
    }
    means
}

fn write(means: &[[f32; 4]], level: &mut [[u8; 4]], alpha: Alpha) {
    for (stored, &mean) in level.iter_mut().zip(means) {
        *stored = store(mean, alpha);
    }
}

fn straight(pixel: [u8; 4]) -> [f32; 4] {
    pixel.map(|byte| f32::from(byte) / 255.0)
}

fn premultiplied(pixel: [u8; 4]) -> [f32; 4] {
    let [r, g, b, a] = straight(pixel);
    [r * a, g * a, b * a, a]
}

fn store(pixel: [f32; 4], alpha: Alpha) -> [u8; 4] {
    let rounded = |pixel: [f32; 4]| pixel.map(|value| (255.0 * value).round() as u8);
    let [r, g, b, kept] = pixel;
    match alpha {
        Alpha::Straight => pixel.map(|value| (255.0 * value) as u8),
        Alpha::Premultiplied => rounded(pixel),
        Alpha::Kept if kept > 0.0 => rounded([r / kept, g / kept, b / kept, kept]),
        Alpha::Kept => [0; 4],
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn truncation_and_rounding_keep_every_byte_of_the_finest_level() {
        for byte in 0..=255_u8 {
            let pixel = [byte; 4];
            assert_eq!(store(straight(pixel), Alpha::Straight), pixel);
            assert_eq!(store(straight(pixel), Alpha::Premultiplied), pixel);
            for fraction in 1..=255 {
                let pixel = [byte, 0, 255, fraction];
                assert_eq!(store(premultiplied(pixel), Alpha::Kept), pixel);
            }
        }
    }

    #[test]
    fn what_is_not_kept_has_no_part_in_any_level() {
        let kept = |i: usize| [200, 10 * i as u8, 0, 255];
        let levels = |garbage: [u8; 4]| {
            // Blocks of 2×2 pixels: one and none of the pixels are kept in the upper two blocks, four and two in the lower ones.
            let base: Vec<[u8; 4]> = (0..16)
                .map(|i| if [0, 8, 9, 12, 13, 10, 15].contains(&i) { kept(i) } else { garbage })
                .collect();
            let mut levels = [vec![[9; 4]; 16], vec![[9; 4]; 4], vec![[9; 4]; 1]];
            fill(&base, 4, 4, Alpha::Kept, &mut levels.each_mut().map(Vec::as_mut_slice));
            levels
        };
        let found = levels([0; 4]);
        assert_eq!(found[1], [[200, 0, 0, 64], [0; 4], [200, 105, 0, 255], [200, 125, 0, 128]]);
        // The seven kept pixels have a mean green of 670/7 = 95.7, and they are 7/16 of all pixels.
        assert_eq!(found[2], [[200, 96, 0, 112]]);
        for garbage in [[255, 255, 255, 0], [1, 2, 3, 0]] {
            assert_eq!(levels(garbage), found);
        }
    }

    #[test]
    fn the_public_convention_truncates_straight_means() {
        let base = [[255, 1, 0, 255], [0, 0, 0, 0], [0, 0, 3, 0], [0, 0, 0, 0]];
        // 255/4 = 63.75, 1/4 and 3/4 are truncated, not rounded; colour is not weighted by alpha.
        assert_eq!(build(&base, 2, 2, 2, Convention::Public)[1], [[63, 0, 0, 63]]);
        // Premultiplied: only the opaque pixel contributes colour; 63.75 rounds to 64.
        assert_eq!(build(&base, 2, 2, 2, Convention::Premultiplied)[1], [[64, 0, 0, 64]]);
    }

    #[test]
    fn rounding_happens_once_however_many_levels_lie_between() {
        // All pixels but one are black: the means are 128/16 = 8, 2/16 = 0.125 → 0 and 255/16 = 15.9 → 16.
        let mut base = [[0, 0, 0, 255]; 16];
        base[5] = [128, 2, 255, 255];
        let levels = build(&base, 4, 4, 3, Convention::Premultiplied);
        assert_eq!(levels[2], [[8, 0, 16, 255]]);

        // Blocks of 2×2 pixels with one of value 3, per quarter of the image. Their means of 0.75 round to 1, and ten of 16 such
        // blocks to 1 again; the mean of the image is 30/64, which rounds to 0.
        let mut base = [[0, 0, 0, 255]; 64];
        for (quarter, blocks) in [4, 3, 3, 0].into_iter().enumerate() {
            for block in 0..blocks {
                let (x, y) = (4 * (quarter % 2) + 2 * (block % 2), 4 * (quarter / 2) + 2 * (block / 2));
                base[8 * y + x][0] = 3;
            }
        }
        let levels = build(&base, 8, 8, 4, Convention::Premultiplied);
        assert_eq!(levels[1].iter().filter(|pixel| pixel[0] == 1).count(), 10);
        assert_eq!(levels[3], [[0, 0, 0, 255]]);
    }

    #[test]
    fn odd_rows_and_columns_are_cropped_at_each_level() {
        let base: Vec<[u8; 4]> = (0..7 * 5).map(|i| [i, 0, 0, 255]).collect();
        let levels = build(&base, 7, 5, 3, Convention::Public);
        assert_eq!(levels.iter().map(Vec::len).collect::<Vec<_>>(), [35, 6, 1]);
        let mean = |x: usize, y: usize| {
            let sum: u32 = [(0, 0), (1, 0), (0, 1), (1, 1)]
                .iter()
                .map(|(i, j)| u32::from(base[(2 * y + j) * 7 + 2 * x + i][0]))
                .sum();
            (sum / 4) as u8
        };
        assert_eq!(levels[1][5][0], mean(2, 1));
    }

    proptest! {
        /// Checks the purpose of the premultiplied pyramid: on any background, every level has the mean of the
        /// composited image, up to the rounding to 8 bits.
        #[test]
        fn premultiplied_levels_keep_the_composited_mean(
            base in prop::collection::vec(any::<[u8; 4]>(), 64),
            background in 0.0_f32..=1.0,
        ) {
            let exact = base.iter().map(|&[r, _, _, a]| {
                let alpha = f32::from(a) / 255.0;
                f32::from(r) / 255.0 * alpha + (1.0 - alpha) * background
            }).sum::<f32>() / 64.0;
            for level in build(&base, 8, 8, 4, Convention::Premultiplied) {
                let mean = level.iter().map(|&[r, _, _, a]| {
                    f32::from(r) / 255.0 + (1.0 - f32::from(a) / 255.0) * background
                }).sum::<f32>() / level.len() as f32;
                // Half a step of 1/255 each for colour and alpha.
                prop_assert!((mean - exact).abs() < 1.01 / 255.0);
            }
        }
    }
}
