//! The layout of NSVF's data sets, also of its Tanks and Temples: `rgb/` and `pose/` with a file of each name, `intrinsics.txt` and
//! `bbox.txt`. Poses are camera-to-world with x right, y down and z forward. Names begin with the number of their split (Liu et al. 2020,
//! README of NSVF).

use super::reader::Reader;
use crate::{
    listing::{Calibration, Frame, Listing},
    names, numbers, pose,
    source::map_in_order,
    split::Split,
};
use glam::DMat3;
use std::path::{Path, PathBuf};
use trimip_core::{Aabb, Error, Lens, Result, scene_plan::StatedBox};

/// Folder of the poses, and the file of the intrinsics.
const POSES: &str = "pose";
const INTRINSICS: &str = "intrinsics.txt";

/// The box of the scene: two corners, and perhaps the size of a voxel.
const BOX: &str = "bbox.txt";

/// The splits by the number that names begin with.
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
        let calibration = calibration(&root.join(INTRINSICS))?;
        let frames = map_in_order(&files, |_, path| frame(path, calibration))?;
        let facts = Split { stated: bounds(&root.join(BOX))?, ..Split::default() };
        Ok(Box::new(Listing::new(root, config, &folder, frames, facts)?))
    },
    images: Some("NSVF layouts"),
    divisible: true,
    camera_files: &[],
};

/// A frame whose pose is the file's; its photograph has the same name.
fn frame(path: &Path, calibration: Calibration) -> Result<Frame> {
    let place = path.display().to_string();
    let rows = numbers::lines(path, ADVICE)?;
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

/// Focal lengths and principal point: a matrix, or a line with the focal length and the principal point.
fn calibration(path: &Path) -> Result<Calibration> {
    let lines = numbers::lines(path, ADVICE)?;
    let found = match &lines[..] {
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

/// The box of the scene, if its file is there.
fn bounds(path: &Path) -> Result<Option<StatedBox>> {
    if !path.is_file() {
        return Ok(None);
    }
    let all = numbers::lines(path, ADVICE)?.concat();
    let Some(&[x, y, z, to_x, to_y, to_z]) = all.first_chunk() else {
        return Err(Error::input(path.display(), "holds no two corners", ADVICE));
    };
    let aabb = Aabb { min: [x, y, z], max: [to_x, to_y, to_z] };
    if (0..3).any(|axis| aabb.min[axis] >= aabb.max[axis]) {
        return Err(Error::input(
            path.display(),
            format!("states the corners {:?} and {:?}", aabb.min, aabb.max),
            ADVICE,
        ));
    }
    Ok(Some(StatedBox { aabb, source: format!("of {BOX}"), around_points: true }))
}
