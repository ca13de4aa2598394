//! A scene before any photograph is decoded: its training and test frames, with their masks, points and warnings.

use crate::{
    division::HOLD_OUT,
    layout::{self, Layout},
    list, masks,
    points::{Cloud, Point},
    sector,
    settings::{DataConfig, HoldoutBy},
    source::{Pixels, Source},
    split::Split,
    warnings,
};
use std::path::Path;
use trimip_core::{
    Alpha, Camera, Error, Result,
    scene::{
        origin::LocalOrigin,
        strays::{LOST, lost},
    },
    scene_plan::StatedBox,
};

/// A scene before any image is decoded.
pub(crate) struct Survey {
    pub(crate) name: String,
    /// Description of the layout.
    pub(crate) layout: &'static str,
    /// Name of each training split, and its number of frames.
    pub(crate) train_splits: Vec<(String, usize)>,
    pub(crate) train: Vec<Source>,
    pub(crate) test: Vec<Source>,
    pub(crate) warnings: Vec<String>,
    /// Note about where its archive was unpacked.
    pub(crate) unpacked: Option<String>,
    /// More lines of the description.
    pub(crate) notes: Vec<String>,
    pub(crate) stated: Option<StatedBox>,
    /// Meaning of alpha in all views.
    pub(crate) alpha: Alpha,
    pub(crate) points: Vec<Point>,
    /// Origin of the coordinates of cameras, box and points, in the coordinates of the files.
    pub(crate) origin: LocalOrigin,
}

impl Survey {
    /// Reads every camera and image header of the scene that the settings name. Its coordinates are those of the files.
    pub(crate) fn new(config: &DataConfig) -> Result<Self> {
        if !(1..=8).contains(&config.scales) {
            return Err(Error::input("data.scales", format!("is {}", config.scales), "expected 1 to 8"));
        }
        if config.train.is_empty() {
            return Err(Error::input("data.train", "names no split", "name at least one"));
        }
        let (config, unpacked) = layout::unpacked(config)?;
        let config = &*config;
        let layout = Layout::open(config)?;
        let root = Path::new(&config.root);
        let name = match layout.reader.files {
            Some(_) => folder_name(root),
            None => layout.reader.format.into(),
        };
        let mut facts = Facts { warnings: layout.unread(config).into_iter().collect(), ..Facts::default() };
        let (train_splits, mut train, mut test) = divided(&layout, config, &mut facts)?;
        let Facts { mut warnings, mut notes, stated, cloud } = facts;
        warnings.extend(leave_out_lost(&mut train, &mut test));
        if !config.lens {
            train.iter_mut().chain(&mut test).for_each(Source::straighten);
        }
        warnings.extend(warnings::blind(train.iter().chain(&test)));
        let alpha = masks::find(config, &mut train.iter_mut().chain(&mut test).collect::<Vec<_>>())?;
        let all: Vec<&Source> = train.iter().chain(&test).collect();
        warnings.extend(masks::missing(config, &all));
        warnings.extend(warnings::orientation(all.into_iter()));
        warnings.extend(warnings::alpha(&train, alpha));
        let mut seen = std::collections::HashSet::new();
        warnings.retain(|warning| seen.insert(warning.clone()));
        notes.retain(|note| seen.insert(note.clone()));
        let (train, test) = shrink(train, test, config, &mut warnings);
        let halvings = train.first().map_or(0, |source| source.halvings);
        let points = cloud.seen_by(train.iter().map(|source| source.name.as_str()), halvings);
        let layout = layout.reader.name;
        let origin = LocalOrigin::default();
        Ok(Self {
            name,
            layout,
            train_splits,
            train,
            test,
            warnings,
            unpacked,
            notes,
            stated,
            alpha,
            points,
            origin,
        })
    }

