//! Opening a scene: finds the layout of a folder, loads its training views, and gives access to its test frames.

use crate::{
    blender::{self, Split},
    builtin, describe, masks,
    multiscale::{METADATA, Metadata},
    orientation,
    source::{FrameList, Source, assemble},
    watch::{Meter, Watch, unwatched},
};
use std::path::Path;
use trimip_core::{
    Alpha, Camera, Error, Frames, Intrinsics, Result, ViewSet,
    config::{Convention, DataConfig, Format},
    scene_plan::StatedBox,
};

/// A scene ready to train and test on.
pub struct Scene {
    /// Name of the folder, or "builtin".
    pub name: String,
    /// All training views at all scales.
    pub train: ViewSet,
    /// Test frames, each a set with one view per scale, decoded or rendered on request.
    pub test: Box<dyn Frames>,
    /// The bounding box that the data state.
    pub stated: Option<StatedBox>,
    /// Warnings about the data, to be shown beside every result.
    pub warnings: Vec<String>,
    /// A description in a few lines: layout, views, sizes, scales, memory.
    pub description: Vec<String>,
}

/// The test frames of a scene, without its training views.
pub struct TestSet {
    /// Name of the folder, or "builtin".
    pub name: String,
    /// Test frames, each a set with one view per scale, decoded or rendered on request.
    pub frames: Box<dyn Frames>,
    /// Cameras of the training views at their finest scale.
    pub train: Vec<Camera>,
    /// Warnings about the data, to be shown beside every result.
    pub warnings: Vec<String>,
}

impl std::fmt::Debug for Scene {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Scene").field("name", &self.name).field("description", &self.description).finish()
    }
}

/// Opens the scene that the settings name: reads every camera and image header, decodes the training images.
///
/// # Errors
/// Of kind `Input`, one line each: what is wrong, in which file and frame, and what to do.
pub fn open(config: &DataConfig) -> Result<Scene> {
    open_watched(config, &unwatched)
}

/// As [`open`]; progress of reading the training views goes to `watch`.
///
/// # Errors
/// As [`open`].
pub fn open_watched(config: &DataConfig, watch: Watch<'_>) -> Result<Scene> {
    let survey = Survey::new(config)?;
    let train = assemble(&survey.train, survey.alpha, &Meter::new(&survey.train, watch))?;
    let description = describe::description(&survey, config, &train);
    let of_masks = masks::warnings(&survey.train, &train);
    Ok(Scene {
        name: survey.name,
        train,
        test: frames(survey.test, survey.alpha),
        stated: survey.stated,
        warnings: [survey.warnings, of_masks].concat(),
        description,
    })
}

/// Opens the test frames of the scene that the settings name. Reads every camera and image header as [`open`] does, but
/// decodes no training image, which saves time and memory.
///
/// # Errors
/// As [`open`]; of kind `Input` if there is no test frame.
pub fn open_test(config: &DataConfig) -> Result<TestSet> {
    let Survey { name, train, test, warnings, alpha, .. } = Survey::new(config)?;
    if test.is_empty() {
        let named = format!("data.test = \"{}\"", config.test);
        return Err(Error::input(named, "the test split holds no view", "name another data.test"));
    }
    let train = train.iter().filter_map(|source| source.views.first()).map(|(_, camera)| *camera).collect();
    Ok(TestSet { name, frames: frames(test, alpha), train, warnings })
}

/// Frames that are decoded or rendered on request.
fn frames(sources: Vec<Source>, alpha: Alpha) -> Box<dyn Frames> {
    Box::new(FrameList { sources, alpha })
}

/// Reads a split by name.
type ReadSplit<'a> = Box<dyn Fn(&str) -> Result<Split> + 'a>;

/// A scene before any image is decoded.
pub(crate) struct Survey {
    pub(crate) name: String,
    /// Description of the layout.
    pub(crate) layout: &'static str,
    /// Training splits by name.
    pub(crate) train_splits: Vec<(String, usize)>,
    pub(crate) train: Vec<Source>,
    pub(crate) test: Vec<Source>,
    pub(crate) warnings: Vec<String>,
    pub(crate) stated: Option<StatedBox>,
    /// What alpha is in all views.
    pub(crate) alpha: Alpha,
}

