//! Cameras on a rail: `dummy.txt` has a line for each photograph with its file, its focal length in pixels and the position of
//! its camera. All cameras look along −z of the world, and y is up in their photographs.

use super::reader::{CameraFile, NamedCameras, OpenScene, Reader};
use crate::{
    division::{self, Selection},
    names,
    photograph::Photograph,
    pictures::Pictures,
    settings::DataConfig,
    source::{Pixels, Source, map_in_order},
    split::Split,
};
use glam::{DMat3, DVec3};
use std::path::{Path, PathBuf};
use trimip_core::{Camera, Error, Intrinsics, Lens, Place, Result, text::without_mark};

const FILE: &str = "dummy.txt";

pub(super) static READER: Reader = Reader {
    format: "dummy",
    name: "rail of cameras",
    files: Some(FILE),
    recognises: |root| root.join(FILE).is_file(),
    open: |root, config| Ok(Box::new(Rail::open(root, config)?)),
    divisible: true,
    camera_files: &[CameraFile { kind: "dummy", file: FILE, cameras, example, memory: 160 }],
    ..Reader::PLAIN
};

/// Returns a valid file with two photographs.
fn example() -> Vec<u8> {
    b"a.png 9.5 0 0 4\nb.png 9.5 0.25 0 4\n".to_vec()
}

/// Returns the cameras of a file.
fn cameras(name: &str, bytes: &[u8]) -> Result<NamedCameras> {
    let lines = lines(name, bytes)?;
    Ok(short_names(&lines).into_iter().zip(lines.iter().map(|line| line.camera(8, 6))).collect())
}

/// A line of the file.
struct Line {
    place: Place,
    photograph: String,
    focal: f64,
    origin: DVec3,
}

impl Line {
    fn new(place: Place, text: &str) -> Result<Self> {
        let wrong =
            |what: &str| Error::input(&place, what, "write the photograph, its focal length, and x, y, z");
        let mut words = text.split_whitespace();
        let photograph = words.next().unwrap_or_default().to_string();
        let numbers: Option<Vec<f64>> = words.map(|word| word.parse().ok()).collect();
        let [focal, x, y, z] = numbers.unwrap_or_default()[..] else {
            return Err(wrong("is no name with four numbers"));
        };
        let origin = DVec3::new(x, y, z);
        if !(origin.is_finite() && (1.0..=1e9).contains(&focal)) {
            return Err(wrong("has a place that is not finite, or a focal length outside of 1 to 1e9"));
        }
        Ok(Self { photograph, focal, origin, place })
    }

    /// Returns the camera of a photograph of the given size.
    fn camera(&self, width: u32, height: u32) -> Camera {
        let (cx, cy) = (0.5 * f64::from(width), 0.5 * f64::from(height));
        let (fx, fy, lens) = (self.focal, self.focal, Lens::default());
        let intrinsics = Intrinsics { width, height, fx, fy, cx, cy, lens };
        Camera { intrinsics, rotation: DMat3::IDENTITY, origin: self.origin }
    }
}

/// Parses the lines of a file.
fn lines(name: &str, bytes: &[u8]) -> Result<Vec<Line>> {
    let text = String::from_utf8_lossy(without_mark(bytes));
    let written = text.lines().zip(1..).filter(|(line, _)| !line.trim().is_empty());
    let lines: Vec<Line> =
        written.map(|(line, number)| Line::new(Place::line(name, number), line)).collect::<Result<_>>()?;
    match lines.is_empty() {
        true => Err(Error::input(name, "names no photograph", "write a line for each")),
        false => Ok(lines),
    }
}

fn short_names(lines: &[Line]) -> Vec<String> {
    names::unique(&lines.iter().map(|line| &line.photograph).collect::<Vec<_>>())
}

/// A scene before any photograph is opened.
struct Rail {
    root: PathBuf,
    lines: Vec<Line>,
    names: Vec<String>,
    scales: u32,
}

impl Rail {
    fn open(root: &Path, config: &DataConfig) -> Result<Self> {
        let path = root.join(FILE);
        let bytes = std::fs::read(&path).map_err(|error| {
            let what = format!("cannot be read: {error}");
            Error::input(path.display(), what, "set data.root to the folder that holds it")
        })?;
        let lines = lines(&path.display().to_string(), &bytes)?;
        Ok(Self { names: short_names(&lines), lines, root: root.into(), scales: config.scales })
    }

    fn selected(&self, split: &str, selection: &Selection) -> Result<Split> {
        let (path, chosen) = (self.root.join(FILE), selection.choose(self.lines.len()));
        if chosen.is_empty() {
            return Err(division::empty(&path, split, self.lines.len(), selection));
        }
        let pictures = Pictures::new(&self.root);
        let sources = map_in_order(&chosen, |_, &index| self.source(&pictures, index))?;
        let warnings = selection.warning(&path).into_iter().collect();
        let notes = selection.note(&path, "in order of their lines").into_iter().collect();
        Ok(Split { sources, warnings, notes, ..Split::default() })
    }

    /// Returns a frame, after reading the header of its photograph.
    fn source(&self, pictures: &Pictures, index: usize) -> Result<Source> {
        let Line { place, photograph, .. } = &self.lines[index];
        let image = Photograph::open(pictures.find(photograph, place)?.path, place.clone())?;
        let camera = self.lines[index].camera(image.width, image.height);
        Source::averaged(self.names[index].clone(), camera, self.scales, place, Pixels::Photograph(image))
    }
}

impl OpenScene for Rail {
    fn split(&self, split: &str) -> Result<Split> {
        match split {
            "train" => self.selected(split, &Selection::Train),
            "test" => self.selected(split, &Selection::Test),
            _ => Err(division::unknown(&self.root.join(FILE), split, "train, test")),
        }
    }

    fn undivided(&self) -> Result<Option<Split>> {
        self.selected("train", &Selection::All).map(Some)
    }
}
