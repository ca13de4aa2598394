//! Layouts of scene folders: which one a folder has, and its frames by split.

use crate::settings::{DataConfig, Format};
use crate::{
    blender, builtin, colmap,
    multiscale::{METADATA, Metadata},
    names,
    split::Split,
};
use std::path::Path;
use trimip_core::{Error, Result, config::Convention};

/// A scene folder of a known layout.
pub(crate) enum Layout<'a> {
    Builtin(&'a DataConfig),
    Multiscale(Metadata, u32),
    Transforms(&'a Path, u32),
    Colmap(Box<colmap::Capture>),
}

impl<'a> Layout<'a> {
    /// The layout of the configured folder; an error if it has none.
    pub(crate) fn open(config: &'a DataConfig) -> Result<Self> {
        let root = Path::new(&config.root);
        match detect(config)? {
            Format::Builtin => Ok(Self::Builtin(config)),
            Format::Multiscale => {
                if config.convention == Convention::Premultiplied {
                    return Err(Error::input(
                        "data.convention",
                        "\"premultiplied\" cannot be had from a multi-scale set, whose levels are straight means",
                        "set it to \"public\", or data.root to the scene the set was made from",
                    ));
                }
                Ok(Self::Multiscale(Metadata::open(root)?, config.scales))
            }
            Format::Colmap => Ok(Self::Colmap(Box::new(colmap::Capture::open(root, config)?))),
            Format::Blender | Format::Auto => Ok(Self::Transforms(root, config.scales)),
        }
    }

    /// The layout in words.
    pub(crate) fn name(&self) -> &'static str {
        match self {
            Self::Builtin(_) => "built-in scene",
            Self::Multiscale(..) => "multi-scale set",
            Self::Transforms(..) => "Blender layout",
            Self::Colmap(_) => "COLMAP model",
        }
    }

    /// The frames of a split.
    pub(crate) fn split(&self, split: &str) -> Result<Split> {
        match self {
            Self::Builtin(config) => builtin::split(config, split),
            Self::Multiscale(metadata, scales) => metadata.split(split, *scales),
            Self::Transforms(root, scales) => blender::read(root, split, *scales),
            Self::Colmap(capture) => capture.split(split),
        }
    }

    /// True unless the folder is known to have no such split; the others tell when it is read.
    pub(crate) fn has_split(&self, split: &str) -> Result<bool> {
        match self {
            Self::Transforms(root, _) => blender::has_split(root, split),
            _ => Ok(true),
        }
    }

    /// All frames from which a list of test frames chooses: those of the file without splits, or those of the splits
    /// `train` and `test`.
    pub(crate) fn listable(&self, config: &DataConfig) -> Result<Vec<Split>> {
        match self {
            Self::Builtin(_) | Self::Multiscale(..) => Err(Error::input(
                "data.test_list",
                format!("cannot divide the frames of a {}", self.name()),
                "set it to \"\", or data.format to \"blender\" or \"colmap\"",
            )),
            Self::Colmap(capture) => Ok(vec![capture.all()?]),
            Self::Transforms(root, scales) => {
                if let Some(all) = blender::read_all(root, *scales)? {
                    return Ok(vec![all]);
                }
                let mut splits: Vec<&String> = config.train.iter().collect();
                if !splits.contains(&&config.test) && self.has_split(&config.test)? {
                    splits.push(&config.test);
                }
                splits.into_iter().map(|split| self.split(split)).collect()
            }
        }
    }

    /// A warning for a setting that this layout does not read.
    pub(crate) fn unread(&self, config: &DataConfig) -> Option<String> {
        (!config.images.is_empty() && !matches!(self, Self::Colmap(_)))
            .then(|| format!("data.images is read for COLMAP models alone, and this is a {}", self.name()))
    }
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
    found(root).ok_or_else(|| {
        let what = format!(
            "holds no scene: looked for {METADATA}, transforms_train.json, transforms.json and a COLMAP model (sparse/0)"
        );
        Error::input(root.display(), what, instead(root))
    })
}

/// The layout that the files in a folder show.
pub(crate) fn found(root: &Path) -> Option<Format> {
    if root.join(METADATA).is_file() {
        Some(Format::Multiscale)
    } else if blender::undivided(root).is_file() || !blender::splits(root).is_empty() {
        Some(Format::Blender)
    } else {
        colmap::is_there(root).then_some(Format::Colmap)
    }
}

/// Advice for a folder without a scene.
fn instead(root: &Path) -> String {
    let entries = || root.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
    if let Some(inner) = entries().find(|path| path.is_dir() && found(path).is_some()) {
        return format!("name {}, which holds one", inner.display());
    }
    match entries().filter(|path| names::is_picture(path)).count() {
        0 => "name a folder with one of them".into(),
        count => {
            format!("its {count} pictures need cameras: COLMAP finds them, and its model in sparse/0 is read")
        }
    }
}
