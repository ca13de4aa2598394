//! Pictures of a capture that have no camera: thumbnails with reasons.

use super::super::{page::escape, pictures};
use image::RgbImage;
use std::path::PathBuf;
use trimip::{Result, formatting::count};

/// Maximum number of thumbnails; further pictures are listed by name.
const SHOWN: usize = 60;

/// Longest side of a thumbnail, pixels.
const LONGEST: u32 = 200;

/// A picture without a camera.
pub struct UnplacedPicture {
    /// Name of the picture.
    pub name: String,
    /// Path of its file, if the picture can be shown.
    pub path: Option<PathBuf>,
    /// Reason why it has no camera.
    pub reason: String,
}

/// Returns the section with these pictures; empty if there are none.
pub fn section(unplaced: &[UnplacedPicture]) -> Result<String> {
    if unplaced.is_empty() {
        return Ok(String::new());
    }
    let figures = unplaced.iter().take(SHOWN).map(figure).collect::<Result<Vec<String>>>()?.concat();
    let listed: String = unplaced
        .iter()
        .skip(SHOWN)
        .map(|one| format!("<li><b>{}</b> {}</li>", escape(&one.name), escape(&one.reason)))
        .collect();
    let listed = if listed.is_empty() { listed } else { format!("<ul class=\"warnings\">{listed}</ul>") };
    Ok(format!(
        "<section><h2>Without a camera</h2><p class=\"lead\">{} not used. Several in a row are a gap: take more pictures there, \
         slowly, with more overlap.</p><div class=\"wide thumbs\">{figures}</div>{listed}</section>\n",
        match unplaced.len() {
            1 => "1 picture is".to_string(),
            several => format!("{} are", count(several as u64, "picture")),
        }
    ))
}

fn figure(one: &UnplacedPicture) -> Result<String> {
    let caption = format!("<figcaption><b>{}</b><br>{}</figcaption>", escape(&one.name), escape(&one.reason));
    let picture = match one.path.as_ref().and_then(|path| image::open(path).ok()) {
        Some(picture) => pictures::thumbnail(&shrunk(picture.into_rgb8()), &one.name)?,
        None => String::new(),
    };
    Ok(format!("<figure>{picture}{caption}</figure>"))
}

fn shrunk(picture: RgbImage) -> RgbImage {
    let (width, height) = picture.dimensions();
    let longest = width.max(height);
    if longest <= LONGEST {
        return picture;
    }
    let side = |side: u32| (u64::from(side) * u64::from(LONGEST) / u64::from(longest)).max(1) as u32;
    image::imageops::thumbnail(&picture, side(width), side(height))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::page;

    #[test]
    fn every_picture_has_its_reason() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        RgbImage::new(400, 300).save(&path).unwrap();
        let one = |path: Option<PathBuf>| UnplacedPicture {
            name: "a<b>".into(),
            path,
            reason: "too blurred".into(),
        };
        let mut all = vec![one(Some(path)), one(None)];
        let text = section(&all).unwrap();
        assert!(text.matches("<img").count() == 1 && text.matches("too blurred").count() == 2, "{text}");
        assert!(text.contains("2 pictures are not used") && !text.contains("<b>a<b>"));
        page::expect_whole(&page::whole("a", &text));
        all.extend((0..SHOWN).map(|_| one(None)));
        assert_eq!(section(&all).unwrap().matches("<li>").count(), 2);
        assert!(section(&[]).unwrap().is_empty());
    }
}
