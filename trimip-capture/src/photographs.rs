//! Turns the photographs of a folder into pictures of a capture: links or copies them as they are, and converts HEIC with a program of the
//! system. If sizes differ, the pictures of each size get their own folder, and therefore a common camera.

use super::{
    pictures::{LeftOut, Picture, Pictures},
    process::{Call, ask},
    programs::{self, Need},
    source::Photograph,
};
use image::{ImageDecoder, ImageReader, metadata::Orientation};
use std::{
    collections::{BTreeMap, BTreeSet},
    ffi::OsString,
    fs,
    path::{Path, PathBuf},
    sync::atomic::AtomicBool,
};
use trimip::{Error, Result};

/// Programs that read HEIC, in the order in which they are tried: name, arguments before the input file, arguments between the two files.
/// They write JPEG at the highest quality, and keep the EXIF lens data, which COLMAP uses as its initial guess.
const CONVERTERS: [Converter; 6] = [
    Converter { name: "heif-convert", before: &["-q", "100"], between: &[] },
    Converter { name: "heif-dec", before: &["-q", "100"], between: &[] },
    Converter { name: "magick", before: &[], between: &["-quality", "100"] },
    Converter {
        name: "sips",
        before: &["-s", "format", "jpeg", "-s", "formatOptions", "100"],
        between: &["--out"],
    },
    Converter { name: "convert", before: &[], between: &["-quality", "100"] },
    Converter {
        name: "ffmpeg",
        before: &["-hide_banner", "-nostdin", "-y", "-i"],
        // With `-update`, a percent sign in the name of the picture is not read as a number pattern.
        between: &["-frames:v", "1", "-q:v", "1", "-qmin", "1", "-update", "1"],
    },
];

/// First version of ffmpeg that assembles the tiles of a HEIC image; earlier ones return only the first tile.
const FFMPEG_WITH_TILES: u32 = 7;

/// A program that converts a photograph.
struct Converter {
    name: &'static str,
    before: &'static [&'static str],
    between: &'static [&'static str],
}

impl Converter {
    /// Returns the path of the program, if it is installed and suitable.
    fn program(&self) -> Option<PathBuf> {
        let program = programs::find(self.name)?;
        match self.name {
            // On Windows, `convert` is a disk tool.
            "convert" if cfg!(windows) => None,
            "ffmpeg" => {
                let version = ask(&program, &["-version"])?;
                let first = version.strip_prefix("ffmpeg version ")?;
                let digits: String = first.chars().take_while(char::is_ascii_digit).collect();
                // Development builds have a name in place of a version number.
                digits.parse().map_or(true, |major: u32| major >= FFMPEG_WITH_TILES).then_some(program)
            }
            _ => Some(program),
        }
    }
}

/// Writes the pictures to the new folder `folder` in `root`.
///
/// # Errors
/// When no program converts a photograph that needs it, a file cannot be written, or too few photographs are readable.
pub fn make(
    photographs: &[Photograph],
    root: &Path,
    folder: &str,
    log: &Path,
    stop: &AtomicBool,
    progress: &mut dyn FnMut(u64, u64),
) -> Result<Pictures> {
    let target = root.join(folder);
    let mut converting = Converting { root, log, stop, working: None };
    let mut pictures = Pictures::default();
    let names = unique_names(photographs);
    let mut sizes: Vec<(PathBuf, String, [u32; 2])> = Vec::new();
    let mut turned = 0;
    let staging = target.join("all");
    fs::create_dir_all(&staging).map_err(|error| super::folder::unwritable(&staging, &error))?;
    for (done, (photograph, name)) in photographs.iter().zip(&names).enumerate() {
        if stop.load(std::sync::atomic::Ordering::Relaxed) {
            return Err(super::process::stopped());
        }
        let path = staging.join(name);
        match photograph.foreign {
            Some(_) => converting.convert(&photograph.path, &path)?,
            None => link(&photograph.path, &path)?,
        }
        match size(&path) {
            Ok((size, is_turned)) => {
                turned += usize::from(is_turned);
                sizes.push((photograph.name.clone(), name.clone(), size));
            }
            Err(reason) => {
                let _ = fs::remove_file(&path);
                pictures.left_out.push(LeftOut { name: photograph.name.display().to_string(), reason });
            }
        }
        progress(done as u64 + 1, photographs.len() as u64);
    }
    let kinds: BTreeSet<[u32; 2]> = sizes.iter().map(|(.., size)| *size).collect();
    for (source, name, [width, height]) in sizes {
        let within = if kinds.len() > 1 { format!("{width}x{height}/") } else { String::new() };
        let to = target.join(&within).join(&name);
        if let Some(parent) = to.parent() {
            fs::create_dir_all(parent).map_err(|error| super::folder::unwritable(parent, &error))?;
        }
        fs::rename(staging.join(&name), &to).map_err(|error| super::folder::unwritable(&to, &error))?;
        let (name, source) = (format!("{within}{name}"), source.display().to_string());
        pictures.pictures.push(Picture {
            name,
            source,
            size: [width, height],
            seconds: None,
            sharpness: None,
        });
    }
    fs::remove_dir(&staging).map_err(|error| super::folder::unwritable(&staging, &error))?;
    if turned > 0 {
        pictures.notes.push(format!(
            "orientation: {} rotated according to EXIF; pixels are used as stored, so that one camera fits all",
            if turned == 1 { "1 photograph is".into() } else { format!("{turned} photographs are") }
        ));
    }
    pictures.converted_by = converting.working.map(|(_, converter)| converter.name.to_string());
    pictures.expect_enough(&target)?;
    Ok(pictures)
}

