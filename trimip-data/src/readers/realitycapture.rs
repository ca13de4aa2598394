//! Cameras of RealityCapture and RealityScan as CSV (Registration, "Internal/External camera parameters"). A line has
//! the name of a photograph; its position; heading, pitch and roll in degrees; the focal length in millimetres for a
//! longer side of 36 mm; the principal point relative to the middle, as a multiple of the longer side; and Brown's
//! coefficients. World axes are x to the east, y to the north and z up. A camera without rotation looks down, and its
//! upper side points north (nerfstudio's importer; RealityCapture's article on registration export).

use super::reader::{CameraFile, NamedCameras, Reader};
use crate::{
    files,
    listing::{Calibration, Frame, Listing},
    names,
    numbers::number,
    split::Split,
};
use glam::{DMat3, DVec3};
use std::{
    io::Read,
    path::{Path, PathBuf},
};
use trimip_core::{Error, Lens, Place, Result, plain_file, text::decoded};

/// The usual name of the file.
const FILE: &str = "cameras.csv";

/// Number of bytes at the beginning of a CSV file that are searched for the names of its columns.
const HEAD: u64 = 4096;

/// Required columns, and optional ones in the order of their use.
const NEEDED: [&str; 8] = ["name", "x", "y", "alt", "heading", "pitch", "roll", "f"];
const OTHERS: [&str; 8] = ["px", "py", "k1", "k2", "k3", "k4", "t1", "t2"];

/// Separators of columns.
const SEPARATORS: [char; 3] = [',', ';', '\t'];

/// The longer side for which focal lengths are stated, millimetres.
const SIDE: f64 = 36.0;

/// Upper limit of focal lengths in millimetres, and of principal points as multiples of the longer side.
const MOST: f64 = 1e6;

const ADVICE: &str = "export Internal/External camera parameters again";

pub(super) static READER: Reader = Reader {
    format: "realitycapture",
    name: "camera export of RealityCapture",
    files: Some("a CSV of camera parameters"),
    recognises: |root| !paths(root).is_empty(),
    open: |root, config| {
        let paths = paths(root);
        if let [first, second, ..] = &paths[..] {
            let what = format!("holds camera parameters, and so does {}", second.display());
            return Err(Error::input(first.display(), what, "keep only one of them in the folder"));
        }
        let path = paths.into_iter().next().unwrap_or_else(|| root.join(FILE));
        let frames = frames(&path.display().to_string(), &files::read(&path)?)?;
        Ok(Box::new(Listing::new(root, config, &path, frames, Split::default())?))
    },
    images: Some("camera exports of RealityCapture"),
    divisible: true,
    camera_files: &[CameraFile { kind: "realitycapture", file: FILE, cameras, example, memory: 96 }],
};

/// Returns the CSV files of a folder that hold camera parameters.
fn paths(root: &Path) -> Vec<PathBuf> {
    let is_export = |path: &PathBuf| {
        let mut head = Vec::new();
        let read = plain_file::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
        let head = String::from_utf8_lossy(&decoded(&head)).into_owned();
        read.is_ok() && head.lines().any(|line| Columns::of(line).is_some())
    };
    let entries = root.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
    let csv = |path: &PathBuf| path.extension().is_some_and(|end| end.eq_ignore_ascii_case("csv"));
    let mut files: Vec<PathBuf> = entries.filter(csv).filter(is_export).collect();
    files.sort();
    files
}

/// Returns a file with two cameras.
fn example() -> Vec<u8> {
    let camera =
        |x: f64| format!("{x}.jpg,{x},2,3,170.5,85.25,-22.5,24.5,-9.5e-004,2e-4,0.01,-0.002,1e-3,0,1e-4,0\n");
    format!("#name,{},{}\n{}{}", NEEDED[1..].join(","), OTHERS.join(","), camera(0.0), camera(0.25))
        .into_bytes()
}

fn cameras(name: &str, bytes: &[u8]) -> Result<NamedCameras> {
    let frames = frames(name, bytes)?;
    Ok(frames.iter().map(|frame| (names::stem(&frame.named), frame.camera([8, 6]))).collect())
}

