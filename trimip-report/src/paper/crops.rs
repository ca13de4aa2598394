//! Crops of the same parts of the same test views for all systems, at every scale, with error maps. A crop is the part
//! of the photograph with the most detail, so the choice does not depend on a system.

use super::look::mark;
use crate::comparison::{Comparison, Scales};
use crate::{difference, page::escape, pictures};
use image::{RgbImage, imageops};
use std::path::PathBuf;
use trimip::report::scale_name;
use trimip::run::store::{FileStore, ViewRecord};
use trimip::systems::System;
use trimip::{Result, RunFolder};

/// Number of views per scene: in a comparison on one scene, and on several.
const VIEWS: [usize; 2] = [2, 1];
/// Side of a view divided by the side of its crop.
const PART: u32 = 4;
/// Smallest side of a crop at the finest scale, pixels.
const LEAST: u32 = 32;
/// Distance between candidate crops in pixels of the finest scale, a whole number of pixels at every scale.
const STEP: u32 = 8;
/// Longest side of the small view that shows where a crop is, pixels.
const SMALL: u32 = 300;

/// A part of a view, in pixels of the finest scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Crop {
    x: u32,
    y: u32,
    width: u32,
    height: u32,
}

impl Crop {
    /// Crops a picture that is `scale` times as coarse as the finest scale.
    fn of(self, picture: &RgbImage, scale: u32) -> RgbImage {
        let side = |side: u32| (side / scale).max(1);
        let (x, y) = (self.x / scale, self.y / scale);
        imageops::crop_imm(picture, x, y, side(self.width), side(self.height)).to_image()
    }
}

/// A system's pictures for a scene.
struct Shown {
    system: &'static System,
    images: PathBuf,
    views: Vec<ViewRecord>,
}

impl Shown {
    /// Returns the record of a frame at a scale, if it has pictures.
    fn view(&self, index: usize, scale: u32) -> Option<&ViewRecord> {
        self.views.iter().find(|view| view.index == index && view.scale == scale && view.comparison.is_some())
    }

    /// Returns the rendering and photograph of a frame at a scale.
    fn pictures(&self, index: usize, scale: u32) -> Option<[RgbImage; 2]> {
        pictures::compared(&self.images, self.view(index, scale)?)
    }
}

/// Returns the section of crops below a table; empty without pictures.
pub fn section(comparison: &Comparison, scales: Scales) -> Result<String> {
    let most = VIEWS[usize::from(comparison.scenes.len() > 1)];
    let mut html = String::new();
    for scene in &comparison.scenes {
        let shown = shown(comparison, scales, scene);
        let Some(first) = shown.first() else { continue };
        let scale = first.views.iter().map(|view| view.scale).min().unwrap_or(1);
        let common = first.views.iter().filter(|view| {
            view.scale == scale && shown.iter().all(|other| other.view(view.index, scale).is_some())
        });
        for view in common.take(most) {
            html += &crops(scene, &shown, view)?;
        }
    }
    if html.is_empty() {
        return Ok(html);
    }
    Ok(format!(
        "<section class=\"wide\"><h2>The same places, {}</h2><p class=\"lead\">Crops where the photograph has the most detail, from the first \
         seed of each system. Below each rendering: the PSNR of its whole view at that scale, and the error as the mean absolute \
         difference of red, green and blue.</p><div class=\"short-bar\">{}</div>{html}</section>\n",
        scales.title().to_lowercase(),
        difference::bar()
    ))
}

/// Returns the systems with pictures of a scene; the pictures are those of the first run that has any.
fn shown(comparison: &Comparison, scales: Scales, scene: &str) -> Vec<Shown> {
    let of = |system: &&'static System| {
        comparison
            .runs_of(scales, scene, system.name)
            .into_iter()
            .filter(|run| run.figures.is_some())
            .find_map(|run| {
                let folder = RunFolder::new(&run.folder);
                let mut views = FileStore::read(&folder);
                views.retain(|view| view.comparison.is_some());
                (!views.is_empty()).then(|| Shown { system, images: folder.images(), views })
            })
    };
    comparison.systems.iter().filter_map(of).collect()
}

