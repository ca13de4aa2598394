//! OpenSfM's `reconstruction.json`, which OpenDroneMap also writes: an array of reconstructions with cameras, shots and points. Poses are
//! world-to-camera, a rotation axis times an angle and a translation, with x right, y down and z forward. Focal lengths and principal
//! points are multiples of the longer side; principal points are relative to the middle of the photograph (OpenSfM, Geometric Models).

use super::reader::{CameraFile, NamedCameras, Reader};
use crate::{
    files,
    json::{self, Node},
    listing::{Calibration, Frame, Listing, vision_pose},
    names,
    points::{Cloud, Point},
    pose,
    split::Split,
};
use glam::DVec3;
use serde_json::{Value, json};
use std::{
    collections::HashMap,
    path::{Path, PathBuf},
};
use trimip_core::{Error, Intrinsics, Lens, Place, Result, geometry::projections::Model, plural::count};

const FILE: &str = "reconstruction.json";

/// Usual paths of the file: OpenDroneMap stores it in a folder of its own.
const PLACES: [&str; 3] = [FILE, "opensfm/reconstruction.json", "undistorted/reconstruction.json"];

pub(super) static READER: Reader = Reader {
    format: "opensfm",
    name: "OpenSfM reconstruction",
    files: Some("reconstruction.json"),
    recognises: |root| path(root).is_some(),
    open: |root, config| {
        let path = path(root).unwrap_or_else(|| root.join(FILE));
        let best = Reconstruction::read(&path, &json::read(&path)?)?;
        Ok(Box::new(Listing::new(root, config, &path, best.frames, best.facts)?))
    },
    images: Some("OpenSfM reconstructions"),
    divisible: true,
    camera_files: &[CameraFile { kind: "opensfm", file: FILE, cameras, example, memory: 160 }],
};

fn path(root: &Path) -> Option<PathBuf> {
    files::first(root, &PLACES)
}

/// Returns a file with a camera and two shots.
fn example() -> Vec<u8> {
    let camera = json!({ "projection_type": "perspective", "width": 8, "height": 6, "focal": 0.9, "k1": 0.01, "k2": -0.002 });
    let shot = |x: f64| json!({ "rotation": [0.1, x, 0.3], "translation": [x, 0.5, 4.0], "camera": "phone" });
    let points = json!({ "7": { "coordinates": [0.1, 0.2, 0.3], "color": [9.0, 99.0, 199.0] } });
    let one = json!({ "cameras": { "phone": camera }, "shots": { "0.jpg": shot(0.0), "1.jpg": shot(0.2) }, "points": points });
    json!([one]).to_string().into_bytes()
}

fn cameras(name: &str, bytes: &[u8]) -> Result<NamedCameras> {
    let path = Path::new(name);
    let frames = Reconstruction::read(path, &json::parse(path, bytes)?)?.frames;
    Ok(frames.iter().map(|frame| (names::stem(&frame.named), frame.camera([8, 6]))).collect())
}

/// A reconstruction.
struct Reconstruction {
    frames: Vec<Frame>,
    /// Points and warnings of the file.
    facts: Split,
}

impl Reconstruction {
    /// Reads the reconstruction with the most shots.
    fn read(path: &Path, document: &Value) -> Result<Self> {
        let all = document.as_array().map(Vec::as_slice).unwrap_or_default();
        let shots =
            |value: &Value| value.get("shots").and_then(Value::as_object).map_or(0, serde_json::Map::len);
        // Among reconstructions with equally many shots, the first is taken.
        let Some((index, best)) = all.iter().enumerate().rev().max_by_key(|(_, value)| shots(value)) else {
            let advice = "expected an array of reconstructions, as OpenSfM writes it";
            return Err(Error::input(path.display(), "holds no reconstruction", advice));
        };
        let place =
            |part: std::fmt::Arguments<'_>| Place::part(path, format_args!("reconstruction {index}{part}"));
        let node = Node::new(place(format_args!("")), best)?;
        let calibrations: HashMap<&str, Intrinsics> = entries(&node, "cameras")?
            .into_iter()
            .map(|(name, value)| {
                let camera = Node::new(place(format_args!(": camera {name}")), value)?;
                Ok((name, intrinsics(&camera)?))
            })
            .collect::<Result<_>>()?;
        let frame = |(name, value): (&str, &Value)| {
            let shot = Node::new(place(format_args!(": shot {name}")), value)?;
            let camera = shot.required_text("camera")?;
            let calibration = *calibrations.get(camera).ok_or_else(|| {
                Error::input(
                    &shot.place,
                    format!("has the unknown camera {camera}"),
                    "export the reconstruction again",
                )
            })?;
            let (axis, translation) = (vector(&shot, "rotation")?, vector(&shot, "translation")?);
            let (rotation, origin) = vision_pose(pose::around(axis), translation);
            if !(rotation.is_finite() && origin.is_finite()) {
                return Err(Error::input(
                    &shot.place,
                    "has a pose that is not finite",
                    "export the reconstruction again",
                ));
            }
            let calibration = Calibration::Sized(calibration);
            Ok(Frame { named: name.into(), place: shot.place, rotation, origin, calibration, split: None })
        };
        let frames = entries(&node, "shots")?.into_iter().map(frame).collect::<Result<_>>()?;
        let points = match node.get("points") {
            None => Vec::new(),
            Some(_) => entries(&node, "points")?
                .into_iter()
                .map(|(name, value)| point(&Node::new(place(format_args!(": point {name}")), value)?))
                .collect::<Result<_>>()?,
        };
        let warnings = (all.len() > 1)
            .then(|| {
                let kept = count(shots(best), "shot");
                format!(
                    "{} holds {} reconstructions: the one with the most shots is read ({kept})",
                    path.display(),
                    all.len()
                )
            })
            .into_iter()
            .collect();
        Ok(Self {
            frames,
            facts: Split { cloud: Cloud { points, ..Cloud::default() }, warnings, ..Split::default() },
        })
    }
}

