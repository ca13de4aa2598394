//! The Blender/NeRF layout: `transforms_{split}.json`, or one `transforms.json` of which every 8th frame in file order
//! is the test split. Frame keys override file keys; without `fl_x` the focal length follows from `camera_angle_x`.

use crate::{
    json::{self, Node},
    lens,
    photograph::Photograph,
    pose,
    source::{Pixels, Source, find_image, map_in_order, stem},
    stated,
};
use std::path::{Path, PathBuf};
use trimip_core::{Camera, Error, Intrinsics, Result, scene_plan::StatedBox};

/// Every n-th frame of a file without splits is a test frame, as in mip-NeRF 360 and Instant-NGP.
pub(crate) const HOLD_OUT: usize = 8;

/// The frames of a split, with warnings about them.
pub(crate) struct Split {
    pub(crate) sources: Vec<Source>,
    pub(crate) warnings: Vec<String>,
    /// The bounding box that the file states.
    pub(crate) stated: Option<StatedBox>,
}

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
pub(crate) fn has_split(root: &Path, split: &str) -> bool {
    let found = splits(root);
    if found.is_empty() { undivided(root).is_file() } else { found.iter().any(|name| name == split) }
}

/// The file of a folder that holds all frames.
pub(crate) fn undivided(root: &Path) -> PathBuf {
    root.join("transforms.json")
}

/// The frames of a file that belong to a split.
#[derive(Clone, Copy, PartialEq)]
enum Part {
    All,
    Train,
    Test,
}

/// Reads the frames of `split` with the headers of their images.
pub(crate) fn read(root: &Path, split: &str, scales: u32) -> Result<Split> {
    let (path, part) = locate(root, split)?;
    let document = json::read(&path)?;
    let file = Node::new(path.display(), &document)?;
    let entries = file.array("frames")?;
    let chosen: Vec<usize> = (0..entries.len())
        .filter(|index| match part {
            Part::All => true,
            Part::Test => index.is_multiple_of(HOLD_OUT),
            Part::Train => !index.is_multiple_of(HOLD_OUT),
        })
        .collect();
    if chosen.is_empty() {
        return Err(Error::input(
            path.display(),
            format!("has no frame for split \"{split}\" among its {}", entries.len()),
            if part == Part::All { "export the frames again" } else { "at least two frames are needed" },
        ));
    }
    let size = Size::of(&file)?;
    let sources = map_in_order(&chosen, |_, &index| {
        let place = match entries[index].get("file_path").and_then(|named| named.as_str()) {
            Some(named) => format!("{}: frame {index} ({named})", path.display()),
            None => format!("{}: frame {index}", path.display()),
        };
        read_frame(root, &file, size, &Node::new(place, &entries[index])?, scales)
    })?;
    check_shared_focal(&file, entries, &chosen, &sources, size)?;

    let mut warnings = Vec::new();
    if part != Part::All {
        warnings.push(format!(
            "{} names no splits: every {HOLD_OUT}th frame in file order is the test split, the others are train",
            path.display()
        ));
    }
    let stated = stated::read(root, &file)?;
    Ok(Split { sources, warnings, stated })
}

/// The file that holds a split.
fn locate(root: &Path, split: &str) -> Result<(PathBuf, Part)> {
    let found = splits(root);
    let undivided = undivided(root);
    if found.iter().any(|name| name == split) {
        return Ok((root.join(format!("transforms_{split}.json")), Part::All));
    }
    let known = if !found.is_empty() {
        found.join(", ")
    } else if undivided.is_file() {
        match split {
            "train" => return Ok((undivided, Part::Train)),
            "test" => return Ok((undivided, Part::Test)),
            _ => "train, test".into(),
        }
    } else {
        return Err(Error::input(
            root.display(),
            format!("holds neither transforms_{split}.json nor transforms.json"),
            "set data.root to the folder of a Blender-layout scene",
        ));
    };
    Err(Error::input(
        root.display(),
        format!("has no split \"{split}\", only {known}"),
        "choose one of them for data.train and data.test",
    ))
}

/// Image size from `w` and `h`.
#[derive(Clone, Copy, Default)]
struct Size {
    width: Option<u32>,
    height: Option<u32>,
}

