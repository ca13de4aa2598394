//! The layout of a scene folder: which reader has it, what is to be told where none has, and its frames by split.

use crate::settings::DataConfig;
use crate::{
    advice::advice,
    readers::{
        READERS, found,
        reader::{OpenScene, Reader},
    },
    split::Split,
};
use std::path::Path;
use trimip_core::{Error, Result};

/// The value of `data.format` by which the files of a folder choose.
const AUTO: &str = "auto";

/// A scene, opened by its reader.
pub(crate) struct Layout {
    pub(crate) reader: &'static Reader,
    scene: Box<dyn OpenScene>,
}

impl Layout {
    /// Opens the configured folder; an error if it holds no scene.
    pub(crate) fn open(config: &DataConfig) -> Result<Self> {
        let reader = detect(config)?;
        Ok(Self { reader, scene: (reader.open)(Path::new(&config.root), config)? })
    }

    /// The frames of a split.
    pub(crate) fn split(&self, split: &str) -> Result<Split> {
        self.scene.split(split)
    }

    /// True unless the folder is known to have no such split; the others tell when it is read.
    pub(crate) fn has_split(&self, split: &str) -> Result<bool> {
        self.scene.has_split(split)
    }

    /// All frames from which a list of test frames chooses: those of the file without splits, or those of the splits
    /// `train` and `test`.
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

    /// A warning for a setting that this layout does not read.
    pub(crate) fn unread(&self, config: &DataConfig) -> Option<String> {
        let readers: Vec<String> =
            READERS.iter().filter_map(|reader| reader.images).map(str::to_string).collect();
        (!config.images.is_empty() && self.reader.images.is_none()).then(|| {
            let readers = listed(&readers, "and");
            format!("data.images is read for {readers} alone, and this is a {}", self.reader.name)
        })
    }
}

/// The reader of the configured folder; an error if it has none.
fn detect(config: &DataConfig) -> Result<&'static Reader> {
    let named = match config.format.as_str() {
        AUTO => None,
        format => Some(of_format(format)?),
    };
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
        let files: Vec<String> =
            READERS.iter().filter_map(|reader| reader.files).map(str::to_string).collect();
        Error::input(
            root.display(),
            format!("holds no scene: looked for {}", listed(&files, "and")),
            advice(root),
        )
    })
}

/// The reader with that value of `data.format`.
fn of_format(format: &str) -> Result<&'static Reader> {
    READERS.iter().copied().find(|reader| reader.format == format).ok_or_else(|| {
        let what = format!("\"{format}\" is no layout of a scene");
        Error::input("data.format", what, format!("expected {}", formats()))
    })
}

/// True for a value of `data.format`.
pub(crate) fn is_format(format: &str) -> bool {
    format == AUTO || READERS.iter().any(|reader| reader.format == format)
}

/// The values of `data.format`, in words.
pub(crate) fn formats() -> String {
    let known = std::iter::once(AUTO).chain(READERS.iter().map(|reader| reader.format));
    listed(&known.map(|format| format!("\"{format}\"")).collect::<Vec<_>>(), "or")
}

/// `a`, `a or b`, `a, b or c`.
fn listed(words: &[String], last: &str) -> String {
    match words {
        [] => String::new(),
        [one] => one.clone(),
        [all @ .., end] => format!("{} {last} {end}", all.join(", ")),
    }
}