    /// Moves the scene to coordinates relative to `data.origin` or, if none is given, to the place that `choose` finds
    /// for the training cameras.
    pub(crate) fn local(mut self, config: &DataConfig, choose: fn(&[Camera]) -> LocalOrigin) -> Result<Self> {
        let origin = match config.origin[..] {
            [] => choose(&self.cameras()),
            ref given => LocalOrigin::at(given),
        };
        let rendered = self.train.iter().any(|source| matches!(source.pixels, Pixels::Rendered { .. }));
        if rendered && !origin.is_zero() {
            let what = format!("is {origin}, but the built-in scene is rendered at its own origin");
            return Err(Error::input("data.origin", what, "leave it out"));
        }
        for (_, camera) in self.train.iter_mut().chain(&mut self.test).flat_map(|source| &mut source.views) {
            *camera = origin.local(*camera);
        }
        for point in &mut self.points {
            point.position = origin.local(point.position);
        }
        if let Some(stated) = &mut self.stated {
            stated.aabb = origin.local(stated.aabb);
        }
        Ok(Self { origin, ..self })
    }

    /// Returns the cameras of the training views at their finest scale.
    pub(crate) fn cameras(&self) -> Vec<Camera> {
        cameras(&self.train)
    }
}

/// Returns the cameras of frames at their finest scale.
fn cameras(frames: &[Source]) -> Vec<Camera> {
    frames.iter().filter_map(|source| source.views.first()).map(|(_, camera)| *camera).collect()
}

/// Removes the frames whose cameras are lost, which means far from all others, and returns a warning. These frames are
/// neither trained nor measured.
fn leave_out_lost(train: &mut Vec<Source>, test: &mut Vec<Source>) -> Option<String> {
    let lost = lost(&[cameras(train), cameras(test)].concat());
    let trained = train.len();
    let named = lost.first().map(|&index| match index.checked_sub(trained) {
        None => train[index].name.clone(),
        Some(index) => test[index].name.clone(),
    })?;
    let all = trained + test.len();
    let mut indices = 0..all;
    let mut is_kept = |_: &Source| indices.next().is_some_and(|index| lost.binary_search(&index).is_err());
    train.retain(&mut is_kept);
    test.retain(is_kept);
    Some(format!(
        "{} of {all} photographs, the first {named}, have cameras whose distance from the middle of all cameras is more than {LOST} times \
         the median: their poses are wrong, and they are left out",
        lost.len()
    ))
}

/// Metadata of the splits of a scene, apart from their frames. The first split that states a box or points wins.
#[derive(Default)]
struct Facts {
    warnings: Vec<String>,
    notes: Vec<String>,
    stated: Option<StatedBox>,
    cloud: Cloud,
}

impl Facts {
    /// Takes the metadata of a split, and returns its frames.
    fn take(&mut self, split: Split) -> Vec<Source> {
        self.warnings.extend(split.warnings);
        self.notes.extend(split.notes);
        self.stated = self.stated.take().or(split.stated);
        if self.cloud.points.is_empty() {
            self.cloud = split.cloud;
        }
        split.sources
    }
}

/// Names and sizes of the training splits, the training frames, and the test frames.
type Divided = (Vec<(String, usize)>, Vec<Source>, Vec<Source>);

/// Divides the frames as the settings say.
fn divided(layout: &Layout, config: &DataConfig, facts: &mut Facts) -> Result<Divided> {
    if !config.test_list.is_empty() {
        return listed(layout, config, facts);
    }
    // In files without splits, the split "train" lacks every 8th frame, so a sector is chosen among all frames.
    if config.holdout_by == HoldoutBy::Sector
        && !layout.states_splits()?
        && let Some(all) = layout.undivided()?
    {
        let mut train = facts.take(all);
        let sizes = vec![("all".into(), train.len())];
        let test = hold_out(&mut train, config, facts)?;
        return Ok((sizes, train, test));
    }
    let (mut train_splits, mut train) = (Vec::new(), Vec::new());
    for split in &config.train {
        let part = layout.split(split)?;
        train_splits.push((split.clone(), part.sources.len()));
        train.extend(facts.take(part));
    }
    let test = tested(layout, config, &mut train, facts)?;
    Ok((train_splits, train, test))
}

/// Divides the frames as `data.test_list` says.
fn listed(layout: &Layout, config: &DataConfig, facts: &mut Facts) -> Result<Divided> {
    let other = match (config.holdout, config.holdout_by) {
        (0, HoldoutBy::Stride) => None,
        (0, HoldoutBy::Sector) => Some("data.holdout_by = \"sector\"".to_string()),
        (every, _) => Some(format!("data.holdout = {every}")),
    };
    if let Some(other) = other {
        let what = format!("chooses the test frames, and so does {other}");
        return Err(Error::input("data.test_list", what, "set one of them"));
    }
    let frames = layout.listable(config)?.into_iter().flat_map(|part| facts.take(part)).collect();
    let (train, test) = list::divide(Path::new(&config.root), &config.test_list, frames)?;
    Ok((vec![("train".into(), train.len())], train, test))
}

