//! Pictures of test views in the report: the worst and the best, then evenly spaced ones. A figure contains rendering,
//! photograph, difference and FLIP error; the page's script adds a slider to the first two.

use super::{difference, page, page::escape};
use base64::{Engine, prelude::BASE64_STANDARD};
use image::{RgbImage, codecs::jpeg::JpegEncoder, imageops};
use std::path::Path;
use trimip::config::{Contraction, SceneConfig};
use trimip::report::{Report, scale_name};
use trimip::{Error, Result, RunFolder, run::store::ViewRecord, view::pictures};

/// Longest side of a picture in a page, pixels.
const LONGEST: u32 = 1024;
/// Pictures narrower than this, in pixels, are enlarged without smoothing.
const SQUARES: u32 = 200;
/// Largest embedded PNG, bytes. A larger one is replaced by a JPEG, so that a page of six views stays small enough to mail.
const MOST_PNG_BYTES: usize = 400_000;
/// Quality of these JPEGs. Their error is about a tenth of the error of good renderings.
const JPEG_QUALITY: u8 = 92;
/// JPEG quality of thumbnails, which need no fine detail.
const THUMBNAIL_QUALITY: u8 = 84;
/// Number of views that are listed as the worst, and as the best.
const NAMED: usize = 5;

/// Returns the strip of views of the model in the run folder `root`, and the command that opens the viewer; empty without the picture.
pub fn strip(root: &Path, scene: &SceneConfig) -> Result<String> {
    let (heading, alt) = match scene.contraction {
        Contraction::None => ("From all around", "eight views around the model"),
        Contraction::Ball => ("Along the photographs", "eight views along the cameras of the photographs"),
    };
    let Ok(strip) = image::open(RunFolder::new(root).turntable()) else { return Ok(String::new()) };
    Ok(format!(
        "<section><h2>{heading}</h2><div class=\"wide\">{}</div><p class=\"lead\">Turn the model in a browser: \
         <code>trimip-cli view {}</code> <a id=\"viewer\" href=\"./\" hidden>open it in the viewer</a></p></section>\n",
        embedded(strip.into_rgb8(), alt)?,
        escape(&root.display().to_string())
    ))
}

