//! Cameras of Agisoft Metashape as XML (File, Export, Export Cameras): sensors with their calibrations, and camera-to-chunk
//! matrices with x right, y down and z forward, in the units of the chunk. Principal points are relative to the middle of
//! the photograph, and p1 and p2 are swapped relative to OpenCV (Metashape's manual, appendix on camera models).

use super::reader::{CameraFile, NamedCameras, Reader};
use crate::{
    files,
    listing::{Calibration, Frame, Listing},
    names, pose,
    split::Split,
};
use glam::DMat3;
use roxmltree::{Document, Node, ParsingOptions};
use std::{
    collections::HashMap,
    io::Read,
    path::{Path, PathBuf},
};
use trimip_core::{
    Error, Intrinsics, Lens, Place, Result, geometry::projections::Model, plain_file, plural::count,
    text::decoded,
};

/// The usual name of the file.
const FILE: &str = "cameras.xml";

/// Number of bytes at the beginning of an XML file that are searched for a chunk.
const HEAD: u64 = 4096;

const ADVICE: &str = "export the cameras from Metashape again";

pub(super) static READER: Reader = Reader {
    format: "metashape",
    name: "camera export of Metashape",
    files: Some("cameras.xml"),
    recognises: |root| path(root).is_some(),
    open: |root, config| {
        let path = path(root).unwrap_or_else(|| root.join(FILE));
        let bytes = files::read(&path)?;
        let Export { frames, facts } = Export::read(&path.display().to_string(), &bytes)?;
        Ok(Box::new(Listing::new(root, config, &path, frames, facts)?))
    },
    images: Some("camera exports of Metashape"),
    divisible: true,
    camera_files: &[CameraFile { kind: "metashape", file: FILE, cameras, example, memory: 64 }],
};

/// Returns the first XML file of a folder that holds a chunk of Metashape.
fn path(root: &Path) -> Option<PathBuf> {
    let is_export = |path: &PathBuf| {
        let mut head = Vec::new();
        let read = plain_file::open(path).and_then(|file| file.take(HEAD).read_to_end(&mut head));
        let head = String::from_utf8_lossy(&decoded(&head)).into_owned();
        read.is_ok() && head.contains("<document") && head.contains("<chunk")
    };
    let entries = root.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
    let xml = |path: &PathBuf| path.extension().is_some_and(|end| end.eq_ignore_ascii_case("xml"));
    let mut files: Vec<PathBuf> = entries.filter(xml).collect();
    files.sort();
    files.into_iter().find(is_export)
}

/// Returns a file with a sensor and two cameras.
fn example() -> Vec<u8> {
    let camera = |x: f64| {
        format!(
            "<camera id=\"0\" sensor_id=\"0\" label=\"{x}\"><transform>1 0 0 {x} 0 1 0 0.5 0 0 1 -4 0 0 0 1</transform></camera>"
        )
    };
    let calibration =
        "<resolution width=\"8\" height=\"6\"/><f>9</f><cx>0.1</cx><cy>-0.2</cy><k1>0.01</k1><p1>1e-4</p1>";
    let sensor = format!(
        "<sensor id=\"0\" type=\"frame\"><calibration type=\"frame\" class=\"adjusted\">{calibration}</calibration></sensor>"
    );
    let cameras = [camera(0.0), camera(0.25)].concat();
    format!("<document version=\"2.0.0\"><chunk><sensors>{sensor}</sensors><cameras>{cameras}</cameras></chunk></document>").into_bytes()
}

fn cameras(name: &str, bytes: &[u8]) -> Result<NamedCameras> {
    let frames = Export::read(name, bytes)?.frames;
    Ok(frames.iter().map(|frame| (names::stem(&frame.named), frame.camera([8, 6]))).collect())
}

/// The contents of a file.
struct Export {
    frames: Vec<Frame>,
    /// Warnings about the file.
    facts: Split,
}

