//! The Blender/NeRF layout, which Instant-NGP and nerfstudio also use: `transforms_{split}.json`, or one
//! `transforms.json` with all frames. Frame keys override file keys. Poses and lengths are used as they are written.

use super::reader::{CameraFile, OpenScene, Reader};
use crate::{
    depth_image::DepthFile,
    division::{self, Selection},
    intrinsics::{Fitted, Size, fitted, intrinsics, scaled_along},
    json::{self, Node},
    names,
    photograph::Photograph,
    pictures::{self, Pictures},
    pose,
    settings::DataConfig,
    source::{Pixels, Source, map_in_order},
    split::Split,
    stated_box,
};
use glam::{DMat3, DVec3};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use trimip_core::{Camera, Error, Place, Result};

/// Value of `data.format` for this layout.
pub(crate) const FORMAT: &str = "blender";

pub(super) static READER: Reader = Reader {
    format: FORMAT,
    name: "Blender layout",
    files: Some("transforms_train.json, transforms.json"),
    recognises: |root| undivided(root).is_file() || !splits(root).is_empty(),
    open: |root, config| Ok(Box::new(Folder::open(root, config)?)),
    images: Some("Blender layouts"),
    divisible: true,
    camera_files: &[CameraFile {
        kind: "transforms",
        file: "transforms.json",
        cameras: |name, bytes| cameras(Path::new(name), bytes, [8, 6]),
        example,
        memory: 160,
    }],
};

/// Default for units of poses per unit of a depth image (nerfstudio).
const DEPTH_UNIT: f64 = 1e-3;

/// Returns a file with one frame.
fn example() -> Vec<u8> {
    let pose = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]];
    let frames = json!([{ "file_path": "0.png", "transform_matrix": pose }]);
    json!({ "camera_angle_x": 0.7, "frames": frames }).to_string().into_bytes()
}

/// A folder with transforms files; each file is read when its split is.
struct Folder {
    root: PathBuf,
    pictures: Pictures,
    scales: u32,
}

impl Folder {
    fn open(root: &Path, config: &DataConfig) -> Result<Self> {
        let pictures = Pictures::new(pictures::stated(root, &config.images)?);
        Ok(Self { root: root.into(), pictures, scales: config.scales })
    }
}

impl OpenScene for Folder {
    fn split(&self, split: &str) -> Result<Split> {
        read(self, split)
    }

    fn has_split(&self, split: &str) -> Result<bool> {
        has_split(self, split)
    }

    fn states_splits(&self) -> Result<bool> {
        states_splits(self)
    }

    fn undivided(&self) -> Result<Option<Split>> {
        read_all(self)
    }
}

/// Beginnings of the names of transforms files; some exporters leave out the s.
const PREFIXES: [&str; 2] = ["transforms", "transform"];

/// Returns the names of the splits with a file of their own. Such files next to `transforms.json` count as other
/// versions of that file, unless one of them holds the training frames.
pub(crate) fn splits(root: &Path) -> Vec<String> {
    let Ok(entries) = root.read_dir() else { return Vec::new() };
    let mut names: Vec<String> = entries
        .flatten()
        .filter_map(|entry| {
            let name = entry.file_name().into_string().ok()?;
            let rest = PREFIXES.iter().find_map(|prefix| name.strip_prefix(prefix)?.strip_prefix('_'))?;
            Some(rest.strip_suffix(".json")?.to_string())
        })
        .collect();
    names.sort();
    names.dedup();
    if undivided(root).is_file() && !names.iter().any(|name| name == TRAIN) {
        names.clear();
    }
    names
}

/// The split of the training frames.
const TRAIN: &str = "train";

/// Returns the path of the file of a split.
fn split_file(root: &Path, split: &str) -> PathBuf {
    let [first, other] = PREFIXES.map(|prefix| root.join(format!("{prefix}_{split}.json")));
    if first.is_file() || !other.is_file() { first } else { other }
}

/// Returns true if a folder has frames of a split.
fn has_split(folder: &Folder, split: &str) -> Result<bool> {
    let root = &folder.root;
    let found = splits(root);
    if !found.is_empty() {
        let is_there = found.iter().any(|name| name == split);
        return Ok(is_there && has_photographs(&folder.pictures, &split_file(root, split)));
    }
    let lists = lists(root)?;
    Ok(lists.is_empty() || lists.contains(&split))
}

/// Returns true if splits have files of their own, or the file of all frames lists them.
fn states_splits(folder: &Folder) -> Result<bool> {
    Ok(!splits(&folder.root).is_empty() || !lists(&folder.root)?.is_empty())
}

/// Returns the splits that the file of all frames lists.
fn lists(root: &Path) -> Result<Vec<&'static str>> {
    let path = undivided(root);
    let document = json::read(&path)?;
    Ok(division::listed(&Node::new(path.display(), &document)?))
}

