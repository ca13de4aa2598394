//! A scene before any photograph is decoded: which frames are trained and tested on, their masks, points and warnings.

use crate::{
    division::HOLD_OUT,
    layout::{self, Layout},
    list, masks,
    points::{Cloud, Point},
    settings::DataConfig,
    source::{Pixels, Source},
    split::Split,
    warnings,
};
use std::path::Path;
use trimip_core::{Alpha, Camera, Error, Result, scene::origin::LocalOrigin, scene_plan::StatedBox};

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
    /// Where its archive was unpacked, in words.
    pub(crate) unpacked: Option<String>,
    /// More lines of the description.
    pub(crate) notes: Vec<String>,
    pub(crate) stated: Option<StatedBox>,
    /// What alpha is in all views.
    pub(crate) alpha: Alpha,
    pub(crate) points: Vec<Point>,
    /// Where the coordinates of cameras, box and points begin in those of the files.
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
        let mut train = Vec::new();
        let mut train_splits = Vec::new();
        let mut test;
        if config.test_list.is_empty() {
            for split in &config.train {
                let part = layout.split(split)?;
                train_splits.push((split.clone(), part.sources.len()));
                train.extend(facts.take(part));
            }
            test = tested(&layout, config, &mut train, &mut facts)?;
        } else {
            if config.holdout > 0 {
                let what = format!("and data.holdout = {} both choose the test frames", config.holdout);
                return Err(Error::input("data.test_list", what, "set one of them"));
            }
            let frames = layout.listable(config)?.into_iter().flat_map(|part| facts.take(part)).collect();
            (train, test) = list::divide(root, &config.test_list, frames)?;
            train_splits.push(("train".into(), train.len()));
        }
        let Facts { mut warnings, mut notes, stated, cloud } = facts;
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

    /// The same scene in coordinates that count from `data.origin`, or, if none is given, from the place that `choose` finds for the
    /// training cameras.
    pub(crate) fn local(mut self, config: &DataConfig, choose: fn(&[Camera]) -> LocalOrigin) -> Result<Self> {
        let origin = match config.origin[..] {
            [] => choose(&self.cameras()),
            ref given => LocalOrigin::at(given),
        };
        let rendered = self.train.iter().any(|source| matches!(source.pixels, Pixels::Rendered { .. }));
        if rendered && !origin.is_zero() {
            let what = format!("is {origin}, and the built-in scene is rendered at its own origin");
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

    /// Cameras of the training views at their finest scale.
    pub(crate) fn cameras(&self) -> Vec<Camera> {
        self.train.iter().filter_map(|source| source.views.first()).map(|(_, camera)| *camera).collect()
    }
}

/// What the splits of a scene state about it beside their frames. The first split that states a box or points wins.
#[derive(Default)]
struct Facts {
    warnings: Vec<String>,
    notes: Vec<String>,
    stated: Option<StatedBox>,
    cloud: Cloud,
}

impl Facts {
    /// Takes what a split states, and returns its frames.
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

/// The test frames: every n-th of `train`, which are taken out of it, or those of the test split.
fn tested(
    layout: &Layout,
    config: &DataConfig,
    train: &mut Vec<Source>,
    facts: &mut Facts,
) -> Result<Vec<Source>> {
    if config.holdout > 0 {
        return hold_out(train, config.holdout as usize);
    }
    let mut split = config.test.as_str();
    if split == TEST && !layout.has_split(TEST)? {
        let root = Path::new(&config.root).display();
        let validated = !config.train.iter().any(|split| split == VAL) && layout.has_split(VAL)?;
        // A folder without a test split is tested on its validation frames, or on some of its training frames.
        if !validated {
            facts.warnings.push(format!(
                "{root} has no photographs of a split \"{TEST}\": every {HOLD_OUT}th training frame is held out for testing"
            ));
            return hold_out(train, HOLD_OUT);
        }
        facts
            .warnings
            .push(format!("{root} has no photographs of a split \"{TEST}\": \"{VAL}\" is the test split"));
        split = VAL;
    }
    let test = layout.split(split)?;
    facts.warnings.extend(test.warnings);
    if config.train.iter().any(|trained| trained == split) {
        facts.warnings.push(format!("split \"{split}\" is both trained and tested on"));
    }
    Ok(test.sources)
}

/// The test split if no other is named.
const TEST: &str = "test";

/// The split that some exporters write in its place.
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
