//! A capture of Record3D: `metadata.json`, or `metadata` of an unpacked `.r3d` file, and `rgb/` or `rgbd/` with the
//! photograph of each pose, named by its number. A pose is a quaternion (x, y, z, w) and a position, camera-to-world with
//! OpenGL axes, in ARKit's world with y up. `K` is the matrix of intrinsics column by column; `perFrameIntrinsicCoeffs`
//! has the focal lengths and the principal point of each photograph (as nerfstudio and Instant-NGP read them).

use super::reader::{CameraFile, NamedCameras, Reader};
use crate::{
    files,
    intrinsics::Size,
    json::{self, Node},
    listing::{Calibration, Frame, Listing},
    names,
    split::Split,
};
use glam::{DMat3, DQuat, DVec3};
use serde_json::{Value, json};
use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};
use trimip_core::{Error, Intrinsics, Lens, Place, Result, plural::count, text::decoded};

/// Possible names of the file.
const FILES: [&str; 2] = ["metadata.json", "metadata"];

/// Keys that identify the file.
const KEYS: [&str; 2] = ["\"K\"", "\"poses\""];

/// Folders of the photographs.
const FOLDERS: [&str; 2] = ["rgb", "rgbd"];

/// Largest difference between the length of a quaternion and 1.
const TOLERANCE: f64 = 1e-3;

const ADVICE: &str = "export the capture from Record3D again";

pub(super) static READER: Reader = Reader {
    format: "record3d",
    name: "capture of Record3D",
    files: Some("metadata.json with poses"),
    recognises: |root| path(root).is_some(),
    open: |root, config| {
        let path = path(root).unwrap_or_else(|| root.join(FILES[0]));
        let mut frames = frames(&path, &json::read(&path)?)?;
        name_photographs(root, &mut frames);
        Ok(Box::new(Listing::new(root, config, &path, frames, Split::default())?))
    },
    images: Some("captures of Record3D"),
    divisible: true,
    camera_files: &[CameraFile { kind: "record3d", file: FILES[0], cameras, example, memory: 160 }],
};

fn path(root: &Path) -> Option<PathBuf> {
    FILES.iter().map(|name| root.join(name)).find(|path| is_capture(path))
}

/// Returns true for a file with poses of Record3D: other scenes have a file of the same name.
pub(super) fn is_capture(path: &Path) -> bool {
    let Ok(bytes) = files::read(path) else { return false };
    let bytes = decoded(&bytes);
    let has = |key: &str| bytes.windows(key.len()).any(|part| part == key.as_bytes());
    KEYS.into_iter().all(has)
}

/// Returns a file with two poses.
fn example() -> Vec<u8> {
    let pose = |x: f64| json!([0.0, 0.6, 0.0, 0.8, x, 0.5, 4.0]);
    json!({ "w": 8, "h": 6, "K": [9.0, 0.0, 0.0, 0.0, 9.5, 0.0, 4.1, 3.2, 1.0], "poses": [pose(0.0), pose(0.25)] })
        .to_string()
        .into_bytes()
}

fn cameras(name: &str, bytes: &[u8]) -> Result<NamedCameras> {
    let path = Path::new(name);
    let frames = frames(path, &json::parse(path, bytes)?)?;
    Ok(frames.iter().map(|frame| (names::stem(&frame.named), frame.camera([8, 6]))).collect())
}

/// Returns the frames of a file. Their photographs are named by number, in the first folder.
fn frames(path: &Path, document: &Value) -> Result<Vec<Frame>> {
    let file = Node::new(path.display(), document)?;
    let size = Size::named(&file, ["w", "h"])?;
    let (Some(width), Some(height)) = (size.width, size.height) else {
        return Err(Error::input(&file.place, "has no \"w\" and \"h\"", ADVICE));
    };
    let poses = file.array("poses")?;
    let own = match file.get("perFrameIntrinsicCoeffs") {
        Some(_) => file.array("perFrameIntrinsicCoeffs")?,
        None => &[],
    };
    if !own.is_empty() && own.len() != poses.len() {
        let what = format!(
            "has {}, but the intrinsics of {}",
            count(poses.len(), "pose"),
            count(own.len(), "photograph")
        );
        return Err(Error::input(&file.place, what, ADVICE));
    }
    let shared = if own.is_empty() { Some(matrix(&file)?) } else { None };
    let frame = |(index, value): (usize, &Value)| {
        let place = Place::part(path, format_args!("pose {index}"));
        let wrong = |what: &str| Error::input(&place, what, ADVICE);
        let pose: [f64; 7] = numbers(value).ok_or_else(|| wrong("is not seven numbers"))?;
        let [x, y, z, w, ..] = pose;
        let quaternion = DQuat::from_xyzw(x, y, z, w);
        if !((quaternion.length() - 1.0).abs() < TOLERANCE) {
            return Err(wrong(&format!("has a quaternion of the length {:.4}", quaternion.length())));
        }
        let [fx, fy, cx, cy] = match shared {
            Some(shared) => shared,
            None => numbers(&own[index]).ok_or_else(|| wrong("has intrinsics that are not four numbers"))?,
        };
        if !(fx > 0.0 && fy > 0.0) {
            return Err(wrong(&format!("has the focal lengths {fx} and {fy}")));
        }
        let intrinsics = Intrinsics { width, height, fx, fy, cx, cy, lens: Lens::default() };
        Ok(Frame {
            named: format!("{}/{index}", FOLDERS[0]),
            place,
            rotation: DMat3::from_quat(quaternion.normalize()),
            origin: DVec3::new(pose[4], pose[5], pose[6]),
            calibration: Calibration::Sized(intrinsics),
            split: None,
        })
    };
    poses.iter().enumerate().map(frame).collect()
}

/// Returns the focal lengths and the principal point in the matrix for all photographs.
fn matrix(file: &Node<'_>) -> Result<[f64; 4]> {
    let value = file.required("K")?;
    let wrong = || file.unexpected("K", "a matrix of intrinsics, nine numbers column by column", value);
    let [fx, 0.0, 0.0, 0.0, fy, 0.0, cx, cy, 1.0] = numbers(value).ok_or_else(wrong)? else {
        return Err(wrong());
    };
    Ok([fx, fy, cx, cy])
}

/// Reads an array of `N` numbers.
fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let values: Vec<f64> = value.as_array()?.iter().map(Value::as_f64).collect::<Option<_>>()?;
    values.try_into().ok()
}

/// Replaces the names of the photographs by those in the folder, where numbers may have leading zeros.
fn name_photographs(root: &Path, frames: &mut [Frame]) {
    let Some(folder) = FOLDERS.into_iter().find(|folder| root.join(folder).is_dir()) else { return };
    let mut called: HashMap<usize, String> = HashMap::new();
    for path in root.join(folder).read_dir().into_iter().flatten().flatten().map(|entry| entry.path()) {
        let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        if let (true, Ok(number)) = (names::is_picture(&path), names::key(&name).parse()) {
            called.insert(number, name);
        }
    }
    for (index, frame) in frames.iter_mut().enumerate() {
        let name = called.remove(&index).unwrap_or_else(|| index.to_string());
        frame.named = format!("{folder}/{name}");
    }
}
