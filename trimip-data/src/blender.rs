//! The Blender/NeRF layout, also of Instant-NGP and nerfstudio: `transforms_{split}.json`, or one `transforms.json` with all
//! frames. Frame keys override file keys. Poses and lengths are used as they are written.

use crate::{
    division::{self, Part},
    intrinsics::{Size, intrinsics},
    json::{self, Node},
    names,
    photograph::Photograph,
    pose,
    source::{Pixels, Source, find_image, map_in_order},
    split::Split,
    stated,
};
use serde_json::Value;
use std::path::{Path, PathBuf};
use trimip_core::{Camera, Error, Result};

/// Names of the splits with a file of their own.
pub(crate) fn splits(root: &Path) -> Vec<String> {
    let Ok(entries) = root.read_dir() else { return Vec::new() };
    let mut names: Vec<String> = entries
        .flatten()
        .filter_map(|entry| {
            let name = entry.file_name().into_string().ok()?;
            Some(name.strip_prefix("transforms_")?.strip_suffix(".json")?.to_string())
        })
        .collect();
    names.sort();
    names
}

/// True if a folder has frames of a split.
pub(crate) fn has_split(root: &Path, split: &str) -> Result<bool> {
    let found = splits(root);
    if !found.is_empty() {
        return Ok(found.iter().any(|name| name == split));
    }
    let path = undivided(root);
    let document = json::read(&path)?;
    let lists = division::listed(&Node::new(path.display(), &document)?);
    Ok(lists.is_empty() || lists.contains(&split))
}

/// The file of a folder that holds all frames.
pub(crate) fn undivided(root: &Path) -> PathBuf {
    root.join("transforms.json")
}

/// The frames of `split` with the headers of their images.
pub(crate) fn read(root: &Path, split: &str, scales: u32) -> Result<Split> {
    let found = splits(root);
    if found.iter().any(|name| name == split) {
        return read_file(root, &root.join(format!("transforms_{split}.json")), split, scales, |_, _| {
            Ok(Part::All)
        });
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
    read_file(root, &path, split, scales, |file, entries| division::divide(&path, file, entries, split))
}

/// All frames of the file without splits; `None` if the splits have files of their own.
pub(crate) fn read_all(root: &Path, scales: u32) -> Result<Option<Split>> {
    if !splits(root).is_empty() {
        return Ok(None);
    }
    read_file(root, &undivided(root), "train", scales, |_, _| Ok(Part::All)).map(Some)
}

/// The frames of a file that `divide` chooses.
fn read_file(
    root: &Path,
    path: &Path,
    split: &str,
    scales: u32,
    divide: impl Fn(&Node<'_>, &[Value]) -> Result<Part>,
) -> Result<Split> {
    let document = json::read(path)?;
    let file = Node::new(path.display(), &document)?;
    let entries = file.array("frames")?;
    let part = divide(&file, entries)?;
    let chosen = part.choose(entries.len());
    if chosen.is_empty() {
        return Err(division::empty(path, split, entries.len(), &part));
    }
    let size = Size::of(&file)?;
    let named =
        |entry: &Value| entry.get("file_path").and_then(Value::as_str).unwrap_or_default().to_string();
    let names = names::unique(&entries.iter().map(named).collect::<Vec<_>>());
    let sources = map_in_order(&chosen, |_, &index| {
        let place = match entries[index].get("file_path").and_then(Value::as_str) {
            Some(named) => format!("{}: frame {index} ({named})", path.display()),
            None => format!("{}: frame {index}", path.display()),
        };
        let frame = Node::new(place, &entries[index])?;
        read_frame(root, &file, size, &frame, names[index].clone(), scales)
    })?;
    check_shared_focal(&file, entries, &chosen, &sources, size)?;
    let (stated, cloud) = stated::read(root, &file)?;
    let warnings = part.warning(path, "in file order").into_iter().collect();
    Ok(Split { sources, warnings, notes: applied(&file)?, stated, cloud })
}

/// What nerfstudio did to the original poses before it wrote them: the poses of the file are `applied_scale` ·
/// `applied_transform` · those of the original, and are used as they are.
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

fn read_frame(
    root: &Path,
    file: &Node<'_>,
    stated: Size,
    frame: &Node<'_>,
    name: String,
    scales: u32,
) -> Result<Source> {
    let named = frame.required_text("file_path")?;
    let (rotation, origin) = pose::read(frame, "transform_matrix")?;
    let size = Size::of(frame)?.or(stated);
    let image = Photograph::open(find_image(root, named, &frame.place)?, frame.place.clone())?;
    let image = image.fit(size.width, size.height);
    size.check(&image)?;
    let intrinsics = intrinsics(file, frame, image.width, image.height)?;
    let camera = Camera { intrinsics, rotation, origin };
    let source = Source::averaged(name, camera, scales, &frame.place, Pixels::Photograph(image))?;
    Ok(Source { mask_path: frame.text("mask_path")?.map(str::to_string), ..source })
}

/// A focal length in pixels that is given once for the file is valid for one image size only.
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