impl Survey {
    pub(crate) fn new(config: &DataConfig) -> Result<Self> {
        if !(1..=8).contains(&config.scales) {
            return Err(Error::input("data.scales", format!("is {}", config.scales), "expected 1 to 8"));
        }
        if config.train.is_empty() {
            return Err(Error::input("data.train", "names no split", "name at least one"));
        }
        let format = detect(config)?;
        let root = Path::new(&config.root);
        let name = if format == Format::Builtin { "builtin".into() } else { folder_name(root) };
        let mut warnings = Vec::new();
        let mut train = Vec::new();
        let mut train_splits = Vec::new();
        let mut stated = None;
        let (layout, read): (_, ReadSplit<'_>) = match format {
            Format::Builtin => ("built-in scene", Box::new(|split| builtin::split(config, split))),
            Format::Multiscale => {
                if config.convention == Convention::Premultiplied {
                    return Err(Error::input(
                        "data.convention",
                        "\"premultiplied\" cannot be had from a multi-scale set, whose levels are straight means",
                        "set it to \"public\", or data.root to the scene the set was made from",
                    ));
                }
                let metadata = Metadata::open(root)?;
                ("multi-scale set", Box::new(move |split| metadata.split(split, config.scales)))
            }
            _ => ("Blender layout", Box::new(|split| blender::read(root, split, config.scales))),
        };
        for split in &config.train {
            let part = read(split)?;
            train_splits.push((split.clone(), part.sources.len()));
            train.extend(part.sources);
            warnings.extend(part.warnings);
            stated = stated.or(part.stated);
        }
        let every = match config.holdout {
            // A folder without a test split is tested on some of its training frames.
            0 if format == Format::Blender
                && !blender::has_split(root, &config.test)
                && config.test == TEST =>
            {
                warnings.push(format!(
                    "{} has no split \"{TEST}\": every {}th training frame is held out for testing",
                    root.display(),
                    blender::HOLD_OUT
                ));
                blender::HOLD_OUT
            }
            every => every as usize,
        };
        let test = if every > 0 {
            hold_out(&mut train, every)?
        } else {
            let test = read(&config.test)?;
            warnings.extend(test.warnings);
            if config.train.contains(&config.test) {
                warnings.push(format!("split \"{}\" is both trained and tested on", config.test));
            }
            test.sources
        };
        let mut test = test;
        if !config.lens {
            train.iter_mut().chain(&mut test).for_each(Source::straighten);
        }
        warnings.extend(blind(train.iter().chain(&test)));
        let alpha = masks::find(config, &mut train.iter_mut().chain(&mut test).collect::<Vec<_>>())?;
        let all: Vec<&Source> = train.iter().chain(&test).collect();
        warnings.extend(masks::missing(config, &all));
        warnings.extend(orientation::warning(all.into_iter()));
        warnings.extend(alpha_warning(&train, alpha));
        let mut seen = std::collections::HashSet::new();
        warnings.retain(|warning| seen.insert(warning.clone()));
        drop(read);
        let (train, test) = shrink(train, test, config, &mut warnings);
        Ok(Self { name, layout, train_splits, train, test, warnings, stated, alpha })
    }
}

/// A warning if the lens has no rays for some pixels: they are neither trained nor compared.
fn blind<'a>(sources: impl Iterator<Item = &'a Source>) -> Option<String> {
    let mut known: Vec<(Intrinsics, u64)> = Vec::new();
    let (mut blind, mut all) = (0, 0);
    for (_, camera) in sources.filter_map(|source| source.views.first()) {
        let k = camera.intrinsics;
        let own = known.iter().find(|(other, _)| *other == k).map(|(_, count)| *count);
        let own = own.unwrap_or_else(|| {
            known.push((k, k.blind_pixels()));
            known[known.len() - 1].1
        });
        blind += own;
        all += u64::from(k.width) * u64::from(k.height);
    }
    (blind > 0).then(|| {
        format!(
            "the lens model has no rays for {blind} of {all} pixels ({:.2} %), which are left out",
            100.0 * blind as f64 / all as f64
        )
    })
}

/// The test split if no other is named.
const TEST: &str = "test";

