//! Pictures for the report: the panels of a comparison, brought to a moderate size and written into the page.

use crate::{pictures, store::ViewRecord};
use base64::{Engine, prelude::BASE64_STANDARD};
use image::{RgbImage, imageops};
use std::path::Path;
use trimip_core::Result;

/// Largest width of one panel in the page, pixels.
const PANEL: u32 = 400;

/// Captions of the panels.
const CAPTIONS: [&str; 3] = ["rendered", "photograph", "difference × 4"];

/// A figure of three panels; empty where the picture is gone.
pub fn figure(images: &Path, view: &ViewRecord) -> Result<String> {
    let Some(name) = &view.comparison else { return Ok(String::new()) };
    let Ok(sheet) = image::open(images.join(name)) else { return Ok(String::new()) };
    let mut figure = String::from("<figure class=\"views\">");
    for (panel, caption) in pictures::panels(&sheet.to_rgb8()).into_iter().zip(CAPTIONS) {
        let (small, class) = fitted(panel);
        let data = BASE64_STANDARD.encode(pictures::png(small)?);
        figure += &format!(
            "<div><img class=\"{class}\" alt=\"{caption}\" src=\"data:image/png;base64,{data}\"><span>{caption}</span></div>"
        );
    }
    let scale = if view.scale == 1 { "full size".into() } else { format!("scale 1/{}", view.scale) };
    let measure = |value: Option<f64>, digits: usize| value.map_or("∞".into(), |v| format!("{v:.digits$}"));
    figure += &format!(
        "<figcaption>{} <b>·</b> {scale} <b>·</b> {} dB <b>·</b> SSIM {}</figcaption></figure>",
        super::html::escape(&view.name),
        measure(view.psnr, 2),
        measure(view.ssim, 4)
    );
    Ok(figure)
}

/// A panel no wider than [`PANEL`], and the class that tells the browser to show a small one's pixels as squares.
fn fitted(panel: RgbImage) -> (RgbImage, &'static str) {
    let (width, height) = panel.dimensions();
    if width <= PANEL {
        return (panel, if width < PANEL / 2 { "pixels" } else { "" });
    }
    let height = (u64::from(height) * u64::from(PANEL) / u64::from(width)).max(1) as u32;
    // Means of whole areas: a sharper filter would ring and flatter or blame the model.
    (imageops::thumbnail(&panel, PANEL, height), "")
}

/// The finest and the coarsest scale of every pictured frame, in that order.
pub fn shown(views: &[ViewRecord]) -> Vec<Vec<&ViewRecord>> {
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

    #[test]
    fn the_finest_and_the_coarsest_scale_are_shown() {
        let view = |index, scale, picked: bool| ViewRecord {
            index,
            name: "r".into(),
            scale,
            psnr: None,
            ssim: None,
            comparison: picked.then(|| "a.png".into()),
        };
        let views =
            [view(0, 1, false), view(1, 1, true), view(1, 2, true), view(1, 4, true), view(2, 1, true)];
        let shown: Vec<Vec<_>> = shown(&views).iter().map(|f| f.iter().map(|v| v.scale).collect()).collect();
        assert_eq!(shown, [vec![1, 4], vec![1]]);
    }

    #[test]
    fn large_panels_shrink_and_small_ones_keep_their_pixels() {
        assert_eq!(fitted(RgbImage::new(800, 600)).0.dimensions(), (400, 300));
        assert_eq!(fitted(RgbImage::new(16, 16)), (RgbImage::new(16, 16), "pixels"));
    }
}
