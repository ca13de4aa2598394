//! Bundler's `bundle.out` with its list of photographs. A camera is a focal length in pixels, two radial coefficients
//! and a world-to-camera pose with x right, y up and z backwards; its principal point is the middle of the photograph.
//! If its focal length is 0, Bundler did not place it (Snavely, Bundler's manual).

use super::reader::{CameraFile, NamedCameras, Reader};
use crate::{
    files,
    listing::{Calibration, Frame, Listing},
    names,
    points::{Cloud, Point},
    pose,
    split::Split,
};
use std::{
    path::{Path, PathBuf},
    str::SplitAsciiWhitespace,
};
use trimip_core::{Error, Lens, Place, Result, plural::count, text};

const FILE: &str = "bundle.out";

/// Usual paths of the file.
const PLACES: [&str; 2] = [FILE, "bundle/bundle.out"];

/// Names of the list of photographs, next to `bundle.out` or in the folder of the scene.
const LISTS: [&str; 3] = ["list.txt", "image_list.txt", "bundle.out.list.txt"];

const ADVICE: &str = "export the cameras again (Bundler v0.3)";

/// Least bytes of a camera and of a point, whose numbers have at least one digit each.
const CAMERA: usize = 15 * 2;
const POINT: usize = 7 * 2;

pub(super) static READER: Reader = Reader {
    format: "bundler",
    name: "Bundler model",
    files: Some("bundle.out"),
    recognises: |root| path(root).is_some(),
    open: |root, config| {
        let path = path(root).unwrap_or_else(|| root.join(FILE));
        let bytes = files::read(&path)?;
        let listed = list(root, &path)?;
        let bundle = Bundle::read(&path.display().to_string(), &bytes, |index| listed.get(index).cloned())?;
        Ok(Box::new(Listing::new(root, config, &path, bundle.frames, bundle.facts)?))
    },
    images: Some("Bundler models"),
    divisible: true,
    camera_files: &[CameraFile { kind: "bundler", file: FILE, cameras, example, memory: 32 }],
};

fn path(root: &Path) -> Option<PathBuf> {
    files::first(root, &PLACES)
}

/// Returns the photographs in order of the cameras: the first word of each line.
fn list(root: &Path, bundle: &Path) -> Result<Vec<String>> {
    let folders = [bundle.parent().unwrap_or(root), root];
    let places = folders.iter().flat_map(|folder| LISTS.map(|name| folder.join(name)));
    let Some(path) = places.clone().find(|path| path.is_file()) else {
        let what = format!("has no list of photographs: looked for {}", LISTS.join(", "));
        return Err(Error::input(
            bundle.display(),
            what,
            "copy the list next to the file: one photograph per line, in the order of the cameras",
        ));
    };
    let text = text::read(&path, "check the path and its permissions")?;
    let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
    Ok(lines.map(|line| line.split_ascii_whitespace().next().unwrap_or(line).to_string()).collect())
}

/// Returns a file with two cameras and a point.
fn example() -> Vec<u8> {
    let camera = |x: f64| format!("9 0.01 -0.002\n1 0 0\n0 1 0\n0 0 1\n{x} 0.5 -4\n");
    let point = "0.1 0.2 0.3\n9 99 199\n2 0 0 1.5 -0.5 1 0 1.25 -0.5\n";
    format!("# Bundle file v0.3\n2 1\n{}{}{point}", camera(0.0), camera(0.2)).into_bytes()
}

fn cameras(name: &str, bytes: &[u8]) -> Result<NamedCameras> {
    let frames = Bundle::read(name, bytes, |index| Some(index.to_string()))?.frames;
    Ok(frames.iter().map(|frame| (names::stem(&frame.named), frame.camera([8, 6]))).collect())
}

/// The contents of a file.
struct Bundle {
    frames: Vec<Frame>,
    /// Points and warnings of the file.
    facts: Split,
}

