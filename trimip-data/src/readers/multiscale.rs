//! The public multi-scale layout: `metadata.json` with, per split, the arrays file_path, cam2world, width, height,
//! focal, lossmult (4^level) and optionally pix2cam. Each view has an image file; nothing is averaged.

use super::{
    reader::{CameraFile, OpenScene, Reader},
    record3d,
};
use crate::{
    json::{self, Node},
    lens,
    names::stem,
    photograph::Photograph,
    pictures::Pictures,
    pose,
    settings::DataConfig,
    source::{Pixels, Source, map_in_order},
    split::Split,
};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use trimip_core::{Camera, Error, Intrinsics, Place, Result, config::Convention};

pub(super) static READER: Reader = Reader {
    format: "multiscale",
    name: "multi-scale set",
    files: Some(METADATA),
    recognises: |root| {
        let path = root.join(METADATA);
        path.is_file() && !record3d::is_capture(&path)
    },
    open: |root, config| Ok(Box::new(Metadata::open(root, config)?)),
    camera_files: &[CameraFile {
        kind: "metadata",
        file: METADATA,
        cameras: |name, bytes| cameras(Path::new(name), bytes),
        example,
        memory: 160,
    }],
    ..Reader::PLAIN
};

/// Returns a file with one frame at one scale.
fn example() -> Vec<u8> {
    let pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]];
    let train = json!({
        "file_path": ["0.png"], "cam2world": [pose], "width": [8], "height": [6], "focal": [9.0], "lossmult": [1],
    });
    json!({ "train": train }).to_string().into_bytes()
}

/// Name of the file that describes a multi-scale set.
pub(crate) const METADATA: &str = "metadata.json";
/// The public set stores pix2cam in f32: its values are accurate to about a thousandth of a pixel.
const PIXEL_TOLERANCE: f64 = 1e-3;

/// The parsed file.
struct Metadata {
    root: PathBuf,
    path: PathBuf,
    document: Value,
    scales: u32,
}

impl Metadata {
    fn open(root: &Path, config: &DataConfig) -> Result<Self> {
        if config.convention == Convention::Premultiplied {
            return Err(Error::input(
                "data.convention",
                "\"premultiplied\" is not possible for a multi-scale set, whose levels are straight means",
                "set it to \"public\", or data.root to the scene the set was made from",
            ));
        }
        let path = root.join(METADATA);
        if !path.is_file() {
            return Err(Error::input(
                root.display(),
                format!("holds no {METADATA}"),
                "set data.root to the folder of a multi-scale set, or data.format to \"auto\"",
            ));
        }
        Ok(Self { root: root.into(), document: json::read(&path)?, path, scales: config.scales })
    }
}

impl OpenScene for Metadata {
    /// Returns the frames of `split` at the first `scales` scales.
    fn split(&self, split: &str) -> Result<Split> {
        let scales = self.scales;
        let file = Node::new(self.path.display(), &self.document)?;
        let Some(value) = file.get(split) else {
            let known: Vec<&str> = file.keys().collect();
            return Err(Error::input(
                &file.place,
                format!("has no split \"{split}\", only {}", known.join(", ")),
                "choose one of them for data.train and data.test",
            ));
        };
        let table = Table::new(Node::new(Place::part(&self.path, split), value)?)?;
        let indices: Vec<usize> = (0..table.paths.len()).collect();
        let levels = map_in_order(&indices, |_, &index| table.level(index))?;
        let wanted: Vec<usize> = indices.into_iter().filter(|&index| levels[index] < scales).collect();
        if wanted.is_empty() {
            return Err(Error::input(
                &table.node.place,
                format!("none of its {} images is at the first {scales} scales", levels.len()),
                "raise data.scales or export the set again",
            ));
        }
        let pictures = Pictures::new(&self.root);
        let entries = map_in_order(&wanted, |_, &index| Ok((levels[index], table.entry(&pictures, index)?)))?;
        let sources = frames(&table.node.place, entries)?;
        let found = sources.first().map_or(0, |source| source.views.len());
        let warnings = (found < scales as usize).then(|| {
            format!(
                "{} has images of {found} of the {scales} scales that data.scales asks for",
                table.node.place
            )
        });
        Ok(Split { sources, warnings: warnings.into_iter().collect(), ..Split::default() })
    }
}

