//! LLFF's `poses_bounds.npy`: a NumPy array of N × 17 numbers, a row for each photograph in order of their names. A row is a
//! 3 × 5 matrix [R | t | (h, w, f)], row by row, then the near and far bounds. The columns of R are the camera's axes down, right
//! and backwards in the world; h, w, f are pixels of the original photographs (Mildenhall et al. 2019, `load_llff.py` of NeRF).

use super::reader::{CameraFile, OpenScene, Reader};
use crate::{
    division::{self, Selection},
    names, npy,
    photograph::Photograph,
    pose,
    settings::DataConfig,
    source::{Pixels, Source, map_in_order},
    split::Split,
};
use glam::{DMat3, DVec3};
use std::path::{Path, PathBuf};
use trimip_core::{Camera, Error, Intrinsics, Lens, Place, Result, plain_file, plural::count};

const FILE: &str = "poses_bounds.npy";

/// Number of columns.
const COLUMNS: usize = 17;

/// Advice for an invalid file.
const ADVICE: &str = "compute the poses again (imgs2poses.py of LLFF)";

/// Folders of photographs that are tried in this order if the settings name none; the number is LLFF's factor of reduction.
const FOLDERS: [&str; 3] = ["images", "images_4", "images_8"];

pub(super) static READER: Reader = Reader {
    format: "llff",
    name: "LLFF capture",
    files: Some(FILE),
    recognises: |root| root.join(FILE).is_file(),
    open: |root, config| Ok(Box::new(Capture::open(root, config)?)),
    images: Some("LLFF captures"),
    divisible: true,
    camera_files: &[CameraFile { kind: "poses-bounds", file: FILE, cameras, example, memory: 16 }],
};

/// Returns a file of two photographs.
fn example() -> Vec<u8> {
    let row = |x: f64| [0., 1., 0., x, 6., -1., 0., 0., 0., 8., 0., 0., 1., 4., 9., 1., 7.];
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': (2, {COLUMNS}), }}\n");
    let start = [b"\x93NUMPY\x01\0", &(header.len() as u16).to_le_bytes()[..], header.as_bytes()].concat();
    let values = [row(0.), row(1.)].concat().into_iter().flat_map(f64::to_le_bytes);
    start.into_iter().chain(values).collect()
}

/// Returns the cameras of a file, named by their numbers.
fn cameras(name: &str, bytes: &[u8]) -> Result<Vec<(String, Camera)>> {
    let camera = |index: usize, row: &[f64; COLUMNS]| {
        let row = Row::new(&Place::part(name, format_args!("pose {index}")), row)?;
        Ok((index.to_string(), row.camera(row.size.map(|side| side.round() as u32))))
    };
    let rows = npy::rows::<COLUMNS>(name, bytes, ADVICE)?;
    rows.iter().enumerate().map(|(index, row)| camera(index, row)).collect()
}

/// A pose with the size and the focal length of its original photograph, pixels.
struct Row {
    rotation: DMat3,
    origin: DVec3,
    /// Width and height.
    size: [f64; 2],
    focal: f64,
}

impl Row {
    /// Parses a row of the file; `place` names the row in errors.
    fn new(place: &Place, row: &[f64; COLUMNS]) -> Result<Self> {
        let wrong = |what: String| Error::input(place, what, ADVICE);
        let matrix = [0, 5, 10].map(|start| [row[start + 1], -row[start], row[start + 2], row[start + 3]]);
        let (rotation, origin) = pose::checked(matrix).map_err(wrong)?;
        let (size, focal) = ([row[9], row[4]], row[14]);
        let most = f64::from(u32::MAX);
        if !(size.iter().all(|side| (1.0..=most).contains(side)) && focal > 0.0 && focal <= most) {
            let what = format!("states {} x {} pixels and the focal length {focal}", size[0], size[1]);
            return Err(wrong(what));
        }
        Ok(Self { rotation, origin, size, focal })
    }

    /// Returns the camera for a photograph of `pixels`. Its width and its height may be different multiples of the stated ones.
    fn camera(&self, pixels: [u32; 2]) -> Camera {
        let [width, height] = pixels;
        let [fx, fy] = [0, 1].map(|side| self.focal * (f64::from(pixels[side]) / self.size[side]));
        let (cx, cy) = (0.5 * f64::from(width), 0.5 * f64::from(height));
        let intrinsics = Intrinsics { width, height, fx, fy, cx, cy, lens: Lens::default() };
        Camera { intrinsics, rotation: self.rotation, origin: self.origin }
    }

    /// Returns true if a photograph has the aspect ratio of the stated size, up to rounding to whole pixels.
    fn has_shape_of(&self, image: &Photograph) -> bool {
        let sides = [(image.width, self.size[0]), (image.height, self.size[1])];
        let [x, y] = sides.map(|(side, stated)| [-1.0, 1.0].map(|by| (f64::from(side) + by) / stated));
        x[0].max(y[0]) < x[1].min(y[1])
    }
}

/// A capture before any photograph is opened.
struct Capture {
    path: PathBuf,
    poses: Vec<Row>,
    photographs: Vec<PathBuf>,
    names: Vec<String>,
    scales: u32,
    note: Option<String>,
}