/// Indices of the columns of a file.
struct Columns {
    separator: char,
    count: usize,
    needed: [usize; 8],
    others: [Option<usize>; 8],
}

impl Columns {
    /// Finds the columns that a line names. Returns `None` if a required one is missing.
    fn of(line: &str) -> Option<Self> {
        let line = line.trim().trim_start_matches('#');
        SEPARATORS.into_iter().find_map(|separator| {
            let named: Vec<String> =
                line.split(separator).map(|name| name.trim().trim_matches('"').to_lowercase()).collect();
            let at = |name: &str| named.iter().position(|other| other == name);
            let needed: Vec<usize> = NEEDED.into_iter().map(at).collect::<Option<_>>()?;
            Some(Self {
                separator,
                count: named.len(),
                needed: needed.try_into().ok()?,
                others: OTHERS.map(at),
            })
        })
    }
}

/// Returns the frames of a file.
fn frames(name: &str, bytes: &[u8]) -> Result<Vec<Frame>> {
    let text = String::from_utf8_lossy(&decoded(bytes)).into_owned();
    let mut lines = text.lines().enumerate();
    let columns = lines.find_map(|(_, line)| Columns::of(line)).ok_or_else(|| {
        let what = format!("has no line that names the columns {}", NEEDED.join(", "));
        Error::input(name, what, ADVICE)
    })?;
    let is_camera = |line: &str| !(line.trim().is_empty() || line.starts_with('#'));
    lines
        .filter(|(_, line)| is_camera(line))
        .map(|(index, line)| frame(name, index, line, &columns))
        .collect()
}

/// Returns the frame of a line.
fn frame(name: &str, index: usize, line: &str, columns: &Columns) -> Result<Frame> {
    let place = Place::line(name, index + 1);
    let wrong = |what: String| Error::input(&place, what, ADVICE);
    let cells: Vec<&str> = line.split(columns.separator).map(|cell| cell.trim().trim_matches('"')).collect();
    if cells.len() != columns.count {
        return Err(wrong(format!("has {} columns, but the header names {}", cells.len(), columns.count)));
    }
    let read = |column: &str, at: usize| number(cells[at]).map_err(|what| wrong(format!("{column}: {what}")));
    let mut needed = [0.0; 7];
    for (value, (column, at)) in needed.iter_mut().zip(NEEDED.iter().zip(columns.needed).skip(1)) {
        *value = read(column, at)?;
    }
    let mut others = [0.0; 8];
    for (value, (column, at)) in others.iter_mut().zip(OTHERS.iter().zip(columns.others)) {
        *value = at.map_or(Ok(0.0), |at| read(column, at))?;
    }
    let [x, y, alt, heading, pitch, roll, focal] = needed;
    let [px, py, k1, k2, k3, k4, t1, t2] = others;
    let named = cells[columns.needed[0]];
    if named.is_empty() {
        return Err(wrong("names no photograph".into()));
    }
    if !(focal > 0.0 && focal < MOST) {
        return Err(wrong(format!("f: the focal length is {focal}")));
    }
    if !(px.abs() < MOST && py.abs() < MOST) {
        return Err(wrong(format!("px, py: the principal point is {px}, {py}")));
    }
    // A fit of Brown's model has more than one nonzero term.
    if k1 != 0.0 && [k2, k3, k4, t1, t2] == [0.0; 5] {
        let what = "k1: a single coefficient is that of the division model, which is not read";
        let advice =
            "align with the distortion model Brown3 and export again, or export undistorted photographs";
        return Err(Error::input(&place, what, advice));
    }
    let turn = |angle: f64| angle.to_radians();
    let rotation = DMat3::from_rotation_z(-turn(heading))
        * DMat3::from_rotation_x(turn(pitch))
        * DMat3::from_rotation_y(turn(roll));
    let lens = Lens::perspective([k1, k2, k3, k4], [t1, t2], [0.0; 3]);
    Ok(Frame {
        named: named.into(),
        place: place.within(format_args!("({named})")),
        rotation,
        origin: DVec3::new(x, y, alt),
        calibration: Calibration::Relative { focal: focal / SIDE, centre: [px, py], lens },
        split: None,
    })
}