/// Converts photographs. The first program that succeeds converts all of them.
struct Converting<'a> {
    root: &'a Path,
    log: &'a Path,
    stop: &'a AtomicBool,
    working: Option<(PathBuf, &'static Converter)>,
}

impl Converting<'_> {
    fn convert(&mut self, from: &Path, to: &Path) -> Result<()> {
        if let Some((program, converter)) = &self.working {
            return self.by(program, converter, from, to);
        }
        let mut failed = None;
        for converter in &CONVERTERS {
            let Some(program) = converter.program() else { continue };
            // A program may have been built without HEIC support, which only a trial shows.
            match self.by(&program, converter, from, to) {
                Ok(()) => {
                    self.working = Some((program, converter));
                    return Ok(());
                }
                Err(error) if error.kind() == trimip::ErrorKind::Stopped => return Err(error),
                Err(error) => failed = failed.or(Some(error)),
            }
        }
        let missing = Need::Heif.missing(from.display());
        Err(match failed {
            None => missing,
            Some(failed) => {
                Error::input(from.display(), format!("cannot be converted: {failed}"), "install heif-convert")
            }
        })
    }

    fn by(&self, program: &Path, converter: &Converter, from: &Path, to: &Path) -> Result<()> {
        let words = |words: &[&str]| words.iter().map(OsString::from).collect::<Vec<_>>();
        let call = Call {
            name: converter.name.into(),
            program,
            arguments: Vec::new(),
            folder: self.root,
            log: self.log.into(),
        }
        .with(words(converter.before))
        .with([from])
        .with(words(converter.between))
        .with([to]);
        call.run(self.stop, &mut |_: &str| true)?;
        if to.is_file() {
            return Ok(());
        }
        // For a file with several images (a burst, a live photograph) the program writes numbered pictures; the first is used.
        let numbered =
            to.with_file_name(format!("{}-1.jpg", to.file_stem().unwrap_or_default().to_string_lossy()));
        fs::rename(&numbered, to).map_err(|_| {
            Error::run(format!(
                "{} wrote no picture of {}; its output is in {}",
                converter.name,
                from.display(),
                self.log.display()
            ))
        })
    }
}

/// Hard-links a file, or copies it if a link is impossible. The original is not changed.
fn link(from: &Path, to: &Path) -> Result<()> {
    // Link the target of a symbolic link, because a relative symbolic link would break in another folder.
    let whole = from.canonicalize().unwrap_or_else(|_| from.into());
    if fs::hard_link(&whole, to).is_ok() {
        return Ok(());
    }
    fs::copy(&whole, to).map(drop).map_err(|error| {
        Error::input(
            from.display(),
            format!("cannot be copied to {}: {error}", to.display()),
            "check both places",
        )
    })
}