/// Halves all photographs until those for training fit into `data.most_pixels`.
fn shrink(
    train: Vec<Source>,
    test: Vec<Source>,
    config: &DataConfig,
    warnings: &mut Vec<String>,
) -> (Vec<Source>, Vec<Source>) {
    let pixels: f64 = train.iter().map(Source::pixels_in_memory).sum();
    let most = train.iter().chain(&test).map(Source::halvings_possible).min().unwrap_or(0);
    let halvings =
        (0..most).find(|&n| pixels * 0.25_f64.powi(n as i32) <= config.most_pixels).unwrap_or(most);
    if halvings == 0 {
        return (train, test);
    }
    warnings.push(format!(
        "the photographs are read at 1/{} of their width: {:.0} M training pixels are more than data.most_pixels = {:.0} M; \
         scale 1 is theirs",
        1 << halvings,
        1e-6 * pixels,
        1e-6 * config.most_pixels
    ));
    let shrunk = |sources: Vec<Source>| sources.into_iter().map(|source| source.shrunk(halvings)).collect();
    (shrunk(train), shrunk(test))
}

/// Removes every n-th frame from `train`, beginning with the first.
fn hold_out(train: &mut Vec<Source>, every: usize) -> Result<Vec<Source>> {
    let (mut held, mut kept) = (Vec::new(), Vec::new());
    for (index, source) in train.drain(..).enumerate() {
        if index % every == 0 { held.push(source) } else { kept.push(source) }
    }
    if kept.is_empty() {
        return Err(Error::input(
            "data.holdout",
            format!("leaves none of {} training frames", held.len()),
            "use more frames or set it to 0",
        ));
    }
    *train = kept;
    Ok(held)
}

/// The layout of the configured folder; an error if it has none.
fn detect(config: &DataConfig) -> Result<Format> {
    if config.format == Format::Builtin {
        return Ok(Format::Builtin);
    }
    if config.root.is_empty() {
        return Err(Error::input(
            "data.root",
            "is empty",
            "set it to the folder of a scene, or data.format to \"builtin\"",
        ));
    }
    let root = Path::new(&config.root);
    if !root.is_dir() {
        let what = if root.exists() { "is not a folder" } else { "does not exist" };
        return Err(Error::input(root.display(), what, "set data.root to the folder of a scene"));
    }
    if config.format != Format::Auto {
        return Ok(config.format);
    }
    if root.join(METADATA).is_file() {
        return Ok(Format::Multiscale);
    }
    if blender::undivided(root).is_file() || !blender::splits(root).is_empty() {
        return Ok(Format::Blender);
    }
    let what = format!("holds no scene: looked for {METADATA}, transforms_train.json, transforms.json");
    Err(Error::input(root.display(), what, instead(root)))
}

/// Advice for a folder without a scene.
fn instead(root: &Path) -> String {
    let entries = || root.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
    let scene = |path: &std::path::PathBuf| {
        path.join(METADATA).is_file()
            || blender::undivided(path).is_file()
            || !blender::splits(path).is_empty()
    };
    if let Some(inner) = entries().find(scene) {
        return format!("name {}, which holds one", inner.display());
    }
    let picture = |path: &std::path::PathBuf| {
        let extension = path.extension().unwrap_or_default().to_string_lossy().to_lowercase();
        ["png", "jpg", "jpeg"].contains(&extension.as_str())
    };
    match entries().filter(picture).count() {
        0 => "name a folder with one of them".into(),
        count => format!(
            "its {count} pictures need cameras: COLMAP finds them, and nerfstudio or Instant-NGP write transforms.json from it"
        ),
    }
}

/// The last part of a path.
fn folder_name(root: &Path) -> String {
    let whole = root.canonicalize().unwrap_or_else(|_| root.to_path_buf());
    whole.file_name().map_or_else(|| root.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// A warning for photographs without a mask: they show surroundings outside the bounding box.
fn alpha_warning(train: &[Source], alpha: Alpha) -> Option<String> {
    let silhouette = |source: &Source| alpha.is_opacity() && source.mask.is_some();
    let files = || train.iter().flat_map(|source| source.files().iter().map(move |file| (source, file)));
    let masked = files().filter(|(source, file)| file.alpha || silhouette(source)).count();
    let total = files().count();
    (masked < total).then(|| {
        format!(
            "{} of {total} training images {} no alpha: all that is seen is taken for the object; mask what lies \
             outside of the scene's box",
            total - masked,
            if total - masked == 1 { "has" } else { "have" }
        )
    })
}