/// Returns false if no photograph of a file exists: BlenderNeRF writes the cameras of test frames that it does not
/// render. Errors in the file are reported when it is read.
fn has_photographs(pictures: &Pictures, path: &Path) -> bool {
    let Ok(document) = json::read(path) else { return true };
    let Some(entries) = document.get("frames").and_then(Value::as_array) else { return true };
    let named: Vec<&str> = entries.iter().filter_map(named).collect();
    named.is_empty() || named.iter().any(|named| pictures.find(named, &path.into()).is_ok())
}

/// Returns the path of the file that holds all frames of a folder.
pub(crate) fn undivided(root: &Path) -> PathBuf {
    let [first, other] = PREFIXES.map(|prefix| root.join(format!("{prefix}.json")));
    if first.is_file() || !other.is_file() { first } else { other }
}

/// Reads the frames of `split` and the headers of their images.
fn read(folder: &Folder, split: &str) -> Result<Split> {
    let root = &folder.root;
    let found = splits(root);
    if found.iter().any(|name| name == split) {
        return read_file(folder, &split_file(root, split), split, |_, _| Ok(Selection::All));
    }
    if !found.is_empty() {
        return Err(division::unknown(root, split, &found.join(", ")));
    }
    let path = undivided(root);
    if !path.is_file() {
        return Err(Error::input(
            root.display(),
            format!("holds neither transforms_{split}.json nor transforms.json"),
            "set data.root to the folder of a Blender-layout scene",
        ));
    }
    read_file(folder, &path, split, |file, entries| division::divide(&path, file, entries, split))
}

/// Reads all frames of the file without splits. Returns `None` if the splits have files of their own.
fn read_all(folder: &Folder) -> Result<Option<Split>> {
    if !splits(&folder.root).is_empty() {
        return Ok(None);
    }
    read_file(folder, &undivided(&folder.root), "train", |_, _| Ok(Selection::All)).map(Some)
}

/// Reads the frames of a file that `divide` chooses.
fn read_file(
    folder: &Folder,
    path: &Path,
    split: &str,
    divide: impl Fn(&Node<'_>, &[Value]) -> Result<Selection>,
) -> Result<Split> {
    let document = json::read(path)?;
    let transforms = Transforms::new(path, &document)?;
    let Transforms { file, entries, size, names, .. } = &transforms;
    let selection = divide(file, entries)?;
    let chosen = selection.choose(entries.len());
    if chosen.is_empty() {
        return Err(division::empty(path, split, entries.len(), &selection));
    }
    let chosen: Vec<(usize, Entry<'_>)> =
        chosen.into_iter().map(|index| Ok((index, transforms.entry(index)?))).collect::<Result<_>>()?;
    let named = chosen.iter().map(|(_, entry)| (entry.named, entry.frame.place.clone()));
    let (paths, moved) = pictures::of_entries(&folder.pictures, path, named)?;
    let frames: Vec<_> = chosen.iter().zip(paths).collect();
    let root = &folder.root;
    let found = map_in_order(&frames, |_, ((index, entry), path)| {
        let place = &entry.frame.place;
        let image = Photograph::open(path.clone(), place.clone())?;
        let (image, camera, factors) = entry.seen_by(file, image)?;
        let pixels = Pixels::Photograph(image);
        let source = Source::averaged(names[*index].clone(), camera, folder.scales, place, pixels)?;
        let depth = entry.depth.as_ref().map(|depth| depth.below(root));
        Ok((Source { mask_path: entry.mask_path.map(str::to_string), depth, ..source }, factors))
    })?;
    let (sources, factors): (Vec<Source>, Vec<[f64; 2]>) = found.into_iter().unzip();
    let chosen: Vec<usize> = chosen.into_iter().map(|(index, _)| index).collect();
    check_shared_focal(file, entries, &chosen, &sources, *size)?;
    let facts = stated_box::read(&folder.root, file)?;
    let warnings = selection.warning(path).into_iter().chain(moved);
    let warnings = warnings.chain(scaled_along(path, factors)).chain(facts.warnings).collect();
    let notes = selection.note(path, "in file order").into_iter().chain(applied(file)?).collect();
    Ok(Split { sources, warnings, notes, ..facts })
}

/// Returns the names and cameras of all frames of a transforms file. Photographs without a stated size have `size`.
/// Checks everything that needs no photograph.
pub(crate) fn cameras(path: &Path, bytes: &[u8], size: [u32; 2]) -> Result<Vec<(String, Camera)>> {
    let document = json::parse(path, bytes)?;
    let transforms = Transforms::new(path, &document)?;
    let file = &transforms.file;
    for split in division::listed(file) {
        division::divide(path, file, transforms.entries, split)?;
    }
    applied(file)?;
    stated_box::cube(file)?;
    let camera = |index: usize| {
        let entry = transforms.entry(index)?;
        let (width, height) = (entry.size.width.unwrap_or(size[0]), entry.size.height.unwrap_or(size[1]));
        Ok((transforms.names[index].clone(), entry.camera(file, width, height)?))
    };
    (0..transforms.entries.len()).map(camera).collect()
}

/// A transforms file without its photographs.
struct Transforms<'a> {
    path: &'a Path,
    file: Node<'a>,
    entries: &'a [Value],
    /// The size that the file states for all photographs.
    size: Size,
    /// Short names of the frames.
    names: Vec<String>,
}

impl<'a> Transforms<'a> {
    fn new(path: &'a Path, document: &'a Value) -> Result<Self> {
        let file = Node::new(path.display(), document)?;
        let entries = file.array("frames")?;
        let size = Size::of(&file)?;
        let named: Vec<&str> = entries.iter().map(|entry| named(entry).unwrap_or_default()).collect();
        Ok(Self { path, file, entries, size, names: names::unique(&named) })
    }

    fn entry(&self, index: usize) -> Result<Entry<'a>> {
        let entry = &self.entries[index];
        let place = match named(entry) {
            Some(named) => Place::part(self.path, format_args!("frame {index} ({named})")),
            None => Place::part(self.path, format_args!("frame {index}")),
        };
        let frame = Node::new(place, entry)?;
        Ok(Entry {
            named: frame.required_text("file_path")?,
            pose: pose::read(&frame, "transform_matrix")?,
            size: Size::of(&frame)?.or(self.size),
            mask_path: frame.text("mask_path")?,
            depth: depth(&self.file, &frame)?,
            frame,
        })
    }
}