impl Capture {
    fn open(root: &Path, config: &DataConfig) -> Result<Self> {
        let path = root.join(FILE);
        let name = path.display().to_string();
        let bytes = plain_file::read(&path).map_err(|error| {
            Error::input(
                &name,
                format!("cannot be read: {error}"),
                "set data.root to the folder that holds it",
            )
        })?;
        let rows = npy::rows::<COLUMNS>(&name, &bytes, ADVICE)?;
        let (folder, photographs) = photographs(root, &config.images)?;
        if rows.len() != photographs.len() {
            let shown = |path: Option<&PathBuf>| {
                path.and_then(|path| path.file_name()).unwrap_or_default().to_owned()
            };
            let what = format!(
                "holds {}, but {} holds {}, from {} to {}",
                count(rows.len(), "pose"),
                folder.display(),
                count(photographs.len(), "photograph"),
                shown(photographs.first()).display(),
                shown(photographs.last()).display()
            );
            let advice = "keep exactly the photographs that the file was made from, or name their folder in data.images";
            return Err(Error::input(&name, what, advice));
        }
        let files: Vec<String> = photographs.iter().map(|path| path.display().to_string()).collect();
        let poses = rows.iter().zip(&photographs).enumerate();
        let poses = poses.map(|(index, (row, photograph))| Row::new(&place(&path, index, photograph), row));
        let near = rows.iter().map(|row| row[15]).fold(f64::INFINITY, f64::min);
        let far = rows.iter().map(|row| row[16]).fold(0.0, f64::max);
        let note = (near > 0.0 && near < far)
            .then(|| format!("{FILE} states depths of the scene from {near:.3} to {far:.3} of its units"));
        let (poses, names) = (poses.collect::<Result<_>>()?, names::unique(&files));
        Ok(Self { poses, names, photographs, scales: config.scales, note, path })
    }

    fn selected(&self, split: &str, selection: &Selection) -> Result<Split> {
        let chosen = selection.choose(self.poses.len());
        if chosen.is_empty() {
            return Err(division::empty(&self.path, split, self.poses.len(), selection));
        }
        let sources = map_in_order(&chosen, |_, &index| self.source(index))?;
        let mut warnings: Vec<String> = selection.warning(&self.path).into_iter().collect();
        let mut scaled = chosen.iter().zip(&sources).filter_map(|(&index, source)| {
            let by =
                source.files().first().map_or(1.0, |file| f64::from(file.width) / self.poses[index].size[0]);
            (by != 1.0).then_some(by)
        });
        warnings.extend(scaled.next().map(|by| {
            format!(
                "the photographs are {by:.4} times as wide as {FILE} states: focal lengths are scaled to match"
            )
        }));
        let divided = selection.note(&self.path, "in order of their names");
        let notes = divided.into_iter().chain(self.note.iter().cloned()).collect();
        Ok(Split { sources, warnings, notes, ..Split::default() })
    }

    /// Returns a frame with the header of its photograph.
    fn source(&self, index: usize) -> Result<Source> {
        let (row, path) = (&self.poses[index], &self.photographs[index]);
        let place = place(&self.path, index, path);
        let image = Photograph::open(path.clone(), place.clone())?;
        let [width, height] = row.size.map(|side| Some(side as u32));
        let image = image.fit(width, height);
        if !row.has_shape_of(&image) {
            let what = format!(
                "image {} is {}x{} pixels, but the file states {}x{}",
                path.display(),
                image.width,
                image.height,
                row.size[0],
                row.size[1]
            );
            let advice = "use the images the poses were computed for, in any size of the same shape";
            return Err(Error::input(&place, what, advice));
        }
        let camera = row.camera([image.width, image.height]);
        Source::averaged(self.names[index].clone(), camera, self.scales, &place, Pixels::Photograph(image))
    }
}

impl OpenScene for Capture {
    fn split(&self, split: &str) -> Result<Split> {
        match split {
            "train" => self.selected(split, &Selection::Train),
            "test" => self.selected(split, &Selection::Test),
            _ => Err(division::unknown(&self.path, split, "train, test")),
        }
    }

    fn undivided(&self) -> Result<Option<Split>> {
        self.selected("train", &Selection::All).map(Some)
    }
}

/// Describes a row of the file.
fn place(file: &Path, index: usize, photograph: &Path) -> Place {
    let name = photograph.file_name().unwrap_or_default();
    Place::part(file, format_args!("pose {index} ({})", name.display()))
}

/// Returns the folder `named` in `root`, or the first usual one with photographs, and its photographs in order of their names.
fn photographs(root: &Path, named: &str) -> Result<(PathBuf, Vec<PathBuf>)> {
    let tried: Vec<PathBuf> = match named {
        "" => FOLDERS.map(|folder| root.join(folder)).into(),
        named => vec![root.join(named)],
    };
    let pictures = |folder: &PathBuf| {
        let entries = folder.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
        let mut found: Vec<PathBuf> = entries.filter(|path| names::is_picture(path)).collect();
        found.sort();
        (!found.is_empty()).then(|| (folder.clone(), found))
    };
    tried.iter().find_map(pictures).ok_or_else(|| {
        let tried: Vec<String> = tried.iter().map(|folder| folder.display().to_string()).collect();
        let what = format!("holds no photographs of {FILE}: looked into {}", tried.join(", "));
        Error::input(root.display(), what, "copy them there, or name their folder in data.images")
    })
}
