//! Films of rendered pictures. This program writes MP4, GIF and WebP itself; the program `ffmpeg` of the system writes the other
//! formats.

mod encoder;
mod ffmpeg;
mod gif;
#[cfg(feature = "mp4")]
mod mp4;
mod webp;

use encoder::Encoder;
use image::RgbaImage;
use std::fs::File;
use std::path::{Path, PathBuf};
use trimip_core::atomic::replace_atomically;
use trimip_core::{Advice, Error, ErrorKind, Place, Result};

/// A format of films.
struct Format {
    /// Extension of file names.
    ending: &'static str,
    /// Opens an encoder; `None` if `ffmpeg` writes the format.
    open: Option<Opens>,
    /// Largest sides of the pictures, the longer one first.
    largest: [u32; 2],
    /// Smallest side of the pictures.
    least: u32,
}

/// Opens an encoder that writes to a file, for pictures of a size (width, height) at a rate (pictures per second).
type Opens = fn(&File, [u32; 2], f64) -> std::result::Result<Box<dyn Encoder>, String>;

/// All formats.
const FORMATS: [Format; 6] = [
    #[cfg(feature = "mp4")]
    Format { ending: "mp4", open: Some(mp4::open), largest: mp4::LARGEST, least: mp4::LEAST },
    #[cfg(not(feature = "mp4"))]
    Format { ending: "mp4", open: None, largest: [u32::MAX; 2], least: 1 },
    Format { ending: "gif", open: Some(gif::open), largest: [65_535; 2], least: 1 },
    Format { ending: "webp", open: Some(webp::open), largest: [1 << 14; 2], least: 1 },
    Format { ending: "mov", open: None, largest: [u32::MAX; 2], least: 1 },
    Format { ending: "mkv", open: None, largest: [u32::MAX; 2], least: 1 },
    Format { ending: "webm", open: None, largest: [u32::MAX; 2], least: 1 },
];

/// Returns the format of a file name.
fn format(path: &Path) -> Result<&'static Format> {
    let end = path.extension().map(|end| end.to_string_lossy().to_lowercase()).unwrap_or_default();
    FORMATS.iter().find(|format| format.ending == end).ok_or_else(|| {
        let endings: Vec<_> = FORMATS.iter().map(|format| format.ending).collect();
        Error::input(
            Place::argument("video", path.display()),
            "names no video format",
            format!("end it in .{}", endings.join(", .")),
        )
    })
}

/// Fails if a film of this name, with pictures of this size, [width, height], cannot be written on this machine.
///
/// # Errors
/// When the extension is not that of a film, the format has no pictures of this size, or `ffmpeg` is needed and missing.
pub fn check(path: &Path, [width, height]: [u32; 2]) -> Result<()> {
    let Format { open, largest, least, ending } = format(path)?;
    if width.min(height) < *least {
        return Err(Error::input(
            Place::argument("video", path.display()),
            format!("has pictures of {width} × {height}, and .{ending} at least {least} × {least}"),
            Advice::Argument("increase {width} and {height}, or end {video} in .gif or .webp".into()),
        ));
    }
    if width.max(height) > largest[0] || width.min(height) > largest[1] {
        return Err(Error::input(
            Place::argument("video", path.display()),
            format!(
                "has pictures of {width} × {height}, and .{ending} at most {} × {}",
                largest[0], largest[1]
            ),
            Advice::Argument("lower {width} and {height}, or choose .mkv, which ffmpeg writes".into()),
        ));
    }
    if open.is_some() || ffmpeg::is_there() {
        return Ok(());
    }
    Err(Error::input(
        Place::argument("video", path.display()),
        "no program `ffmpeg` runs on this machine",
        Advice::Argument(match cfg!(feature = "mp4") {
            true => "install it, or end {video} in .mp4, .gif or .webp".into(),
            false => "install it, or end {video} in .gif or .webp".into(),
        }),
    ))
}

/// Encodes PNG files of equal size, in order, at `rate` pictures per second. The film is written to a temporary file next to
/// `path`, then renamed. `watch` receives the number of pictures done and returns false to stop; the result is then false, and
/// there is no film.
///
/// # Errors
/// When a picture cannot be read, the film cannot be written, or `ffmpeg` fails; the message then has the last line of its output.
pub fn encode(
    path: &Path,
    pictures: &[PathBuf],
    rate: f64,
    watch: &mut dyn FnMut(usize) -> bool,
) -> Result<bool> {
    let Some(open) = format(path)?.open else { return ffmpeg::encode(path, pictures, rate, watch) };
    let failed = |error: String| Error::run(format!("{}: {error}", path.display()));
    let read = |picture: &PathBuf| -> Result<RgbaImage> {
        let read = std::fs::read(picture).map_err(|error| error.to_string());
        let decoded =
            read.and_then(|bytes| image::load_from_memory(&bytes).map_err(|error| error.to_string()));
        decoded
            .map(image::DynamicImage::into_rgba8)
            .map_err(|error| Error::run(format!("{}: {error}", picture.display())))
    };
    let mut fill = |file: &File| {
        let mut encoder = None;
        for (i, picture) in pictures.iter().enumerate() {
            if !watch(i) {
                return Err(Error::stopped());
            }
            let picture = read(picture)?;
            let encoder = match &mut encoder {
                Some(encoder) => encoder,
                None => {
                    let size = [picture.width(), picture.height()];
                    encoder.insert(open(file, size, rate).map_err(failed)?)
                }
            };
            encoder.add(picture).map_err(failed)?;
        }
        encoder.map_or(Ok(()), |encoder: Box<dyn Encoder>| encoder.end()).map_err(failed)
    };
    // The error that the film had, in place of the one of the file.
    let mut failure = None;
    let written = replace_atomically(path, |file| {
        fill(file).map_err(|error| {
            failure = Some(error);
            std::io::Error::other("no film")
        })
    });
    match failure {
        None => written.map(|()| true),
        Some(error) if error.kind() == ErrorKind::Stopped => Ok(false),
        Some(error) => Err(error),
    }
}
