//! Thumbnails of evenly spread frames and of suspicious ones. Transparent and masked pixels show a checkerboard.

use super::super::{page::escape, pictures};
use image::{Rgb, RgbImage, imageops};
use std::collections::HashMap;
use trimip::data::checks::{coarsest, stops};
use trimip::inspect::Inspection;
use trimip::{Alpha, Camera, Result, ViewSet};

/// Number of evenly spread frames, and maximum number of suspicious frames that are shown in addition.
const SPREAD: usize = 24;
const SUSPICIOUS: usize = 12;

/// Longest side of a thumbnail, pixels.
const LONGEST: u32 = 200;

/// Minimum side of the scale that a thumbnail is made from, pixels; if no scale is as large, the finest one is used.
const SOURCE: u32 = 150;

/// Number of checkerboard squares along the longer side.
const SQUARES: u32 = 24;

/// The two colours of the board: grey for transparent pixels, red for masked ones.
const EMPTY: [[u8; 3]; 2] = [[255, 255, 255], [204, 204, 204]];
const IGNORED: [[u8; 3]; 2] = [[250, 205, 205], [226, 150, 150]];

/// Returns the section with the thumbnails; empty without frames.
pub fn section(seen: &Inspection, doubts: &HashMap<usize, Vec<String>>) -> Result<String> {
    let train = seen.seen.scene.train.scales.first().map_or(0, |scale| scale.views.len());
    let all = train + seen.seen.scene.test_views.len();
    let count = all.min(SPREAD);
    let mut shown: Vec<usize> = (0..count).map(|i| i * all / count).collect();
    let mut doubted: Vec<usize> = doubts.keys().copied().filter(|view| !shown.contains(view)).collect();
    doubted.sort_unstable();
    doubted.truncate(SUSPICIOUS);
    shown.extend(doubted);
    shown.sort_unstable();
    if shown.is_empty() {
        return Ok(String::new());
    }
    let figure = |&index: &usize| {
        let doubts = doubts.get(&index).map_or(&[][..], Vec::as_slice);
        match index < train {
            true => trained(seen, index, doubts),
            false => tested(seen, index - train),
        }
    };
    let figures = shown.iter().map(figure).collect::<Result<Vec<String>>>()?.concat();
    let board = match seen.seen.scene.train.alpha {
        Alpha::Kept => "Masked pixels show a red checkerboard.",
        Alpha::Straight | Alpha::Premultiplied => "Transparent pixels show a grey checkerboard.",
    };
    Ok(format!(
        "<section><h2>Frames</h2><p class=\"lead\">{} of {all} frames, evenly spread; suspicious ones are added. {board} \
         Brightness is the mean of linear light in stops: 0 is white, −1 half of it.</p><div class=\"wide \
         thumbs\">{figures}</div></section>\n",
        shown.len()
    ))
}

fn trained(seen: &Inspection, view: usize, doubts: &[String]) -> Result<String> {
    let train = &seen.seen.scene.train;
    let camera = |index: usize| train.views[index].camera;
    let (Some(finest), Some(scale)) = (train.scales.first(), coarsest(train, SOURCE)) else {
        return Ok(String::new());
    };
    let name = &train.views[finest.views.start + view].name;
    thumbnail(train, scale.views.start + view, name, &camera(finest.views.start + view), "training", doubts)
}

fn tested(seen: &Inspection, index: usize) -> Result<String> {
    let Some((name, camera)) = seen.seen.scene.test_views.get(index) else { return Ok(String::new()) };
    let set = seen.seen.scene.test.load(index)?;
    let Some(scale) = coarsest(&set, SOURCE) else { return Ok(String::new()) };
    thumbnail(&set, scale.views.start, name, camera, "test", &[])
}

/// Returns a view of a set as an HTML figure; `camera` is the camera of the photograph at full size.
fn thumbnail(
    set: &ViewSet,
    index: usize,
    name: &str,
    camera: &Camera,
    split: &str,
    doubts: &[String],
) -> Result<String> {
    let k = &camera.intrinsics;
    let brightness = stops(set.pixels_of(index), set.alpha)
        .map_or("no pixel is kept".into(), |stops| format!("{stops:.2} stops"));
    let focal = match (k.fx - k.fy).abs() < 1e-3 * k.fx {
        true => format!("{:.0}", k.fx),
        false => format!("{:.0}×{:.0}", k.fx, k.fy),
    };
    let doubts: String =
        doubts.iter().map(|doubt| format!("<b class=\"badge bad\">{}</b> ", escape(doubt))).collect();
    Ok(format!(
        "<figure>{}<figcaption><b>{}</b> {split}<br>{}×{}, f {focal}<br>{brightness} {doubts}</figcaption></figure>",
        pictures::thumbnail(&shrunk(&boarded(set, index)), name)?,
        escape(name),
        k.width,
        k.height
    ))
}

/// Draws a view over the checkerboard.
fn boarded(set: &ViewSet, index: usize) -> RgbImage {
    let k = &set.views[index].camera.intrinsics;
    let pixels = set.pixels_of(index);
    let square = k.width.max(k.height).div_ceil(SQUARES).max(1);
    let board = if set.alpha == Alpha::Kept { IGNORED } else { EMPTY };
    RgbImage::from_fn(k.width, k.height, |x, y| {
        let pixel = pixels[(y * k.width + x) as usize];
        let alpha = u32::from(pixel[3]);
        let coverage = if set.alpha == Alpha::Premultiplied { 255 } else { alpha };
        let behind = board[((x / square + y / square) % 2) as usize];
        Rgb([0, 1, 2].map(|c| {
            let sum = u32::from(pixel[c]) * coverage + (255 - alpha) * u32::from(behind[c]);
            ((sum + 127) / 255).min(255) as u8
        }))
    })
}

/// Reduces a picture so that its sides are at most [`LONGEST`].
fn shrunk(picture: &RgbImage) -> RgbImage {
    let (width, height) = picture.dimensions();
    let longest = width.max(height);
    if longest <= LONGEST {
        return picture.clone();
    }
    let side = |side: u32| (u64::from(side) * u64::from(LONGEST) / u64::from(longest)).max(1) as u32;
    imageops::thumbnail(picture, side(width), side(height))
}
