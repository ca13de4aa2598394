//! Takes frames of a film as pictures of a capture, in two passes of ffmpeg. The first pass measures every frame at a small size. The
//! program then chooses the sharpest frame of each interval of motion, and the second pass writes the chosen frames at full size.

mod choice;
mod film;
mod measure;
mod motion;

use super::{
    folder::Folder,
    pictures::{Picture, Pictures},
    process::{self, Call},
    programs::{Need, expect},
};
use choice::Chosen;
use film::Film;
use std::{
    ffi::OsStr,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};
use trimip::{Error, Result, formatting::duration};

/// The user's request for a film.
pub struct Request<'a> {
    /// Absolute path of the film.
    pub film: &'a Path,
    /// Number of frames, if the user specified it.
    pub frames: Option<u32>,
    /// Number of threads of ffmpeg; 0 = ffmpeg's default.
    pub threads: u32,
}

/// Paths and abilities of the programs ffmpeg and ffprobe.
struct Ffmpeg {
    ffmpeg: PathBuf,
    ffprobe: PathBuf,
    /// The option that makes ffmpeg neither drop nor repeat frames; its name depends on the version.
    passthrough: [&'static str; 2],
    /// True if this ffmpeg can tone-map HDR.
    maps_tones: bool,
}

impl Ffmpeg {
    fn find(film: &Path) -> Result<Self> {
        let [ffmpeg, ffprobe] = ["ffmpeg", "ffprobe"].map(|name| expect(name, Need::Films, film.display()));
        let (ffmpeg, ffprobe) = (ffmpeg?, ffprobe?);
        let says = |arguments: &[&str]| process::ask(&ffmpeg, arguments).unwrap_or_default();
        let help = says(&["-hide_banner", "-h", "long"]);
        let passthrough = match help.contains("-vsync") && !help.contains("-fps_mode") {
            true => ["-vsync", "passthrough"],
            false => ["-fps_mode", "passthrough"],
        };
        let filters = says(&["-hide_banner", "-filters"]);
        let has = |name: &str| filters.lines().any(|line| line.split_whitespace().nth(1) == Some(name));
        let maps_tones = has("zscale") && has("tonemap");
        Ok(Self { ffmpeg, ffprobe, passthrough, maps_tones })
    }
}

/// Takes frames out of a film and writes them to the new folder `images` in the folder of the capture.
///
/// # Errors
/// When ffmpeg is missing or fails, or the film has too few frames.
pub fn take(
    request: &Request<'_>,
    folder: &Folder,
    images: &str,
    stop: &AtomicBool,
    tell: &mut dyn FnMut(&str),
    progress: &mut dyn FnMut(&'static str, u64, u64),
) -> Result<Pictures> {
    let tools = Ffmpeg::find(request.film)?;
    let film = Film::probe(&tools.ffprobe, request.film)?;
    film.lines(tools.maps_tones).iter().for_each(|line| tell(line));
    let threads = match request.threads {
        0 => Vec::new(),
        threads => vec!["-threads".to_string(), threads.to_string()],
    };
    let call = |log: &str| {
        Call {
            name: "ffmpeg".into(),
            program: &tools.ffmpeg,
            arguments: Vec::new(),
            folder: folder.root(),
            log: folder.log(log),
        }
        .with(["-hide_banner", "-nostdin", "-nostats", "-y"])
        .with(&threads)
        .with([OsStr::new("-i"), request.film.as_os_str()])
        .with(["-map", "0:v:0", "-an", "-sn", "-dn"])
    };

    let size = film.measured_size();
    let filters =
        format!("{}scale={}:{}:flags=area,format=gray,showinfo", film.deinterlace(), size[0], size[1]);
    let measuring = call("measure")
        .with(["-vf", &filters])
        .with(tools.passthrough)
        .with(["-f", "rawvideo", "-pix_fmt", "gray", "pipe:1"]);
    let mut measuring_progress = |done| progress("measuring frames", done, film.frames.max(done));
    let measured = measure::frames(&measuring, size, film.rate, stop, &mut measuring_progress)?;
    if measured.is_empty() {
        return Err(Error::input(
            request.film.display(),
            "has no frame that ffmpeg can decode",
            format!("look at {}, or convert the film", measuring.log.display()),
        ));
    }
    let Chosen { frames, notes } = choice::choose(&measured, request.frames);
    notes.iter().for_each(|line| tell(line));

    let target = folder.path(images);
    std::fs::create_dir_all(&target).map_err(|error| super::folder::unwritable(&target, &error))?;
    let selected: Vec<String> = frames.iter().map(|frame| format!("eq(n,{frame})")).collect();
    // JPEG uses the BT.601 colour matrix, and ffmpeg converts from another matrix only on request.
    let filters = format!(
        "{}select='{}'{},scale=out_color_matrix=bt601",
        film.deinterlace(),
        selected.join("+"),
        film.tones(tools.maps_tones)
    );
    let taking = call("frames")
        .with(["-vf", &filters])
        .with(tools.passthrough)
        .with(["-pix_fmt", "yuvj420p", "-q:v", "2", "-qmin", "1", "-progress", "pipe:1", "-f", "image2"])
        .with([format!("{images}/%05d.jpg")]);
    let count = frames.len() as u64;
    taking.run(stop, &mut |line: &str| {
        if let Some(done) = line.strip_prefix("frame=").and_then(|done| done.trim().parse().ok()) {
            progress("taking frames", done, count);
        }
        !is_progress(line)
    })?;
    let mut pictures = Pictures { of_film: true, notes, ..Pictures::default() };
    for (index, &frame) in frames.iter().enumerate() {
        let name = format!("{:05}.jpg", index + 1);
        let path = target.join(&name);
        let size = image::image_dimensions(&path).map_err(|error| {
            Error::run(format!(
                "ffmpeg wrote no complete frame {frame}: {error}; its output is in {}",
                taking.log.display()
            ))
        })?;
        let measure = &measured[frame];
        pictures.pictures.push(Picture {
            name,
            source: format!("frame {frame} at {}", duration(measure.seconds)),
            size: [size.0, size.1],
            seconds: Some(measure.seconds),
            sharpness: Some(measure.sharpness),
        });
    }
    pictures.expect_enough(request.film)?;
    Ok(pictures)
}

/// Returns true for a line of `-progress`, such as `speed=1.2x`. These lines would hide the last messages of an ffmpeg that fails.
fn is_progress(line: &str) -> bool {
    let is_key = |key: &str| key.chars().all(|c| c.is_ascii_lowercase() || c.is_ascii_digit() || c == '_');
    line.split_once('=').is_some_and(|(key, _)| is_key(key))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lines_of_progress_are_told_from_errors() {
        assert!(["frame=12", "stream_0_0_q=2.0", "progress=end"].into_iter().all(is_progress));
        let errors = ["moov atom not found", "[out#0/image2 @ 0x5] Error: code=5", "Conversion failed!"];
        assert!(!errors.into_iter().any(is_progress));
    }
}