/// Returns the entries of an object under a key.
fn entries<'a>(node: &Node<'a>, key: &str) -> Result<Vec<(&'a str, &'a Value)>> {
    let value = node.required(key)?;
    let object = value.as_object().ok_or_else(|| node.unexpected(key, "an object", value))?;
    Ok(object.iter().map(|(name, value)| (name.as_str(), value)).collect())
}

/// Reads three finite numbers.
fn vector(node: &Node<'_>, key: &str) -> Result<DVec3> {
    let value = node.required(key)?;
    let numbers = value.as_array().filter(|numbers| numbers.len() == 3);
    let numbers = numbers.and_then(|numbers| numbers.iter().map(Value::as_f64).collect::<Option<Vec<f64>>>());
    let numbers = numbers.ok_or_else(|| node.unexpected(key, "three numbers", value))?;
    Ok(DVec3::new(numbers[0], numbers[1], numbers[2]))
}

fn point(node: &Node<'_>) -> Result<Point> {
    let position = vector(node, "coordinates")?.to_array();
    let color = match node.get("color") {
        Some(_) => vector(node, "color")?.to_array().map(|channel| channel.clamp(0.0, 255.0) as u8),
        None => [0; 3],
    };
    Ok(Point { position, color, error: None, seen: None, track: Vec::new() })
}

fn intrinsics(node: &Node<'_>) -> Result<Intrinsics> {
    let side = |key: &str| -> Result<u32> {
        let value = node.required(key)?;
        let side =
            value.as_f64().filter(|side| *side >= 1.0 && *side <= f64::from(u32::MAX) && side.fract() == 0.0);
        side.map(|side| side as u32).ok_or_else(|| node.unexpected(key, "a whole number of pixels", value))
    };
    let (width, height) = (side("width")?, side("height")?);
    let longer = f64::from(width.max(height));
    let term = |key: &str| Ok(node.number(key)?.unwrap_or(0.0));
    let kind = node.required_text("projection_type")?;
    let radial = [term("k1")?, term("k2")?, term("k3")?, term("k4")?];
    let tangential = [term("p1")?, term("p2")?];
    let lens = match kind {
        "perspective" | "brown" | "simple_radial" | "radial" => {
            Lens::perspective(radial, tangential, [0.0; 3])
        }
        "fisheye" | "fisheye_opencv" => Lens::fisheye(radial, [0.0; 2], [0.0; 2]),
        "spherical" | "equirectangular" => Lens::of(Model::Equirectangular),
        other => {
            let what = format!("has the projection_type {other:?}, which is not read");
            return Err(Error::input(
                &node.place,
                what,
                "calibrate with perspective, brown, fisheye or spherical cameras",
            ));
        }
    };
    let usual = lens.model.definition().focal.map(|focal| focal(width.into(), height.into()));
    let focal = |key: &str, axis: usize| -> Result<f64> {
        let stated = node.number(key)?.or(node.number("focal")?).map(|focal| focal * longer);
        let found = stated.or(usual.map(|usual| usual[axis])).unwrap_or(0.0);
        if found > 0.0 && found.is_finite() {
            return Ok(found);
        }
        Err(Error::input(&node.place, "has no positive focal length", "export the reconstruction again"))
    };
    let centre = |key: &str, side: u32| Ok(0.5 * f64::from(side) + longer * term(key)?);
    let (fx, fy) = (focal("focal_x", 0)?, focal("focal_y", 1)?);
    Ok(Intrinsics { width, height, fx, fy, cx: centre("c_x", width)?, cy: centre("c_y", height)?, lens })
}