/// Returns the stored width and height of a photograph and whether EXIF says that it is rotated, or the reason why it cannot be read.
fn size(path: &Path) -> std::result::Result<([u32; 2], bool), String> {
    let read = || -> image::ImageResult<_> {
        let mut decoder = ImageReader::open(path)?.with_guessed_format()?.into_decoder()?;
        let turned = decoder.orientation().is_ok_and(|orientation| orientation != Orientation::NoTransforms);
        Ok((<[u32; 2]>::from(decoder.dimensions()), turned))
    };
    read().map_err(|error| format!("cannot be read: {error}"))
}

/// Returns a plain file name for each photograph. The names are unique even on file systems that ignore case.
fn unique_names(photographs: &[Photograph]) -> Vec<String> {
    let plain = |photograph: &Photograph| {
        let name = plain_name(&photograph.name.file_name().unwrap_or_default().to_string_lossy());
        match photograph.foreign {
            Some(_) => Path::new(&name).with_extension("jpg").display().to_string(),
            None => name,
        }
    };
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    photographs
        .iter()
        .for_each(|photograph| *counts.entry(plain(photograph).to_lowercase()).or_default() += 1);
    let mut used = BTreeSet::new();
    let name = |photograph: &Photograph| {
        let mut name = plain(photograph);
        if counts[&name.to_lowercase()] > 1 {
            let parents = photograph.name.parent().unwrap_or(Path::new("")).iter();
            let parents: Vec<_> = parents.map(|part| plain_name(&part.to_string_lossy())).collect();
            name = parents.iter().map(|part| format!("{part}_")).collect::<String>() + &name;
        }
        let whole = name.clone();
        for number in 2.. {
            if used.insert(name.to_lowercase()) {
                break;
            }
            name = format!("{number}_{whole}");
        }
        name
    };
    photographs.iter().map(name).collect()
}

/// Replaces blanks and `#`. In COLMAP's lists of pairs, blanks separate names and `#` begins a comment.
fn plain_name(name: &str) -> String {
    name.replace(|c: char| c.is_whitespace() || c == '#', "_")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn photograph(path: &Path, name: &str) -> Photograph {
        Photograph {
            path: path.join(name),
            name: name.into(),
            foreign: trimip_data::foreign_format(&path.join(name)),
        }
    }

    #[test]
    fn names_are_unique_and_plain() {
        let names = ["a/1.jpg", "b/1.JPG", "2 b.jpg", "c.HEIC", "d/b_1.JPG", "e.heic/c.jpg", "#3.jpg"];
        let all: Vec<_> = names.iter().map(|name| photograph(Path::new("/nowhere"), name)).collect();
        assert_eq!(
            unique_names(&all),
            ["a_1.jpg", "b_1.JPG", "2_b.jpg", "c.jpg", "2_b_1.JPG", "e.heic_c.jpg", "_3.jpg"]
        );
    }

    #[test]
    fn photographs_stay_as_they_are_and_those_of_a_size_share_a_folder() {
        let folder = tempfile::tempdir().unwrap();
        let (root, from) = (folder.path().join("out"), folder.path().join("in"));
        fs::create_dir(&from).unwrap();
        for (name, width) in [("0.png", 8), ("1.png", 8), ("2.png", 8), ("3.png", 6)] {
            image::RgbImage::new(width, 6).save(from.join(name)).unwrap();
        }
        fs::write(from.join("4.png"), "no picture").unwrap();
        let make = |names: &[&str], to: &str| {
            let all: Vec<_> = names.iter().map(|name| photograph(&from, name)).collect();
            make(&all, &root, to, &root.join("log"), &AtomicBool::new(false), &mut |_, _| {})
        };
        let one = make(&["0.png", "1.png", "2.png", "4.png"], "one").unwrap();
        assert_eq!(
            one.pictures.iter().map(|p| p.name.as_str()).collect::<Vec<_>>(),
            ["0.png", "1.png", "2.png"]
        );
        assert!(one.left_out[0].name == "4.png" && one.left_out[0].reason.contains("cannot be read"));
        let several = make(&["0.png", "1.png", "2.png", "3.png"], "several").unwrap();
        assert_eq!(
            (several.pictures[0].name.as_str(), several.pictures[3].name.as_str()),
            ("8x6/0.png", "6x6/3.png")
        );
        assert!(root.join("several/6x6/3.png").is_file() && !root.join("several/all").exists());
        assert_eq!(fs::read_dir(&from).unwrap().count(), 5);
        assert!(make(&["0.png", "1.png", "4.png"], "few").unwrap_err().message().contains("only 2 pictures"));
    }
}