/// Returns the crops of a view: one row per scale, one column per system.
fn crops(scene: &str, shown: &[Shown], view: &ViewRecord) -> Result<String> {
    let Some([_, photograph]) = shown.first().and_then(|first| first.pictures(view.index, view.scale)) else {
        return Ok(String::new());
    };
    let place = most_detail(&photograph);
    let mut head = "<th class=\"s\"></th><th class=\"photo\">photograph</th>".to_string();
    for own in shown {
        head += &format!("<th>{}{}</th>", mark(own.system.name), escape(own.system.title));
    }
    let mut scales: Vec<u32> =
        shown[0].views.iter().filter(|own| own.index == view.index).map(|own| own.scale).collect();
    scales.sort_unstable();
    let mut rows = String::new();
    for scale in scales {
        let coarser = scale / view.scale;
        let Some([_, photograph]) = shown[0].pictures(view.index, scale) else { continue };
        let photograph = place.of(&photograph, coarser);
        let name = if scale == 1 { "1/1".into() } else { scale_name(scale) };
        rows += &format!(
            "<tr><td class=\"s\">{name}</td><td class=\"photo\">{}</td>",
            pictures::embedded(photograph.clone(), "photograph")?
        );
        let mut errors = "<tr class=\"errors\"><td class=\"s\"></td><td class=\"photo\"></td>".to_string();
        for own in shown {
            let Some([rendered, _]) = own.pictures(view.index, scale) else {
                rows += "<td>–</td>";
                errors += "<td></td>";
                continue;
            };
            let rendered = place.of(&rendered, coarser);
            let psnr = own.view(view.index, scale).and_then(|view| view.psnr);
            let heat = difference::map(&rendered, &photograph);
            rows += &format!("<td>{}</td>", pictures::embedded(rendered, own.system.title)?);
            errors += &format!(
                "<td><p>{}</p>{}</td>",
                psnr.map_or("no number".into(), |psnr| format!("{psnr:.2} dB")),
                pictures::embedded(heat, "error")?
            );
        }
        rows += "</tr>";
        rows += &errors;
        rows += "</tr>";
    }
    Ok(format!(
        "<div class=\"where\">{}<h3>{}, {}</h3></div><div class=\"crops\" style=\"--columns:{}\"><table><tr>{head}</tr>{rows}</table></div>",
        whereabouts(&photograph, place)?,
        escape(scene),
        escape(&view.name),
        shown.len() + 1
    ))
}

/// Returns a small version of the whole photograph with a frame around the crop.
fn whereabouts(photograph: &RgbImage, place: Crop) -> Result<String> {
    let (width, height) = photograph.dimensions();
    let fraction = |part: u32, whole: u32| 100.0 * f64::from(part) / f64::from(whole.max(1));
    let longest = width.max(height);
    let side = |side: u32| if longest > SMALL { (side * SMALL / longest).max(1) } else { side };
    let small = imageops::thumbnail(photograph, side(width), side(height));
    Ok(format!(
        "<div class=\"frame-of\">{}<b style=\"left:{:.2}%;top:{:.2}%;width:{:.2}%;height:{:.2}%\"></b></div>",
        pictures::thumbnail(&small, "position of the crops")?,
        fraction(place.x, width),
        fraction(place.y, height),
        fraction(place.width, width),
        fraction(place.height, height)
    ))
}

/// Returns the part of a photograph with the largest sum of differences between neighbouring pixels.
fn most_detail(photograph: &RgbImage) -> Crop {
    let (width, height) = photograph.dimensions();
    let side = |side: u32| (side / PART / STEP * STEP).max(LEAST).min(side);
    let (w, h) = (side(width), side(height));
    let level = |x: u32, y: u32| photograph.get_pixel(x, y).0.iter().map(|&c| u64::from(c)).sum::<u64>();
    // Summed-area table of the differences.
    let row = width as usize + 1;
    let mut sums = vec![0_u64; row * (height as usize + 1)];
    for y in 0..height {
        for x in 0..width {
            let here = level(x, y);
            let (right, below) = (level((x + 1).min(width - 1), y), level(x, (y + 1).min(height - 1)));
            let i = (y as usize + 1) * row + x as usize + 1;
            sums[i] =
                here.abs_diff(right) + here.abs_diff(below) + sums[i - 1] + sums[i - row] - sums[i - row - 1];
        }
    }
    let sum = |x: u32, y: u32| {
        let at = |x: u32, y: u32| sums[y as usize * row + x as usize];
        at(x + w, y + h) + at(x, y) - at(x + w, y) - at(x, y + h)
    };
    let starts = |side: u32, part: u32| (0..=(side - part) / STEP).map(|i| i * STEP);
    let places = starts(height, h).flat_map(|y| starts(width, w).map(move |x| (x, y)));
    // If sums are equal, the first wins.
    let best = places
        .fold((0, 0), |best, place| if sum(place.0, place.1) > sum(best.0, best.1) { place } else { best });
    Crop { x: best.0, y: best.1, width: w, height: h }
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    #[test]
    fn the_place_is_where_the_detail_is() {
        let busy =
            |x: u32, y: u32| (88..104).contains(&x) && (40..56).contains(&y) && (x + y).is_multiple_of(2);
        let picture = RgbImage::from_fn(160, 128, |x, y| Rgb([if busy(x, y) { 255 } else { 90 }; 3]));
        let place = most_detail(&picture);
        assert_eq!((place.width, place.height), (40, 32));
        assert!(place.x <= 88 && place.x + 40 >= 104 && place.y <= 40 && place.y + 32 >= 56, "{place:?}");
        // Coarser scales show the same part.
        assert_eq!(place.of(&RgbImage::new(20, 16), 8).dimensions(), (5, 4));
        assert_eq!(most_detail(&RgbImage::new(3, 2)), Crop { x: 0, y: 0, width: 3, height: 2 });
    }
}