/// Name of a perceptual measure, and its value for a view.
type PerceptualScores = (&'static str, fn(&ViewRecord) -> Option<f64>);

/// The perceptual measures, which only some views have.
const PERCEPTION: [PerceptualScores; 3] =
    [("MS-SSIM", |view| view.ms_ssim), ("FLIP", |view| view.flip), ("LPIPS", |view| view.lpips)];

/// Returns both sections; empty if no view was evaluated. `images` is the folder of the comparisons.
pub fn sections(report: &Report<'_>, images: &Path) -> Result<String> {
    let ordered = by_error(&report.views);
    let (Some(worst), Some(best)) = (ordered.first(), ordered.last()) else { return Ok(String::new()) };
    let mut html = extremes(&ordered, images)?;
    let mut frames = String::new();
    for frame in shown(&report.views) {
        // The worst and the best are already shown above.
        if [worst.index, best.index].contains(&frame[0].index) && ordered.len() > 1 {
            continue;
        }
        let figures = frame.into_iter().map(|view| figure(images, view, "")).collect::<Result<Vec<_>>>()?;
        if figures.iter().any(|figure| !figure.is_empty()) {
            frames += &format!("<div class=\"frame\">{}</div>", figures.concat());
        }
    }
    if !frames.is_empty() {
        html += &format!(
            "<section><h2>Evenly spread views</h2><p class=\"lead\">Finest and coarsest scale, at \
             most {LONGEST} pixels a side; <code>images/</code> has the pictures at their own size.</p><div class=\"wide\">{frames}</div></section>\n"
        );
    }
    Ok(html)
}

/// Returns the views of the finest scale from the worst to the best; a view without PSNR is the worst.
fn by_error(views: &[ViewRecord]) -> Vec<&ViewRecord> {
    let finest = views.iter().map(|view| view.scale).min();
    let mut ordered: Vec<_> = views.iter().filter(|view| Some(view.scale) == finest).collect();
    let psnr = |view: &ViewRecord| view.psnr.unwrap_or(f64::NEG_INFINITY);
    ordered.sort_by(|a, b| psnr(a).total_cmp(&psnr(b)));
    ordered
}

/// Returns the section of the worst and the best views: their names, and their pictures if there are any.
fn extremes(ordered: &[&ViewRecord], images: &Path) -> Result<String> {
    let count = (ordered.len() / 2).clamp(1, NAMED);
    let perceptual: Vec<_> =
        PERCEPTION.into_iter().filter(|(_, of)| ordered.iter().any(|view| of(view).is_some())).collect();
    let far = ordered.iter().any(|view| view.nearest_spacings.is_some());
    let list = |title: &str, views: &mut dyn Iterator<Item = &&ViewRecord>| {
        let mut head = [title, "PSNR / dB", "SSIM"].map(String::from).to_vec();
        head.extend(perceptual.iter().map(|(name, _)| name.to_string()));
        if far {
            head.push("nearest camera / spacings".into());
        }
        let rows = views.map(|v| {
            let mut row = vec![v.name.clone(), measure(v.psnr, 2), measure(v.ssim, 4)];
            row.extend(
                perceptual.iter().map(|(_, of)| of(v).map_or("–".into(), |value| format!("{value:.4}"))),
            );
            if far {
                row.push(v.nearest_spacings.map_or("–".into(), |spacings| format!("{spacings:.2}")));
            }
            row
        });
        page::table(&std::iter::once(head).chain(rows).collect::<Vec<_>>(), false)
    };
    let (worst, best) = (ordered[0], ordered[ordered.len() - 1]);
    let mut html = list("worst", &mut ordered.iter().take(count));
    let mut figures = figure(images, worst, "worst: ")?;
    if ordered.len() > 1 {
        html += &list("best", &mut ordered.iter().rev().take(count));
        figures += &figure(images, best, "best: ")?;
    }
    if !figures.is_empty() {
        figures = format!("<div class=\"wide extremes\">{figures}</div>");
    }
    let scale = match worst.scale {
        1 => "full size".to_string(),
        scale => format!("scale {}", scale_name(scale)),
    };
    Ok(format!(
        "<section><h2>Worst and best views</h2><p class=\"lead\">Evaluated views at {scale}: {}. The difference is the mean of \
         the absolute differences in red, green and blue, as a fraction of the full range.</p><div class=\"pair\">{html}</div>\
         {figures}</section>\n",
        ordered.len()
    ))
}

fn measure(value: Option<f64>, digits: usize) -> String {
    value.map_or("no number".into(), |value| format!("{value:.digits$}"))
}

/// Returns a figure of rendering, photograph, difference and, if present, the map of FLIP errors. `title` precedes its caption. Empty if
/// the picture is missing.
fn figure(images: &Path, view: &ViewRecord, title: &str) -> Result<String> {
    let Some([rendered, photograph]) = compared(images, view) else { return Ok(String::new()) };
    let heat = difference::map(&rendered, &photograph);
    let scale =
        if view.scale == 1 { "full size".into() } else { format!("scale {}", scale_name(view.scale)) };
    let mut caption = format!(
        "{title}{} <b>·</b> {scale} <b>·</b> {} dB <b>·</b> SSIM {}",
        escape(&view.name),
        measure(view.psnr, 2),
        measure(view.ssim, 4)
    );
    for (name, value) in PERCEPTION.iter().filter_map(|(name, of)| of(view).map(|value| (name, value))) {
        caption += &format!(" <b>·</b> {name} {value:.4}");
    }
    let map = view.flip_map.as_ref().and_then(|map| image::open(images.join(map)).ok());
    let flip = match map.zip(difference::flip_bar()) {
        Some((map, bar)) => format!(
            "<div class=\"pane\">{}<span>FLIP error</span>{bar}</div>",
            embedded(map.into_rgb8(), "FLIP error")?
        ),
        None => String::new(),
    };
    let panes = if flip.is_empty() { "panes" } else { "panes four" };
    Ok(format!(
        "<figure class=\"view\"><div class=\"{panes}\"><div class=\"pane\">{}<span>rendered</span></div>\
         <div class=\"pane\">{}<span>photograph</span></div><div class=\"pane\">{}<span>difference</span>{}</div>{flip}</div>\
         <figcaption>{caption}</figcaption></figure>",
        embedded(rendered, "rendered")?,
        embedded(photograph, "photograph")?,
        embedded(heat, "difference")?,
        difference::bar(),
    ))
}

/// Returns the rendering and the photograph of a view, if its comparison exists.
pub fn compared(images: &Path, view: &ViewRecord) -> Option<[RgbImage; 2]> {
    let sheet = image::open(images.join(view.comparison.as_ref()?)).ok()?;
    let [rendered, photograph, _] = pictures::panels(&sheet.to_rgb8());
    (rendered.width() > 0).then_some([rendered, photograph])
}

/// Returns a picture as an HTML element with embedded data.
pub fn embedded(picture: RgbImage, what: &str) -> Result<String> {
    let picture = fitted(picture);
    let (width, height) = picture.dimensions();
    let class = if width < SQUARES { " class=\"pixels\"" } else { "" };
    let (mut kind, mut bytes) = ("png", pictures::png(picture.clone())?);
    if bytes.len() > MOST_PNG_BYTES {
        (kind, bytes) = ("jpeg", jpeg(&picture, JPEG_QUALITY)?);
    }
    let data = BASE64_STANDARD.encode(bytes);
    Ok(format!(
        "<img{class} alt=\"{what}\" width=\"{width}\" height=\"{height}\" src=\"data:image/{kind};base64,{data}\">"
    ))
}

/// Returns a small picture as an HTML element with embedded JPEG data.
pub fn thumbnail(picture: &RgbImage, what: &str) -> Result<String> {
    let data = BASE64_STANDARD.encode(jpeg(picture, THUMBNAIL_QUALITY)?);
    let (width, height) = picture.dimensions();
    Ok(format!(
        "<img alt=\"{}\" width=\"{width}\" height=\"{height}\" src=\"data:image/jpeg;base64,{data}\">",
        escape(what)
    ))
}

fn jpeg(picture: &RgbImage, quality: u8) -> Result<Vec<u8>> {
    let mut bytes = Vec::new();
    JpegEncoder::new_with_quality(&mut bytes, quality)
        .encode_image(picture)
        .map_err(|error| Error::run(format!("cannot encode a JPEG: {error}")))?;
    Ok(bytes)
}

/// Reduces a picture so that its sides are at most [`LONGEST`].
fn fitted(picture: RgbImage) -> RgbImage {
    let (width, height) = picture.dimensions();
    let longest = width.max(height);
    if longest <= LONGEST {
        return picture;
    }
    let side = |side: u32| (u64::from(side) * u64::from(LONGEST) / u64::from(longest)).max(1) as u32;
    // A box filter: a sharper filter would ring and distort the apparent quality of the model.
    imageops::thumbnail(&picture, side(width), side(height))
}

/// Returns, for every frame with pictures, the finest and the coarsest scale in that order.
fn shown(views: &[ViewRecord]) -> Vec<Vec<&ViewRecord>> {
    let mut frames: Vec<Vec<&ViewRecord>> = Vec::new();
    for view in views.iter().filter(|view| view.comparison.is_some()) {
        match frames.iter_mut().find(|frame| frame[0].index == view.index) {
            Some(frame) => frame.push(view),
            None => frames.push(vec![view]),
        }
    }
    for frame in &mut frames {
        frame.sort_by_key(|view| view.scale);
        let coarsest = frame.len().saturating_sub(1);
        if coarsest > 1 {
            frame.drain(1..coarsest);
        }
    }
    frames
}

#[cfg(test)]
mod tests {
    use super::*;
    use image::Rgb;

    fn view(index: usize, scale: u32, psnr: Option<f64>, picked: bool) -> ViewRecord {
        let comparison = picked.then(|| "a.png".into());
        ViewRecord {
            index,
            name: format!("r_{index}"),
            scale,
            psnr,
            ssim: Some(0.5),
            ms_ssim: None,
            flip: picked.then_some(0.125),
            lpips: None,
            nearest_distance: Some(0.5 * index as f64),
            nearest_spacings: Some(index as f64),
            comparison,
            flip_map: picked.then(|| "a_flip.png".into()),
        }
    }

    #[test]
    fn the_finest_and_the_coarsest_scale_are_shown() {
        let views = [(0, 1, false), (1, 1, true), (1, 2, true), (1, 4, true), (2, 1, true)]
            .map(|(index, scale, picked)| view(index, scale, None, picked));
        let shown: Vec<Vec<_>> = shown(&views).iter().map(|f| f.iter().map(|v| v.scale).collect()).collect();
        assert_eq!(shown, [vec![1, 4], vec![1]]);
    }

    #[test]
    fn large_pictures_shrink_and_small_ones_keep_their_pixels() {
        assert_eq!(fitted(RgbImage::new(1536, 2048)).dimensions(), (768, 1024));
        assert_eq!(fitted(RgbImage::new(16, 16)), RgbImage::new(16, 16));
        assert!(embedded(RgbImage::new(16, 16), "x").unwrap().contains("class=\"pixels\""));
    }

    #[test]
    fn pictures_of_noise_are_kept_small() {
        let noise = |x: u32, y: u32| (x * x * 791 + y * y * 1047 + x * y * 31) as u8;
        let picture =
            RgbImage::from_fn(600, 600, |x, y| Rgb([noise(x, y), noise(y, x + 1), noise(x + y, y)]));
        assert!(embedded(picture, "x").unwrap().contains("image/jpeg"));
    }

    #[test]
    fn the_worst_and_the_best_are_named_and_shown_where_pictured() {
        let folder = tempfile::tempdir().unwrap();
        let sheet = pictures::side_by_side(2, 1, &[[0.0; 3]; 2], &[[1.0; 3]; 2]);
        pictures::write_png(&folder.path().join("a.png"), sheet).unwrap();
        pictures::write_png(&folder.path().join("a_flip.png"), RgbImage::new(2, 1)).unwrap();
        trimip::run::fixtures::report(|report| {
            let psnr = [Some(20.0), None, Some(31.0), Some(25.0)];
            let views = (0..4).map(|i| view(i, 1, psnr[i], i == 2)).collect();
            let report = Report { views, run: report.run.clone(), ..example_of(report) };
            let html = sections(&report, folder.path()).unwrap();
            assert!(html.contains("<td>r_1</td><td class=\"n\">no number</td>"), "{html}");
            assert!(html.contains("best: r_2") && !html.contains("worst: r_"), "{html}");
            assert_eq!(html.matches("<img").count(), if difference::flip_bar().is_some() { 4 } else { 3 });
            assert!(html.contains("FLIP 0.1250") && html.contains("<td class=\"n\">0.1250</td>"), "{html}");
            assert!(!html.contains("LPIPS"), "nothing was measured of it");
            assert!(html.contains("nearest camera / spacings") && html.contains(">3.00</td>"), "{html}");
        });
    }

    /// Returns a copy of the report.
    fn example_of<'a>(report: &Report<'a>) -> Report<'a> {
        Report {
            status: report.status.clone(),
            run: report.run.clone(),
            scene: report.scene.clone(),
            config: report.config,
            settings: report.settings,
            history: report.history,
            machine: report.machine.clone(),
            model_bytes: report.model_bytes,
            views: Vec::new(),
        }
    }
}