/// Returns the path that an entry states for its photograph.
fn named(entry: &Value) -> Option<&str> {
    entry.get("file_path").and_then(Value::as_str)
}

/// A frame without its photograph.
struct Entry<'a> {
    frame: Node<'a>,
    named: &'a str,
    pose: (DMat3, DVec3),
    size: Size,
    mask_path: Option<&'a str>,
    depth: Option<DepthFile>,
}

impl Entry<'_> {
    /// Returns the camera for a photograph of `width` × `height` pixels.
    fn camera(&self, file: &Node<'_>, width: u32, height: u32) -> Result<Camera> {
        let (rotation, origin) = self.pose;
        Ok(Camera { intrinsics: intrinsics(file, &self.frame, width, height)?, rotation, origin })
    }

    /// Returns the photograph, turned as its camera sees it; the camera at the size of the photograph; and the factors
    /// from the stated size to this size.
    fn seen_by(&self, file: &Node<'_>, image: Photograph) -> Result<(Photograph, Camera, [f64; 2])> {
        if let (Some(width), Some(height)) = (self.size.width, self.size.height) {
            let stated = self.camera(file, width, height)?;
            let Fitted { image, intrinsics, factors } = fitted(image, stated.intrinsics)?;
            return Ok((image, Camera { intrinsics, ..stated }, factors));
        }
        let image = image.fit(self.size.width, self.size.height);
        self.size.check(&image)?;
        let camera = self.camera(file, image.width, image.height)?;
        Ok((image, camera, [1.0; 2]))
    }
}

/// Returns the depth image that a frame states. Its unit is `depth_unit_scale_factor` units of the original poses
/// (nerfstudio's default is a thousandth). The poses of the file are `applied_scale` times the original ones.
fn depth(file: &Node<'_>, frame: &Node<'_>) -> Result<Option<DepthFile>> {
    let Some(path) = frame.text("depth_file_path")? else { return Ok(None) };
    let key = "depth_unit_scale_factor";
    let of_file = file.number(key)?;
    let factor = frame.number(key)?.or(of_file).unwrap_or(DEPTH_UNIT);
    if !(factor.is_finite() && factor > 0.0) {
        let what = format!("\"{key}\" is {factor}");
        return Err(Error::input(&frame.place, what, "expected a number above 0, or no such key"));
    }
    Ok(Some(DepthFile::new(path, factor * file.number("applied_scale")?.unwrap_or(1.0))))
}

/// Checks and describes the transform that nerfstudio applied to the original poses. The poses of the file are
/// `applied_scale` · `applied_transform` · the original ones; they are used as they are.
fn applied(file: &Node<'_>) -> Result<Vec<String>> {
    if file.get("applied_transform").is_some() {
        pose::read(file, "applied_transform")?;
    }
    let Some(scale) = file.number("applied_scale")? else { return Ok(Vec::new()) };
    if !(scale.is_finite() && scale > 0.0) {
        return Err(Error::input(
            &file.place,
            format!("\"applied_scale\" is {scale}"),
            "expected a number above 0, or no such key",
        ));
    }
    Ok(vec![format!(
        "lengths of {} are {scale} times those of the original poses (applied_scale)",
        file.place
    )])
}

/// Refuses images of different sizes if the file states one focal length in pixels for all of them: it is valid for one size only.
fn check_shared_focal(
    file: &Node<'_>,
    entries: &[Value],
    chosen: &[usize],
    sources: &[Source],
    stated: Size,
) -> Result<()> {
    if file.get("fl_x").is_none() || stated.width.is_some() {
        return Ok(());
    }
    let own = |index: usize| ["fl_x", "camera_angle_x"].iter().any(|key| entries[index].get(key).is_some());
    let mut shared =
        chosen.iter().zip(sources).filter(|(index, _)| !own(**index)).flat_map(|(_, source)| source.files());
    let Some(first) = shared.next() else { return Ok(()) };
    let expected = Size { width: Some(first.width), height: Some(first.height) };
    shared.try_for_each(|image| expected.check(image))
}