impl Export {
    fn read(name: &str, bytes: &[u8]) -> Result<Self> {
        let wrong = |what: String| Error::input(name, what, ADVICE);
        let bytes = decoded(bytes);
        let text = std::str::from_utf8(&bytes)
            .map_err(|error| wrong(format!("is not UTF-8 text (byte {})", error.valid_up_to())))?;
        let document = Document::parse_with_options(text, ParsingOptions::default())
            .map_err(|error| wrong(format!("invalid XML: {error}")))?;
        let chunk = document.root_element().descendants().find(|node| node.has_tag_name("chunk"));
        let chunk = chunk.ok_or_else(|| wrong("has no chunk".into()))?;
        let mut sensors = HashMap::new();
        for sensor in chunk.descendants().filter(|node| node.has_tag_name("sensor")) {
            let id = sensor.attribute("id").unwrap_or_default();
            sensors
                .insert(id, Sensor { place: Place::part(name, format_args!("sensor {id}")), node: sensor });
        }
        let (mut frames, mut unplaced, mut skewed) = (Vec::new(), 0, false);
        let mut calibrations: HashMap<&str, Intrinsics> = HashMap::new();
        for camera in chunk.descendants().filter(|node| node.has_tag_name("camera")) {
            let Some(label) = camera.attribute("label") else { continue };
            let Some(transform) = camera.children().find(|node| node.has_tag_name("transform")) else {
                unplaced += 1;
                continue;
            };
            let place = Place::part(name, format_args!("camera {label}"));
            let wrong = |what: String| Error::input(&place, what, ADVICE);
            let id = camera.attribute("sensor_id").unwrap_or_default();
            let intrinsics = match calibrations.get(id) {
                Some(known) => *known,
                None => {
                    let sensor =
                        sensors.get(id).ok_or_else(|| wrong(format!("has the unknown sensor {id}")))?;
                    skewed |= sensor.term("b2")? != 0.0;
                    let found = sensor.intrinsics()?;
                    calibrations.insert(id, found);
                    found
                }
            };
            let numbers = transform.text().unwrap_or_default().split_ascii_whitespace().map(str::parse);
            let numbers: Option<Vec<f64>> = numbers.map(std::result::Result::ok).collect();
            let numbers = numbers.filter(|numbers| numbers.len() == 16);
            let numbers = numbers.ok_or_else(|| wrong("its transform is not 16 numbers".into()))?;
            let row = |i: usize| [0, 1, 2, 3].map(|j| numbers[4 * i + j]);
            let (axes, origin) = pose::checked([row(0), row(1), row(2)])
                .map_err(|what| wrong(format!("its transform {what}")))?;
            let rotation = DMat3::from_cols(axes.x_axis, -axes.y_axis, -axes.z_axis);
            let calibration = Calibration::Sized(intrinsics);
            frames.push(Frame { named: label.into(), place, rotation, origin, calibration, split: None });
        }
        let all = frames.len() + unplaced;
        let mut warnings = Vec::new();
        if unplaced > 0 {
            warnings.push(format!(
                "{name}: Metashape placed {} of {}",
                frames.len(),
                count(all, "photograph")
            ));
        }
        if skewed {
            warnings.push(format!("{name}: the skew b2 of its sensors is left out"));
        }
        Ok(Self { frames, facts: Split { warnings, ..Split::default() } })
    }
}

/// A sensor of a chunk.
struct Sensor<'a> {
    place: Place,
    node: Node<'a, 'a>,
}

impl Sensor<'_> {
    fn wrong(&self, what: impl std::fmt::Display) -> Error {
        Error::input(&self.place, what, ADVICE)
    }

    /// Returns the adjusted calibration or, if there is none, the first one.
    fn calibration(&self) -> Option<Node<'_, '_>> {
        let all = || self.node.children().filter(|node| node.has_tag_name("calibration"));
        all().find(|node| node.attribute("class") == Some("adjusted")).or_else(|| all().next())
    }

    /// Returns a coefficient, or 0 if it is not stated.
    fn term(&self, key: &str) -> Result<f64> {
        let stated =
            self.calibration().and_then(|node| node.children().find(|child| child.has_tag_name(key)));
        let Some(stated) = stated else { return Ok(0.0) };
        let text = stated.text().unwrap_or_default().trim();
        let value = text.parse().ok().filter(|value: &f64| value.is_finite());
        value.ok_or_else(|| {
            self.wrong(format!(
                "{key} is {:?}, not a finite number",
                text.chars().take(40).collect::<String>()
            ))
        })
    }

    fn intrinsics(&self) -> Result<Intrinsics> {
        let resolution = |of: Node<'_, '_>| {
            let node = of.children().find(|node| node.has_tag_name("resolution"))?;
            let side = |key: &str| node.attribute(key)?.parse().ok().filter(|side: &u32| *side > 0);
            Some([side("width")?, side("height")?])
        };
        let size = self.calibration().and_then(resolution).or_else(|| resolution(self.node));
        let [width, height] = size.ok_or_else(|| self.wrong("has no resolution"))?;
        let radial = [self.term("k1")?, self.term("k2")?, self.term("k3")?, self.term("k4")?];
        let tangential = [self.term("p2")?, self.term("p1")?];
        let kind = self.calibration().and_then(|node| node.attribute("type")).or(self.node.attribute("type"));
        let lens = match kind.unwrap_or("frame") {
            "frame" => Lens::perspective(radial, tangential, [0.0; 3]),
            "fisheye" | "equidistant_fisheye" => Lens::fisheye(radial, tangential, [0.0; 2]),
            "spherical" => Lens::of(Model::Equirectangular),
            other => {
                let what = format!("is of the type {other:?}, which is not read");
                return Err(Error::input(&self.place, what, "calibrate as frame, fisheye or spherical"));
            }
        };
        let usual = lens.model.definition().focal.map(|focal| focal(width.into(), height.into()));
        let focal = match (self.term("f")?, usual) {
            (0.0, Some(usual)) => usual,
            (focal, _) => [focal + self.term("b1")?, focal],
        };
        if !focal.iter().all(|focal| *focal > 0.0) {
            return Err(self.wrong("has no positive focal length f"));
        }
        let [cx, cy] =
            [0.5 * f64::from(width) + self.term("cx")?, 0.5 * f64::from(height) + self.term("cy")?];
        Ok(Intrinsics { width, height, fx: focal[0], fy: focal[1], cx, cy, lens })
    }
}
