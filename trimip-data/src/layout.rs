//! The layout of a scene folder: the reader that recognises it, the error if no reader does, and its frames by split.

use crate::settings::DataConfig;
use crate::{
    advice::advice,
    archive::{self, Wanted},
    readers::{
        READERS, found,
        reader::{OpenScene, Reader},
    },
    split::Split,
    zip::is_archive,
};
use std::{borrow::Cow, path::Path};
use trimip_core::{Error, Result};

/// The value of `data.format` with which the files of a folder choose the reader.
const AUTO: &str = "auto";

/// A scene, opened by its reader.
pub(crate) struct Layout {
    pub(crate) reader: &'static Reader,
    scene: Box<dyn OpenScene>,
}

impl Layout {
    /// Opens the configured folder, or returns an error if it holds no scene.
    pub(crate) fn open(config: &DataConfig) -> Result<Self> {
        let reader = detect(config)?;
        Ok(Self { reader, scene: (reader.open)(Path::new(&config.root), config)? })
    }

    /// Returns the frames of a split.
    pub(crate) fn split(&self, split: &str) -> Result<Split> {
        self.scene.split(split)
    }

    /// Returns false if the folder is known to have no such split. Some missing splits are found only when they are read.
    pub(crate) fn has_split(&self, split: &str) -> Result<bool> {
        self.scene.has_split(split)
    }

    /// Returns true if the files state which frames are for training and which for testing.
    pub(crate) fn states_splits(&self) -> Result<bool> {
        self.scene.states_splits()
    }

    /// Returns all frames of a scene whose files state no splits, or `None` if frames are read by split.
    pub(crate) fn undivided(&self) -> Result<Option<Split>> {
        self.scene.undivided()
    }

    /// Returns all frames from which a list of test frames chooses: all frames of a file without splits, or the frames of the
    /// splits `data.train` and `data.test`.
    pub(crate) fn listable(&self, config: &DataConfig) -> Result<Vec<Split>> {
        if !self.reader.divisible {
            let others = READERS.iter().filter(|reader| reader.divisible);
            let others: Vec<String> = others.map(|reader| format!("\"{}\"", reader.format)).collect();
            return Err(Error::input(
                "data.test_list",
                format!("cannot divide the frames of a {}", self.reader.name),
                format!("set it to \"\", or data.format to {}", listed(&others, "or")),
            ));
        }
        if let Some(all) = self.scene.undivided()? {
            return Ok(vec![all]);
        }
        let mut splits: Vec<&String> = config.train.iter().collect();
        if !splits.contains(&&config.test) && self.has_split(&config.test)? {
            splits.push(&config.test);
        }
        splits.into_iter().map(|split| self.split(split)).collect()
    }

    /// Returns a warning for a setting that this layout does not read.
    pub(crate) fn unread(&self, config: &DataConfig) -> Option<String> {
        let readers: Vec<String> =
            READERS.iter().filter_map(|reader| reader.images).map(str::to_string).collect();
        (!config.images.is_empty() && self.reader.images.is_none()).then(|| {
            let readers = listed(&readers, "and");
            format!("data.images applies only to {readers}, and this is a {}", self.reader.name)
        })
    }
}

/// Returns the settings with the unpacked folder in place of the scene's archive, and a note about the unpacked files.
pub(crate) fn unpacked(config: &DataConfig) -> Result<(Cow<'_, DataConfig>, Option<String>)> {
    let named = named(config)?;
    let root = Path::new(&config.root);
    if named.is_some_and(|reader| reader.files.is_none()) || !(is_archive(root) && root.is_file()) {
        return Ok((Cow::Borrowed(config), None));
    }
    let files = match named {
        Some(reader) => reader.files.unwrap_or_default().to_string(),
        None => looked_for(),
    };
    let is_scene =
        |folder: &Path| named.map_or(found(folder).is_some(), |reader| (reader.recognises)(folder));
    let unpacked = archive::unpacked(root, &Wanted { is_scene: &is_scene, files: &files })?;
    let Some(root) = unpacked.root.to_str().map(String::from) else {
        return Err(Error::input(unpacked.root.display(), "the path is not UTF-8", "rename the archive"));
    };
    Ok((Cow::Owned(DataConfig { root, ..config.clone() }), Some(unpacked.note)))
}

/// Returns the reader that `data.format` names, or `None` for "auto", when the files of the folder choose the reader.
fn named(config: &DataConfig) -> Result<Option<&'static Reader>> {
    match config.format.as_str() {
        AUTO => Ok(None),
        format => of_format(format).map(Some),
    }
}

/// Lists the files by which scenes are recognised, for messages.
fn looked_for() -> String {
    let files: Vec<String> = READERS.iter().filter_map(|reader| reader.files).map(str::to_string).collect();
    listed(&files, "and")
}

/// Returns the reader of the configured folder, or an error if it has none.
fn detect(config: &DataConfig) -> Result<&'static Reader> {
    let named = named(config)?;
    if let Some(reader) = named.filter(|reader| reader.files.is_none()) {
        return Ok(reader);
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
    named.or_else(|| found(root)).ok_or_else(|| {
        Error::input(root.display(), format!("holds no scene: looked for {}", looked_for()), advice(root))
    })
}

/// Returns the reader with that value of `data.format`.
fn of_format(format: &str) -> Result<&'static Reader> {
    READERS.iter().copied().find(|reader| reader.format == format).ok_or_else(|| {
        let what = format!("\"{format}\" is not a layout of scenes");
        Error::input("data.format", what, format!("expected {}", formats()))
    })
}

/// Returns true for a valid value of `data.format`.
pub(crate) fn is_format(format: &str) -> bool {
    format == AUTO || READERS.iter().any(|reader| reader.format == format)
}

/// Lists the values of `data.format`, for messages.
pub(crate) fn formats() -> String {
    let known = std::iter::once(AUTO).chain(READERS.iter().map(|reader| reader.format));
    listed(&known.map(|format| format!("\"{format}\"")).collect::<Vec<_>>(), "or")
}

/// Joins words as `a`, `a or b`, `a, b or c`; `last` is the word before the last one.
fn listed(words: &[String], last: &str) -> String {
    match words {
        [] => String::new(),
        [one] => one.clone(),
        [all @ .., end] => format!("{} {last} {end}", all.join(", ")),
    }
}