impl Bundle {
    /// Reads a file. `photograph` returns the name of a camera's photograph.
    fn read(name: &str, bytes: &[u8], photograph: impl Fn(usize) -> Option<String>) -> Result<Self> {
        let text = String::from_utf8_lossy(&text::decoded(bytes)).into_owned();
        let body: String = text
            .lines()
            .filter(|line| !line.trim_start().starts_with('#'))
            .flat_map(|line| [line, "\n"])
            .collect();
        let mut words = Words { name, words: body.split_ascii_whitespace(), read: 0 };
        let (cameras, points) = (words.count(body.len() / CAMERA + 1)?, words.count(body.len() / POINT + 1)?);
        let (mut frames, mut unplaced) = (Vec::new(), 0);
        for index in 0..cameras {
            let [focal, k1, k2] = words.numbers()?;
            let rows: [[f64; 3]; 3] = [words.numbers()?, words.numbers()?, words.numbers()?];
            let translation: [f64; 3] = words.numbers()?;
            if focal == 0.0 {
                unplaced += 1;
                continue;
            }
            let wrong = |what: String| Error::input(format!("{name}: camera {index}"), what, ADVICE);
            if focal < 0.0 {
                return Err(wrong(format!("has the focal length {focal}")));
            }
            let row = |i: usize| [rows[i][0], rows[i][1], rows[i][2], translation[i]];
            let (to_camera, translation) = pose::checked([row(0), row(1), row(2)]).map_err(wrong)?;
            let named = photograph(index).ok_or_else(|| wrong("has no photograph in the list".into()))?;
            let rotation = to_camera.transpose();
            let lens = Lens::perspective([k1, k2, 0.0, 0.0], [0.0; 2], [0.0; 3]);
            frames.push(Frame {
                place: Place::part(name, format_args!("camera {index} ({named})")),
                named,
                rotation,
                origin: -(rotation * translation),
                calibration: Calibration::Unsized { focal: [focal; 2], centre: None, lens },
                split: None,
            });
        }
        let mut found = Vec::new();
        for _ in 0..points {
            let position = words.numbers()?;
            let color = words.numbers::<3>()?.map(|channel| channel.clamp(0.0, 255.0) as u8);
            let seen = words.count(body.len())?;
            for _ in 0..seen {
                words.numbers::<4>()?;
            }
            found.push(Point { position, color, error: None, seen: Some(seen), track: Vec::new() });
        }
        let warnings = (unplaced > 0)
            .then(|| format!("{name} has cameras of {} of {}", frames.len(), count(cameras, "photograph")))
            .into_iter()
            .collect();
        Ok(Self {
            frames,
            facts: Split { cloud: Cloud { points: found, ..Cloud::default() }, warnings, ..Split::default() },
        })
    }
}

/// The numbers of a file.
struct Words<'a> {
    name: &'a str,
    words: SplitAsciiWhitespace<'a>,
    /// Count of the numbers read so far.
    read: usize,
}

impl Words<'_> {
    fn wrong(&self, what: &str) -> Error {
        Error::input(format!("{}: number {}", self.name, self.read + 1), what, ADVICE)
    }

    fn numbers<const N: usize>(&mut self) -> Result<[f64; N]> {
        let mut values = [0.0; N];
        for value in &mut values {
            let word = self.words.next().ok_or_else(|| self.wrong("is missing: the file ends there"))?;
            *value = word
                .parse()
                .ok()
                .filter(|value: &f64| value.is_finite())
                .ok_or_else(|| self.wrong("is not a finite number"))?;
            self.read += 1;
        }
        Ok(values)
    }

    /// Reads a count, and refuses one above `most`, which the file cannot hold.
    fn count(&mut self, most: usize) -> Result<usize> {
        let [value] = self.numbers()?;
        let fits = value >= 0.0 && value.fract() == 0.0 && value <= most as f64;
        if fits { Ok(value as usize) } else { Err(self.wrong("is a count that the file cannot hold")) }
    }
}