impl Size {
    fn of(node: &Node<'_>) -> Result<Self> {
        let side = |key: &str| -> Result<Option<u32>> {
            let Some(value) = node.number(key)? else { return Ok(None) };
            // Some exporters write 1080.0.
            if value >= 1.0 && value <= f64::from(u32::MAX) && value.fract() == 0.0 {
                return Ok(Some(value as u32));
            }
            Err(Error::input(
                &node.place,
                format!("\"{key}\" is {value}"),
                "expected a whole number of pixels",
            ))
        };
        Ok(Self { width: side("w")?, height: side("h")? })
    }

    fn or(self, other: Self) -> Self {
        Self { width: self.width.or(other.width), height: self.height.or(other.height) }
    }

    /// Refuses an image whose size differs.
    fn check(self, image: &Photograph) -> Result<()> {
        let (width, height) = (self.width.unwrap_or(image.width), self.height.unwrap_or(image.height));
        if (width, height) == (image.width, image.height) {
            return Ok(());
        }
        Err(Error::input(
            &image.place,
            format!(
                "image {} is {}x{} pixels, but the file states {width}x{height}",
                image.path.display(),
                image.width,
                image.height
            ),
            "use the images the cameras were computed for, or scale w, h, fl_x, fl_y, cx and cy along",
        ))
    }
}

fn read_frame(root: &Path, file: &Node<'_>, stated: Size, frame: &Node<'_>, scales: u32) -> Result<Source> {
    let value = frame.required("file_path")?;
    let named = value.as_str().ok_or_else(|| frame.unexpected("file_path", "a text", value))?;
    let (rotation, origin) = pose::read(frame, "transform_matrix")?;
    let size = Size::of(frame)?.or(stated);
    let image = Photograph::open(find_image(root, named, &frame.place)?, frame.place.clone())?;
    let image = image.fit(size.width, size.height);
    size.check(&image)?;
    let intrinsics = intrinsics(file, frame, image.width, image.height)?;
    let camera = Camera { intrinsics, rotation, origin };
    let source = Source::averaged(stem(named), camera, scales, &frame.place, Pixels::Photograph(image))?;
    let mask = |value: &serde_json::Value| {
        let named = value.as_str().ok_or_else(|| frame.unexpected("mask_path", "a text", value))?;
        Ok(named.to_string())
    };
    Ok(Source { mask_path: frame.get("mask_path").map(mask).transpose()?, ..source })
}

fn intrinsics(file: &Node<'_>, frame: &Node<'_>, width: u32, height: u32) -> Result<Intrinsics> {
    // The focal length of a frame overrides that of the file, in whichever form.
    let (fx, fy) = match focal(frame, width, height)? {
        Some(focal) => focal,
        None => focal(file, width, height)?.ok_or_else(|| {
            Error::input(
                &file.place,
                "has no focal length (\"fl_x\", \"camera_angle_x\")",
                format!("add one of the keys, or add it to {}", frame.place),
            )
        })?,
    };
    let centre = |key: &str, side: u32| -> Result<f64> {
        Ok(frame.number(key)?.or(file.number(key)?).unwrap_or(0.5 * f64::from(side)))
    };
    let lens = lens::read(file, frame)?;
    Ok(Intrinsics { width, height, fx, fy, cx: centre("cx", width)?, cy: centre("cy", height)?, lens })
}

/// Focal lengths from one node: `fl_x` and `fl_y`, otherwise half the side over the tangent of half the field of view.
fn focal(node: &Node<'_>, width: u32, height: u32) -> Result<Option<(f64, f64)>> {
    let length = |key: &str, angle_key: &str, side: u32| -> Result<Option<f64>> {
        let (key, stated, focal) = match (node.number(key)?, node.number(angle_key)?) {
            (Some(focal), _) => (key, focal, focal),
            (None, Some(angle)) if angle > 0.0 && angle < std::f64::consts::PI => {
                (angle_key, angle, 0.5 * f64::from(side) / (0.5 * angle).tan())
            }
            (None, Some(angle)) => (angle_key, angle, f64::NAN),
            (None, None) => return Ok(None),
        };
        if focal.is_finite() && focal > 0.0 {
            return Ok(Some(focal));
        }
        Err(Error::input(
            &node.place,
            format!("\"{key}\" is {stated}, which makes no positive focal length"),
            "expected pixels above 0 for a length, radians between 0 and pi for an angle",
        ))
    };
    let x = length("fl_x", "camera_angle_x", width)?;
    let y = length("fl_y", "camera_angle_y", height)?;
    Ok(x.or(y).map(|x| (x, y.unwrap_or(x))))
}

/// A focal length in pixels that is given once for the file is valid for one image size only.
fn check_shared_focal(
    file: &Node<'_>,
    entries: &[serde_json::Value],
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
