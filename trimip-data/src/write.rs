//! Writes scenes: any scene as the public multi-scale layout, and the built-in scene as a Blender-layout folder. The
//! JSON file that names the images is written last, so a folder that has one is complete. If the command is stopped
//! before that, running it again completes the folder. An existing file is never replaced.

use crate::settings::{DataConfig, HoldoutBy};
use crate::{
    builtin,
    lens::lens_terms,
    readers::{self, blender, multiscale::METADATA},
    source::{Source, assemble, map_in_order, rows},
    survey::Survey,
    watch::{Meter, Watch},
};
use serde_json::{Value, json};
use std::{
    collections::BTreeSet,
    fmt::Display,
    fs,
    io::{Cursor, ErrorKind},
    path::{Path, PathBuf},
};
use trimip_core::{
    Alpha, Camera, Error, Intrinsics, Result, atomic::write_atomically, config::Convention, plural::count,
};

/// Result of writing a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Summary {
    /// The folder.
    pub folder: PathBuf,
    /// Name and number of frames of each split.
    pub splits: Vec<(String, usize)>,
    /// Number of image files.
    pub images: usize,
    /// Bytes of the image files.
    pub bytes: u64,
}

impl Display for Summary {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let splits: Vec<String> =
            self.splits.iter().map(|(split, count)| format!("{split} {count}")).collect();
        write!(
            f,
            "{}: {} of {} frames, {:.1} MB",
            self.folder.display(),
            count(self.images, "image"),
            splits.join(" + "),
            self.bytes as f64 / 1e6
        )
    }
}

/// Writes the training and test splits as the public converter does: `metadata.json`, `images_train/000_d0.png` and so
/// on. Every view gets `near` 2 and `far` 6, as in the public set. A split with a camera that is not plain (square
/// pixels, centred principal point) also has the arrays `fl_y`, `cx`, `cy`. Progress of reading goes to `watch`.
///
/// # Errors
/// Errors of reading; a folder that cannot be written or holds a set already; the premultiplied convention, which PNG
/// does not support.
pub fn write_multiscale(config: &DataConfig, folder: &Path, watch: Watch<'_>) -> Result<Summary> {
    if config.convention != Convention::Public {
        return Err(Error::input(
            "data.convention",
            "the multi-scale layout stores straight RGBA",
            "set it to \"public\"",
        ));
    }
    // The set contains all frames, including those held out of training.
    let whole = DataConfig { holdout: 0, holdout_by: HoldoutBy::Stride, ..config.clone() };
    let survey = Survey::new(&whole)?;
    if !survey.alpha.is_opacity() {
        return Err(Error::input(
            "data.mask_role",
            "the multi-scale layout cannot store masks of pixels to ignore",
            "set it to \"object\", or data.masks to \"none\"",
        ));
    }
    // The source may be this folder, and the new file would change how it is read.
    if readers::found(folder).is_some() {
        return Err(exists(folder));
    }
    let mut splits: Vec<(&str, &[Source])> = Vec::new();
    let mut rest = survey.train.as_slice();
    for (split, count) in &survey.train_splits {
        let (head, tail) = rest.split_at(*count);
        splits.push((split, head));
        rest = tail;
    }
    // Test frames of a list belong to no split of the source.
    if !config.test_list.is_empty() {
        splits.push(("test", &survey.test));
    } else if !config.train.contains(&config.test) {
        splits.push((&config.test, &survey.test));
    }
    let meter = Meter::new(rows(splits.iter().flat_map(|(_, sources)| *sources)), watch);
    let mut metadata = serde_json::Map::new();
    let mut summary = Summary { folder: folder.into(), splits: Vec::new(), images: 0, bytes: 0 };
    for (split, sources) in splits {
        create_folder(&folder.join(format!("images_{split}")))?;
        let written = map_in_order(sources, |index, source| {
            let set = assemble(std::slice::from_ref(source), survey.alpha, &meter)?;
            let mut bytes = 0;
            for view in 0..set.views.len() {
                let path = folder.join(image_path(split, index, source.views[view].0));
                bytes += save(&path, set.pixels_of(view), &set.views[view].camera.intrinsics)?;
            }
            Ok(bytes)
        })?;
        summary.splits.push((split.into(), sources.len()));
        summary.images += sources.iter().map(|source| source.views.len()).sum::<usize>();
        summary.bytes += written.iter().sum::<u64>();
        metadata.insert(split.into(), columns(split, sources));
    }
    put(&folder.join(METADATA), Value::Object(metadata).to_string().as_bytes())?;
    Ok(summary)
}

