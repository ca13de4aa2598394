//! A raw export of Polycam: a JSON file for each photograph in `keyframes/`. The reader prefers corrected poses, if the
//! export has them. Keys `t_00` to `t_23` are the rows of a camera-to-world matrix with OpenGL axes, in ARKit's world
//! with y up. The reader turns the world so that z is up, as nerfstudio does.

use super::reader::{CameraFile, NamedCameras, Reader};
use crate::{
    depth_image::DepthFile,
    intrinsics::Size,
    json::{self, Node},
    listing::{Calibration, Frame, Listing},
    names, pose,
    source::map_in_order,
    split::Split,
};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use trimip_core::{Error, Intrinsics, Lens, Result};

/// Folders of poses and of their photographs.
const FOLDERS: [[&str; 2]; 2] = [
    ["keyframes/corrected_cameras", "keyframes/corrected_images"],
    ["keyframes/cameras", "keyframes/images"],
];

/// Folders of depth and confidence images, named like the photographs. Both are ARKit's: 16-bit millimetres, and 0
/// where the depth is unreliable (Polycam's polyform, README).
const DEPTHS: [&str; 2] = ["keyframes/depth", "keyframes/confidence"];

/// The usual path of a file with a pose.
const FILE: &str = "keyframes/cameras/0.json";

pub(super) static READER: Reader = Reader {
    format: "polycam",
    name: "raw export of Polycam",
    files: Some("keyframes/cameras"),
    recognises: |root| folders(root).is_some(),
    open: |root, config| {
        let Some([poses, images]) = folders(root) else {
            let what = "holds no raw export of Polycam: looked for keyframes/cameras";
            return Err(Error::input(root.display(), what, "export it from Polycam with raw data"));
        };
        let folder = root.join(poses);
        let entries = folder.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
        let mut files: Vec<PathBuf> = entries
            .filter(|path| path.extension().is_some_and(|end| end == "json") && !names::is_hidden(path))
            .collect();
        files.sort();
        let frames = map_in_order(&files, |_, path| frame(path, &json::read(path)?, images))?;
        let listing = Listing::new(root, config, &folder, frames, Split::default())?;
        Ok(Box::new(listing.with_depths(|photograph| DepthFile::of_arkit(root, DEPTHS, photograph))))
    },
    images: Some("raw exports of Polycam"),
    divisible: true,
    camera_files: &[CameraFile { kind: "polycam", file: FILE, cameras, example, memory: 160 }],
};

fn folders(root: &Path) -> Option<[&'static str; 2]> {
    FOLDERS.into_iter().find(|[poses, _]| root.join(poses).is_dir())
}

/// Returns a file with a pose.
fn example() -> Vec<u8> {
    json!({
        "fx": 9.0, "fy": 9.5, "cx": 4.1, "cy": 3.2, "width": 8, "height": 6, "blur_score": 90.0,
        "t_00": 0.8, "t_01": 0.0, "t_02": 0.6, "t_03": 0.25,
        "t_10": 0.0, "t_11": 1.0, "t_12": 0.0, "t_13": 0.5,
        "t_20": -0.6, "t_21": 0.0, "t_22": 0.8, "t_23": 4.0,
    })
    .to_string()
    .into_bytes()
}

fn cameras(name: &str, bytes: &[u8]) -> Result<NamedCameras> {
    let path = Path::new(name);
    let frame = frame(path, &json::parse(path, bytes)?, FOLDERS[1][1])?;
    Ok(vec![(names::stem(&frame.named), frame.camera([8, 6]))])
}

/// Returns the frame of a file; its photograph has the same name in `images`.
fn frame(path: &Path, document: &Value, images: &str) -> Result<Frame> {
    let node = Node::new(path.display(), document)?;
    let number = |key: &str| -> Result<f64> {
        let value = node.required(key)?;
        value.as_f64().ok_or_else(|| node.unexpected(key, "a number", value))
    };
    // World axes x, y, z are ARKit's z, x, y.
    let row = |of: u32| -> Result<[f64; 4]> {
        let entry = |column: u32| number(&format!("t_{of}{column}"));
        Ok([entry(0)?, entry(1)?, entry(2)?, entry(3)?])
    };
    let wrong = |what: String| Error::input(&node.place, format!("its pose {what}"), "export it again");
    let (rotation, origin) = pose::checked([row(2)?, row(0)?, row(1)?]).map_err(wrong)?;
    let size = Size::named(&node, ["width", "height"])?;
    let [fx, fy] = [number("fx")?, number("fy")?];
    if !(fx > 0.0 && fy > 0.0) {
        return Err(Error::input(
            &node.place,
            format!("has the focal lengths {fx} and {fy}"),
            "export it again",
        ));
    }
    let (cx, cy) = (number("cx")?, number("cy")?);
    let lens = Lens::default();
    // Poses that newer versions have corrected state no size, so their lengths are in pixels of the photograph.
    let calibration = match (size.width, size.height) {
        (Some(width), Some(height)) => Calibration::Sized(Intrinsics { width, height, fx, fy, cx, cy, lens }),
        _ => Calibration::Unsized { focal: [fx, fy], centre: Some([cx, cy]), lens },
    };
    let named = format!("{images}/{}", names::stem(&path.file_stem().unwrap_or_default().to_string_lossy()));
    Ok(Frame { named, place: node.place, rotation, origin, calibration, split: None })
}
