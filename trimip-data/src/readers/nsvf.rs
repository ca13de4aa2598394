//! The layout of NSVF's data sets, among them its version of Tanks and Temples: `rgb/` and `pose/` with one file of the
//! same name per frame, `intrinsics.txt` and `bbox.txt`. Poses are camera-to-world with x right, y down and z forward.
//! Names begin with the number of their split (Liu et al. 2020, README of NSVF).

use super::reader::{CameraFile, NamedCameras, Reader};
use crate::{
    listing::{Calibration, Frame, Listing},
    names, numbers, pose,
    source::map_in_order,
    split::Split,
};
use glam::DMat3;
use std::path::{Path, PathBuf};
use trimip_core::{Aabb, Error, Lens, Place, Result, scene_plan::StatedBox};

/// Folder of the poses, and the file of the intrinsics.
const POSES: &str = "pose";
const INTRINSICS: &str = "intrinsics.txt";

/// File of the scene's box: two corners, and perhaps the size of a voxel.
const BOX: &str = "bbox.txt";

/// Beginnings of names, and the splits that they mean.
const SPLITS: [(&str, &str); 3] = [("0_", "train"), ("1_", "val"), ("2_", "test")];

const ADVICE: &str = "copy the file again";

pub(super) static READER: Reader = Reader {
    format: "nsvf",
    name: "NSVF layout",
    files: Some("pose/ with intrinsics.txt"),
    recognises: |root| root.join(POSES).is_dir() && root.join(INTRINSICS).is_file(),
    open: |root, config| {
        let folder = root.join(POSES);
        let entries = folder.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
        let mut files: Vec<PathBuf> = entries
            .filter(|path| path.extension().is_some_and(|end| end == "txt") && !names::is_hidden(path))
            .collect();
        files.sort();
        let path = root.join(INTRINSICS);
        let calibration = calibration(&path, &numbers::lines(&path, ADVICE)?)?;
        let frames =
            map_in_order(&files, |_, path| frame(path, &numbers::lines(path, ADVICE)?, calibration))?;
        let facts = Split { stated: bounds(&root.join(BOX))?, ..Split::default() };
        Ok(Box::new(Listing::new(root, config, &folder, frames, facts)?))
    },
    images: Some("NSVF layouts"),
    divisible: true,
    camera_files: &[
        CameraFile {
            kind: "nsvf-pose",
            file: "pose/0_0000.txt",
            cameras: camera_of_pose,
            example: || EXAMPLE_POSE.into(),
            memory: 64,
        },
        CameraFile {
            kind: "nsvf-intrinsics",
            file: INTRINSICS,
            cameras: camera_of_intrinsics,
            example: || EXAMPLE_INTRINSICS.into(),
            memory: 64,
        },
    ],
};

/// Examples of a pose and of a matrix of intrinsics, as in the files.
const EXAMPLE_POSE: &str = "0.8 0 0.6 0.25\n0 1 0 0.5\n-0.6 0 0.8 4\n0 0 0 1\n";
const EXAMPLE_INTRINSICS: &str = "9 0 4.1 0\n0 9.5 3.2 0\n0 0 1 0\n0 0 0 1\n";

fn camera_of_pose(name: &str, bytes: &[u8]) -> Result<NamedCameras> {
    let matrix = numbers::parse(Path::new(INTRINSICS), EXAMPLE_INTRINSICS.as_bytes(), ADVICE)?;
    camera(name, &numbers::parse(Path::new(name), bytes, ADVICE)?, INTRINSICS, &matrix)
}

fn camera_of_intrinsics(name: &str, bytes: &[u8]) -> Result<NamedCameras> {
    let pose = numbers::parse(Path::new(POSES), EXAMPLE_POSE.as_bytes(), ADVICE)?;
    camera(POSES, &pose, name, &numbers::parse(Path::new(name), bytes, ADVICE)?)
}

/// Returns the camera with the numbers of a pose file and of an intrinsics file.
fn camera(pose: &str, rows: &[Vec<f64>], intrinsics: &str, matrix: &[Vec<f64>]) -> Result<NamedCameras> {
    let frame = frame(Path::new(pose), rows, calibration(Path::new(intrinsics), matrix)?)?;
    Ok(vec![(names::stem(&frame.named), frame.camera([8, 6]))])
}

/// Returns the frame of a pose file with the numbers `rows`; its photograph has the same name.
fn frame(path: &Path, rows: &[Vec<f64>], calibration: Calibration) -> Result<Frame> {
    let place = Place::from(path);
    let row = |i: usize| rows.get(i).and_then(|row| row.first_chunk()).copied();
    let [Some(a), Some(b), Some(c)] = [row(0), row(1), row(2)] else {
        return Err(Error::input(&place, "is not a 4x4 matrix", ADVICE));
    };
    let (axes, origin) = pose::checked([a, b, c]).map_err(|what| Error::input(&place, what, ADVICE))?;
    let rotation = DMat3::from_cols(axes.x_axis, -axes.y_axis, -axes.z_axis);
    let name = path.file_stem().unwrap_or_default().to_string_lossy();
    let split = SPLITS.iter().find(|(start, _)| name.starts_with(start)).map(|(_, split)| *split);
    Ok(Frame { named: format!("rgb/{}", names::key(&name)), place, rotation, origin, calibration, split })
}

/// Reads focal lengths and principal point from the numbers of a file: a matrix, or a line with the focal length and the principal point.
fn calibration(path: &Path, lines: &[Vec<f64>]) -> Result<Calibration> {
    let found = match lines {
        [first, second, ..] if first.len() == second.len() && first.len() >= 3 => {
            Some(([first[0], second[1]], [first[2], second[2]]))
        }
        [all] if all.len() == 16 || all.len() == 9 => {
            let side = if all.len() == 16 { 4 } else { 3 };
            Some(([all[0], all[side + 1]], [all[2], all[side + 2]]))
        }
        [first, ..] if first.len() >= 3 => Some(([first[0]; 2], [first[1], first[2]])),
        _ => None,
    };
    let found = found.filter(|(focal, _)| focal.iter().all(|focal| *focal > 0.0));
    let (focal, centre) = found.ok_or_else(|| {
        let what = "states neither a matrix nor a focal length and a principal point";
        Error::input(path.display(), what, ADVICE)
    })?;
    Ok(Calibration::Unsized { focal, centre: Some(centre), lens: Lens::default() })
}

/// Reads the box of the scene, if its file exists.
fn bounds(path: &Path) -> Result<Option<StatedBox>> {
    if !path.is_file() {
        return Ok(None);
    }
    let all = numbers::lines(path, ADVICE)?.concat();
    let Some(&[x, y, z, to_x, to_y, to_z]) = all.first_chunk() else {
        return Err(Error::input(path.display(), "does not hold two corners", ADVICE));
    };
    let aabb = Aabb { min: [x, y, z], max: [to_x, to_y, to_z] };
    if (0..3).any(|axis| aabb.min[axis] >= aabb.max[axis]) {
        return Err(Error::input(
            path.display(),
            format!("states the corners {:?} and {:?}, which enclose no box", aabb.min, aabb.max),
            ADVICE,
        ));
    }
    Ok(Some(StatedBox { aabb, source: format!("of {BOX}"), around_points: true }))
}