fn image_path(split: &str, frame: usize, level: u32) -> String {
    format!("images_{split}/{frame:03}_d{level}.png")
}

/// Returns the arrays of one split.
fn columns(split: &str, sources: &[Source]) -> Value {
    let views: Vec<(usize, u32, &Camera)> = sources
        .iter()
        .enumerate()
        .flat_map(|(frame, source)| source.views.iter().map(move |(level, camera)| (frame, *level, camera)))
        .collect();
    let column = |value: &dyn Fn(usize, u32, &Camera) -> Value| -> Value {
        views.iter().map(|&(frame, level, camera)| value(frame, level, camera)).collect()
    };
    let mut table = json!({
        "file_path": column(&|frame, level, _| image_path(split, frame, level).into()),
        "cam2world": column(&|_, _, camera| pose(camera)),
        "width": column(&|_, _, camera| camera.intrinsics.width.into()),
        "height": column(&|_, _, camera| camera.intrinsics.height.into()),
        "focal": column(&|_, _, camera| camera.intrinsics.fx.into()),
        "label": column(&|_, level, _| level.into()),
        "near": column(&|_, _, _| 2.0.into()),
        "far": column(&|_, _, _| 6.0.into()),
        "lossmult": column(&|_, level, _| 4_f64.powi(level as i32).into()),
        "pix2cam": column(&|_, _, camera| {
            let k = &camera.intrinsics;
            json!([[1.0 / k.fx, 0.0, -k.cx / k.fx], [0.0, -1.0 / k.fy, k.cy / k.fy], [0.0, 0.0, -1.0]])
        }),
    });
    let plain = |k: &Intrinsics| {
        k.fx == k.fy && k.cx == 0.5 * f64::from(k.width) && k.cy == 0.5 * f64::from(k.height)
    };
    if !views.iter().all(|(.., camera)| plain(&camera.intrinsics)) {
        table["fl_y"] = column(&|_, _, camera| camera.intrinsics.fy.into());
        table["cx"] = column(&|_, _, camera| camera.intrinsics.cx.into());
        table["cy"] = column(&|_, _, camera| camera.intrinsics.cy.into());
    }
    // One column for each coefficient that a view has.
    let terms = |camera: &Camera| lens_terms(&camera.intrinsics.lens);
    let keys: BTreeSet<&str> = views
        .iter()
        .filter_map(|(.., camera)| terms(camera))
        .flat_map(|(_, terms)| terms.into_iter().map(|(key, _)| key))
        .collect();
    if views.iter().any(|(.., camera)| terms(camera).is_some()) {
        table["camera_model"] =
            column(&|_, _, camera| terms(camera).map_or("PINHOLE", |(model, _)| model).into());
    }
    for key in keys {
        table[key] = column(&|_, _, camera| {
            let own = terms(camera).and_then(|(_, terms)| terms.into_iter().find(|(name, _)| *name == key));
            own.map_or(0.0, |(_, term)| term).into()
        });
    }
    table
}

