//! Opening a scene: divides the frames of a folder, loads its training views, and gives access to its test frames.

use crate::settings::DataConfig;
use crate::{
    describe,
    division::HOLD_OUT,
    layout::Layout,
    list, masks, orientation,
    points::{Cloud, Point},
    source::{FrameList, Source, assemble_in},
    split::Split,
    watch::{Meter, Watch, unwatched},
    workers,
};
use std::path::Path;
use trimip_core::{Alpha, Camera, Error, Frames, Intrinsics, Result, ViewSet, scene_plan::StatedBox};

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
    /// Points of the scene that the data state, with the training views that saw them.
    pub points: Vec<Point>,
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
    /// Training frames, as `frames`.
    pub photographs: Box<dyn Frames>,
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
    workers::start()?;
    let survey = Survey::new(config)?;
    let train = assemble_in(config.pixels, &survey.train, survey.alpha, &Meter::new(&survey.train, watch))?;
    Ok(survey.opened(config, train))
}

/// Opens the test frames of the scene that the settings name. Reads every camera and image header as [`open`] does, but
/// decodes no training image, which saves time and memory.
///
/// # Errors
/// As [`open`]; of kind `Input` if there is no test frame.
pub fn open_test(config: &DataConfig) -> Result<TestSet> {
    workers::start()?;
    let Survey { name, train, test, warnings, alpha, .. } = Survey::new(config)?;
    if test.is_empty() {
        let named = format!("data.test = \"{}\"", config.test);
        return Err(Error::input(named, "the test split holds no view", "name another data.test"));
    }
    let cameras = train.iter().filter_map(|source| source.views.first()).map(|(_, camera)| *camera).collect();
    let photographs = frames(train, alpha);
    Ok(TestSet { name, frames: frames(test, alpha), train: cameras, photographs, warnings })
}

/// Frames that are decoded or rendered on request.
fn frames(sources: Vec<Source>, alpha: Alpha) -> Box<dyn Frames> {
    Box::new(FrameList { sources, alpha })
}

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
    /// More lines of the description.
    pub(crate) notes: Vec<String>,
    pub(crate) stated: Option<StatedBox>,
    /// What alpha is in all views.
    pub(crate) alpha: Alpha,
    pub(crate) points: Vec<Point>,
}

impl Survey {
    /// The scene with its training views.
    pub(crate) fn opened(self, config: &DataConfig, train: ViewSet) -> Scene {
        let description = describe::description(&self, config, &train);
        let of_masks = masks::warnings(&self.train, &train);
        Scene {
            name: self.name,
            train,
            test: frames(self.test, self.alpha),
            stated: self.stated,
            points: self.points,
            warnings: [self.warnings, of_masks].concat(),
            description,
        }
    }

    pub(crate) fn new(config: &DataConfig) -> Result<Self> {
        if !(1..=8).contains(&config.scales) {
            return Err(Error::input("data.scales", format!("is {}", config.scales), "expected 1 to 8"));
        }
        if config.train.is_empty() {
            return Err(Error::input("data.train", "names no split", "name at least one"));
        }
        let layout = Layout::open(config)?;
        let root = Path::new(&config.root);
        let name = if matches!(layout, Layout::Builtin(_)) { "builtin".into() } else { folder_name(root) };
        let mut told = Told { warnings: layout.unread(config).into_iter().collect(), ..Told::default() };
        let mut train = Vec::new();
        let mut train_splits = Vec::new();
        let mut test;
        if config.test_list.is_empty() {
            for split in &config.train {
                let part = layout.split(split)?;
                train_splits.push((split.clone(), part.sources.len()));
                train.extend(told.by(part));
            }
            test = tested(&layout, config, &mut train, &mut told)?;
        } else {
            if config.holdout > 0 {
                let what = format!("and data.holdout = {} both choose the test frames", config.holdout);
                return Err(Error::input("data.test_list", what, "set one of them"));
            }
            let frames = layout.listable(config)?.into_iter().flat_map(|part| told.by(part)).collect();
            (train, test) = list::divide(root, &config.test_list, frames)?;
            train_splits.push(("train".into(), train.len()));
        }
        let Told { mut warnings, mut notes, stated, cloud } = told;
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
        notes.retain(|note| seen.insert(note.clone()));
        let (train, test) = shrink(train, test, config, &mut warnings);
        let halvings = train.first().map_or(0, |source| source.halvings);
        let points = cloud.seen_by(train.iter().map(|source| source.name.as_str()), halvings);
        let layout = layout.name();
        Ok(Self { name, layout, train_splits, train, test, warnings, notes, stated, alpha, points })
    }
}

/// What the splits of a scene tell about it; the first that states a box or points has the word.
#[derive(Default)]
struct Told {
    warnings: Vec<String>,
    notes: Vec<String>,
    stated: Option<StatedBox>,
    cloud: Cloud,
}

impl Told {
    /// Takes what a split tells, and gives its frames.
    fn by(&mut self, split: Split) -> Vec<Source> {
        self.warnings.extend(split.warnings);
        self.notes.extend(split.notes);
        self.stated = self.stated.take().or(split.stated);
        if self.cloud.points.is_empty() {
            self.cloud = split.cloud;
        }
        split.sources
    }
}

/// The test frames: every n-th of `train`, which are taken out of it, or those of the test split.
fn tested(
    layout: &Layout<'_>,
    config: &DataConfig,
    train: &mut Vec<Source>,
    told: &mut Told,
) -> Result<Vec<Source>> {
    let every = match config.holdout {
        // A folder without a test split is tested on some of its training frames.
        0 if config.test == TEST && !layout.has_split(TEST)? => {
            told.warnings.push(format!(
                "{} has no split \"{TEST}\": every {HOLD_OUT}th training frame is held out for testing",
                Path::new(&config.root).display(),
            ));
            HOLD_OUT
        }
        every => every as usize,
    };
    if every > 0 {
        return hold_out(train, every);
    }
    let test = layout.split(&config.test)?;
    told.warnings.extend(test.warnings);
    if config.train.contains(&config.test) {
        told.warnings.push(format!("split \"{}\" is both trained and tested on", config.test));
    }
    Ok(test.sources)
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

/// The last part of a path.
fn folder_name(root: &Path) -> String {
    let whole = root.canonicalize().unwrap_or_else(|_| root.to_path_buf());
    whole.file_name().map_or_else(|| root.display().to_string(), |name| name.to_string_lossy().into_owned())
}

/// A warning if some photographs have alpha and others have not.
fn alpha_warning(train: &[Source], alpha: Alpha) -> Option<String> {
    let silhouette = |source: &Source| alpha.is_opacity() && source.mask.is_some();
    let files = || train.iter().flat_map(|source| source.files().iter().map(move |file| (source, file)));
    let masked = files().filter(|(source, file)| file.alpha || silhouette(source)).count();
    let total = files().count();
    (0 < masked && masked < total).then(|| {
        format!(
            "{} of {total} training images {} no alpha, and the others have: all that they show is taken for the object",
            total - masked,
            if total - masked == 1 { "has" } else { "have" }
        )
    })
}