/// Returns the names and cameras of all entries of a file, split by split. Checks everything that needs no photograph.
pub(crate) fn cameras(path: &Path, bytes: &[u8]) -> Result<Vec<(String, Camera)>> {
    let document = json::parse(path, bytes)?;
    let file = Node::new(path.display(), &document)?;
    let mut cameras = Vec::new();
    for split in file.keys() {
        let Some(value) = file.get(split) else { continue };
        let table = Table::new(Node::new(Place::part(path, split), value)?)?;
        for index in 0..table.paths.len() {
            table.level(index)?;
            cameras.push((stem(table.named(index)?), table.camera(index)?));
        }
    }
    Ok(cameras)
}

/// One view of one frame.
struct Entry {
    name: String,
    camera: Camera,
    image: Photograph,
}

/// The arrays of a split, all of the same length.
struct Table<'a> {
    node: Node<'a>,
    paths: &'a [Value],
}

impl<'a> Table<'a> {
    fn new(node: Node<'a>) -> Result<Self> {
        let paths = node.array("file_path")?;
        let required = ["cam2world", "width", "height", "focal", "lossmult"];
        let optional = ["pix2cam", "fl_y", "cx", "cy"].into_iter().filter(|key| node.get(key).is_some());
        for key in required.into_iter().chain(optional) {
            let length = node.array(key)?.len();
            if length != paths.len() {
                return Err(Error::input(
                    &node.place,
                    format!("\"{key}\" has {length} entries, but \"file_path\" has {}", paths.len()),
                    "export the set again",
                ));
            }
        }
        Ok(Self { node, paths })
    }

    /// Returns the place of an entry, for errors.
    fn place(&self, index: usize) -> Place {
        let part = format!("entry {index} ({})", self.paths[index].as_str().unwrap_or("no path"));
        self.node.place.within(part)
    }

    /// Returns a number of an entry.
    fn value(&self, key: &str, index: usize) -> Result<f64> {
        self.number(key, index, "a number", |_| true)
    }

    /// Returns a positive number of an entry.
    fn positive(&self, key: &str, index: usize) -> Result<f64> {
        self.number(key, index, "a number above 0", |value| value > 0.0)
    }

    fn number(&self, key: &str, index: usize, expected: &str, fits: fn(f64) -> bool) -> Result<f64> {
        let value = &self.node.array(key)?[index];
        value.as_f64().filter(|value| fits(*value)).ok_or_else(|| {
            Error::input(
                self.place(index),
                format!("\"{key}\" is {}", short(value)),
                format!("expected {expected}: export the set again"),
            )
        })
    }

    /// Returns the level j of an entry whose lossmult is 4^j.
    fn level(&self, index: usize) -> Result<u32> {
        let weight = self.positive("lossmult", index)?;
        (0..16).find(|&level| weight == f64::from(4_u32.pow(level))).ok_or_else(|| {
            Error::input(self.place(index), format!("\"lossmult\" is {weight}"), "expected 1, 4, 16, 64, ..")
        })
    }

    fn entry(&self, pictures: &Pictures, index: usize) -> Result<Entry> {
        let (named, place) = (self.named(index)?, self.place(index));
        let image = Photograph::open(pictures.find(named, &place)?.path, place)?;
        let [width, height] = self.size(index)?;
        if (width, height) != (image.width, image.height) {
            return Err(Error::input(
                &image.place,
                format!(
                    "image {} is {}x{} pixels, but the file states {width}x{height}",
                    image.path.display(),
                    image.width,
                    image.height
                ),
                "export the set again",
            ));
        }
        Ok(Entry { name: stem(named), camera: self.camera(index)?, image })
    }