/// Returns the test frames: those of the test split, or frames that it removes from `train`.
fn tested(
    layout: &Layout,
    config: &DataConfig,
    train: &mut Vec<Source>,
    facts: &mut Facts,
) -> Result<Vec<Source>> {
    if config.holdout > 0 {
        return hold_out(train, config, facts);
    }
    let mut split = config.test.as_str();
    if split == TEST && !layout.has_split(TEST)? {
        let root = Path::new(&config.root).display();
        let validated = !config.train.iter().any(|split| split == VAL) && layout.has_split(VAL)?;
        // A folder without a test split is tested on its validation frames, or on some of its training frames.
        if !validated {
            let held = match config.holdout_by {
                HoldoutBy::Stride => format!("every {HOLD_OUT}th training frame is held out"),
                HoldoutBy::Sector => {
                    format!("one training frame in {HOLD_OUT}, all in one sector, is held out")
                }
            };
            facts
                .warnings
                .push(format!("{root} has no photographs of a split \"{TEST}\": {held} for testing"));
            return hold_out(train, config, facts);
        }
        facts
            .warnings
            .push(format!("{root} has no photographs of a split \"{TEST}\": \"{VAL}\" is the test split"));
        split = VAL;
    }
    if config.holdout_by == HoldoutBy::Sector {
        let what = format!("is \"sector\", but the scene has test frames in its split \"{split}\"");
        let advice = format!(
            "set data.holdout to {HOLD_OUT} to hold out training frames in their place, or data.holdout_by to \"stride\""
        );
        return Err(Error::input("data.holdout_by", what, advice));
    }
    let test = layout.split(split)?;
    facts.warnings.extend(test.warnings);
    if config.train.iter().any(|trained| trained == split) {
        facts.warnings.push(format!("split \"{split}\" is both trained and tested on"));
    }
    Ok(test.sources)
}

/// Name of the test split, unless the settings state another.
const TEST: &str = "test";

/// Name of the split that some exporters write instead.
const VAL: &str = "val";

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
         scale 1 is this reduced size",
        1 << halvings,
        1e-6 * pixels,
        1e-6 * config.most_pixels
    ));
    let shrunk = |sources: Vec<Source>| sources.into_iter().map(|source| source.shrunk(halvings)).collect();
    (shrunk(train), shrunk(test))
}

/// Takes one frame in `data.holdout` out of `train`, or one in [`HOLD_OUT`] if `data.holdout` is 0. These are every
/// n-th frame, beginning with the first, or equally many frames in one sector of the cameras around the first.
fn hold_out(train: &mut Vec<Source>, config: &DataConfig, facts: &mut Facts) -> Result<Vec<Source>> {
    let (frames, every) = (train.len(), if config.holdout > 0 { config.holdout as usize } else { HOLD_OUT });
    let chosen: Vec<usize> = match config.holdout_by {
        HoldoutBy::Stride => (0..frames).step_by(every).collect(),
        HoldoutBy::Sector => {
            let sector = sector::around_first(&cameras(train), frames.div_ceil(every));
            facts.notes.extend(sector.as_ref().map(|sector| {
                format!("the test frames are one sector of the cameras: those within {}", sector.extent)
            }));
            sector.map_or_else(Vec::new, |sector| sector.frames)
        }
    };
    if chosen.len() == frames {
        return Err(Error::input(
            "data.holdout",
            format!("leaves none of {frames} training frames"),
            "use more frames or set it to 0",
        ));
    }
    let (mut held, mut kept) = (Vec::new(), Vec::new());
    for (index, source) in train.drain(..).enumerate() {
        if chosen.binary_search(&index).is_ok() { held.push(source) } else { kept.push(source) }
    }
    *train = kept;
    Ok(held)
}

/// Returns the last part of a path.
fn folder_name(root: &Path) -> String {
    let whole = root.canonicalize().unwrap_or_else(|_| root.to_path_buf());
    whole.file_name().map_or_else(|| root.display().to_string(), |name| name.to_string_lossy().into_owned())
}