/// Renders the built-in scene and writes it as `transforms_{train,test}.json` with PNG files. Progress goes to `watch`.
///
/// # Errors
/// Settings out of range; a folder that cannot be written or holds a scene already.
pub fn write_builtin(config: &DataConfig, folder: &Path, watch: Watch<'_>) -> Result<Summary> {
    let mut summary = Summary { folder: folder.into(), splits: Vec::new(), images: 0, bytes: 0 };
    let single = DataConfig { scales: 1, format: builtin::FORMAT.into(), ..config.clone() };
    let splits = ["train", "test"].map(|split| Ok((split, readers::builtin::split(&single, split)?.sources)));
    let splits = splits.into_iter().collect::<Result<Vec<_>>>()?;
    let documents: Vec<(PathBuf, String)> = splits
        .iter()
        .map(|(split, sources)| (folder.join(format!("transforms_{split}.json")), transforms(split, sources)))
        .collect();
    refuse_all_but(folder, &documents[1])?;
    let meter = Meter::new(rows(splits.iter().flat_map(|(_, sources)| sources)), watch);
    for (split, sources) in splits {
        create_folder(&folder.join(split))?;
        let bytes = map_in_order(&sources, |_, source| {
            let set = assemble(std::slice::from_ref(source), Alpha::Straight, &meter)?;
            let path = folder.join(split).join(format!("{}.png", source.name));
            save(&path, set.pixels_of(0), &set.views[0].camera.intrinsics)
        })?;
        summary.splits.push((split.into(), sources.len()));
        summary.images += sources.len();
        summary.bytes += bytes.iter().sum::<u64>();
    }
    // The training split is written last: without it, a set is unfinished.
    documents.iter().rev().try_for_each(|(path, text)| put(path, text.as_bytes()))?;
    Ok(summary)
}

/// Returns the file of a split of the built-in scene.
fn transforms(split: &str, sources: &[Source]) -> String {
    let frames: Vec<Value> = sources
        .iter()
        .flat_map(|source| source.views.iter().map(move |(_, camera)| (source, camera)))
        .map(|(source, camera)| {
            json!({ "file_path": format!("./{split}/{}", source.name), "transform_matrix": pose(camera) })
        })
        .collect();
    json!({ "camera_angle_x": builtin::CAMERA_ANGLE_X, "frames": frames }).to_string()
}

/// Refuses a folder that holds a data set, unless its only camera file is the one that a stopped run of this command writes first.
fn refuse_all_but(folder: &Path, (first, text): &(PathBuf, String)) -> Result<()> {
    let foreign = readers::READERS.iter().filter(|reader| reader.format != blender::FORMAT);
    let others =
        blender::undivided(folder).exists() || foreign.into_iter().any(|reader| (reader.recognises)(folder));
    let unfinished = match &blender::splits(folder)[..] {
        [] => true,
        [_] => fs::read(first).is_ok_and(|there| there == text.as_bytes()),
        _ => false,
    };
    if others || !unfinished { Err(exists(folder)) } else { Ok(()) }
}

/// Returns the rows of the camera-to-world matrix.
fn pose(camera: &Camera) -> Value {
    let (r, o) = (camera.rotation.transpose().to_cols_array_2d(), camera.origin.to_array());
    let row = |i: usize| json!([r[i][0], r[i][1], r[i][2], o[i]]);
    json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]])
}

/// Writes a PNG and returns its size in bytes.
fn save(path: &Path, pixels: &[[u8; 4]], k: &Intrinsics) -> Result<u64> {
    let mut png = Cursor::new(Vec::new());
    image::write_buffer_with_format(
        &mut png,
        pixels.as_flattened(),
        k.width,
        k.height,
        image::ColorType::Rgba8,
        image::ImageFormat::Png,
    )
    .map_err(|error| unwritable(path, &error))?;
    put(path, png.get_ref())?;
    Ok(png.get_ref().len() as u64)
}

/// Writes a new file. An existing file with the same bytes, from a command that was stopped, is kept.
fn put(path: &Path, bytes: &[u8]) -> Result<()> {
    match fs::read(path) {
        Ok(there) if there == bytes => Ok(()),
        Err(error) if error.kind() == ErrorKind::NotFound => write_atomically(path, bytes),
        Ok(_) => Err(Error::input(
            path.display(),
            "exists already with other contents",
            "choose another folder or remove it",
        )),
        Err(error) => Err(unwritable(path, &error)),
    }
}

fn create_folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path).map_err(|error| unwritable(path, &error))
}

fn exists(folder: &Path) -> Error {
    Error::input(
        folder.display(),
        "a data set exists already in this folder",
        "choose another folder or remove it",
    )
}

fn unwritable(path: &Path, error: &dyn Display) -> Error {
    Error::input(path.display(), format!("cannot be written: {error}"), "choose a folder you may write to")
}