    /// Returns the path of the photograph of an entry.
    fn named(&self, index: usize) -> Result<&'a str> {
        let value = &self.paths[index];
        value.as_str().ok_or_else(|| {
            let what = format!("\"file_path\" is {}", short(value));
            Error::input(self.place(index), what, "expected a text: export the set again")
        })
    }

    /// Returns the width and height of an entry.
    fn size(&self, index: usize) -> Result<[u32; 2]> {
        let whole = |value: f64| value >= 1.0 && value <= f64::from(u32::MAX) && value.fract() == 0.0;
        let side = |key| self.number(key, index, "a whole number above 0", whole).map(|side| side as u32);
        Ok([side("width")?, side("height")?])
    }

    fn camera(&self, index: usize) -> Result<Camera> {
        let matrix = &self.node.array("cam2world")?[index];
        let (rotation, origin) = pose::parse(&self.place(index), "cam2world", matrix)?;
        Ok(Camera { intrinsics: self.intrinsics(index)?, rotation, origin })
    }

    fn intrinsics(&self, index: usize) -> Result<Intrinsics> {
        let fx = self.positive("focal", index)?;
        let [width, height] = self.size(index)?;
        let mut k = Intrinsics {
            width,
            height,
            fx,
            fy: fx,
            cx: 0.5 * f64::from(width),
            cy: 0.5 * f64::from(height),
            ..Intrinsics::default()
        };
        if self.node.get("pix2cam").is_some() {
            let value = &self.node.array("pix2cam")?[index];
            let wrong = |what: String| {
                Error::input(self.place(index), format!("\"pix2cam\" {what}"), "export the set again")
            };
            let rows = pose::matrix(value)
                .filter(|rows| rows.len() == 3 && rows.iter().all(|row| row.len() == 3))
                .ok_or_else(|| wrong("is not a 3x3 matrix of numbers".into()))?;
            // [[1/fx, 0, −cx/fx], [0, −1/fy, cy/fy], [0, 0, −1]]
            let found =
                [1.0 / rows[0][0], -1.0 / rows[1][1], -rows[0][2] / rows[0][0], -rows[1][2] / rows[1][1]];
            if !found.iter().all(|value| value.is_finite()) || found[1] <= 0.0 {
                return Err(wrong("is not the inverse of a pinhole projection".into()));
            }
            if (found[0] - fx).abs() > PIXEL_TOLERANCE * fx {
                return Err(wrong(format!("has the focal length {:.2}, but \"focal\" is {fx:.2}", found[0])));
            }
            // pix2cam is used only where it differs from `focal` and the size by more than rounding.
            let differing = |plain: f64, found: f64| {
                if (found - plain).abs() > PIXEL_TOLERANCE { found } else { plain }
            };
            k = Intrinsics {
                fy: differing(k.fy, found[1]),
                cx: differing(k.cx, found[2]),
                cy: differing(k.cy, found[3]),
                ..k
            };
        }
        // For cameras that are not plain, the writer adds these keys to pix2cam, because inverting pix2cam rounds.
        let length = if self.node.get("fl_y").is_none() { k.fy } else { self.positive("fl_y", index)? };
        // After a crop the principal point may lie outside the image.
        let point = |key: &str, otherwise: f64| -> Result<f64> {
            if self.node.get(key).is_none() { Ok(otherwise) } else { self.value(key, index) }
        };
        let lens = lens::of_column(&self.place(index), &self.node, index)?;
        Ok(Intrinsics { fy: length, cx: point("cx", k.cx)?, cy: point("cy", k.cy)?, lens, ..k })
    }
}

/// Groups entries into frames: entry k of every scale belongs to frame k.
fn frames(place: &Place, entries: Vec<(u32, Entry)>) -> Result<Vec<Source>> {
    let mut levels: Vec<u32> = entries.iter().map(|(level, _)| *level).collect();
    levels.sort_unstable();
    levels.dedup();
    let count = |level: u32| entries.iter().filter(|(at, _)| *at == level).count();
    let counts: Vec<usize> = levels.iter().map(|&level| count(level)).collect();
    if counts.iter().any(|count| *count != counts[0]) {
        return Err(Error::input(
            place,
            format!("its scales have different numbers of images: {counts:?}"),
            "expected every frame at every scale: export the set again",
        ));
    }
    let mut sources: Vec<Source> = Vec::new();
    let mut next = vec![0; levels.len()];
    let mut sorted = entries;
    sorted.sort_by_key(|(level, _)| *level);
    for (level, Entry { name, camera, image }) in sorted {
        let frame = &mut next[levels.partition_point(|at| *at < level)];
        let index = *frame;
        *frame += 1;
        let Some(source) = sources.get_mut(index) else {
            let name = name.strip_suffix(&format!("_d{level}")).unwrap_or(&name).to_string();
            sources.push(Source {
                name,
                views: vec![(level, camera)],
                halvings: 0,
                mask: None,
                mask_path: None,
                depth: None,
                pixels: Pixels::Stored(vec![image]),
            });
            continue;
        };
        let first = source.views[0].1;
        if (first.rotation, first.origin) != (camera.rotation, camera.origin) {
            return Err(Error::input(
                &image.place,
                format!(
                    "has another pose than frame {} at the same position of the finest scale",
                    source.name
                ),
                "list the frames of every scale in the same order",
            ));
        }
        source.views.push((level, camera));
        if let Pixels::Stored(files) = &mut source.pixels {
            files.push(image);
        }
    }
    Ok(sources)
}

/// Formats a value for a message, shortened if it is long.
fn short(value: &Value) -> String {
    let text = value.to_string();
    if text.chars().count() <= 40 { text } else { text.chars().take(40).collect::<String>() + ".." }
}
