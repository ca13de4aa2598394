//! Splits of a file that holds all frames: every 8th frame is a test frame, or the file lists the names of each split
//! (nerfstudio's `train_filenames`, `val_filenames`, `test_filenames`).

use crate::{
    json::Node,
    names::{Index, Match},
};
use serde_json::Value;
use std::path::Path;
use trimip_core::{Error, Place, Result, plural::count};

/// Every n-th frame of a file without splits is a test frame, as in mip-NeRF 360 and Instant-NGP.
pub(crate) const HOLD_OUT: usize = 8;

/// Splits and the keys of their lists.
const LISTS: [(&str, &str); 3] =
    [("train", "train_filenames"), ("val", "val_filenames"), ("test", "test_filenames")];

/// The frames of a file that belong to a split.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Selection {
    All,
    Train,
    Test,
    /// The frames of a list, and the number of frames in no list.
    Listed(Vec<usize>, usize),
}

impl Selection {
    /// Returns the indices of the chosen frames, in order, of `frames` frames.
    pub(crate) fn choose(&self, frames: usize) -> Vec<usize> {
        match self {
            Self::All => (0..frames).collect(),
            Self::Test => (0..frames).filter(|index| index.is_multiple_of(HOLD_OUT)).collect(),
            Self::Train => (0..frames).filter(|index| !index.is_multiple_of(HOLD_OUT)).collect(),
            Self::Listed(frames, _) => frames.clone(),
        }
    }

    /// Returns a line for the scene's description about how the frames were divided; `order` says how they are ordered.
    pub(crate) fn note(&self, file: &Path, order: &str) -> Option<String> {
        let name = file.file_name().unwrap_or(file.as_os_str()).to_string_lossy();
        matches!(self, Self::Train | Self::Test).then(|| {
            format!("{name} names no splits: every {HOLD_OUT}th frame {order} is the test split, the others are train")
        })
    }

    /// Returns a warning about frames that are in no list.
    pub(crate) fn warning(&self, file: &Path) -> Option<String> {
        match self {
            Self::Listed(_, left) if *left > 0 => {
                Some(format!("{} lists {} in no split", file.display(), count(*left, "frame")))
            }
            _ => None,
        }
    }
}

/// Returns the splits that a file lists.
pub(crate) fn listed(file: &Node<'_>) -> Vec<&'static str> {
    LISTS.iter().filter(|(_, key)| file.get(key).is_some()).map(|(split, _)| *split).collect()
}

/// Selects the frames of a split: by its list if the file has lists, otherwise by index.
pub(crate) fn divide(path: &Path, file: &Node<'_>, entries: &[Value], split: &str) -> Result<Selection> {
    let lists = listed(file);
    if lists.is_empty() {
        return match split {
            "train" => Ok(Selection::Train),
            "test" => Ok(Selection::Test),
            _ => Err(unknown(path, split, "train, test")),
        };
    }
    if !lists.contains(&split) {
        return Err(unknown(path, split, &lists.join(", ")));
    }
    let name = |entry: &Value| entry.get("file_path").and_then(Value::as_str).unwrap_or_default().to_string();
    let index = Index::new(entries.iter().map(name));
    let mut owners: Vec<Option<&str>> = vec![None; entries.len()];
    for (own, key) in LISTS.iter().filter(|(own, _)| lists.contains(own)) {
        for value in file.array(key)? {
            let named = value.as_str().ok_or_else(|| file.unexpected(key, "an array of texts", value))?;
            let wrong = |what: String| {
                let place = Place::part(path, format_args!("\"{key}\": {named}"));
                Error::input(place, what, "correct the list or export it again")
            };
            let frame = match index.find(named) {
                Match::One(frame) => frame,
                Match::None => return Err(wrong("is no frame of the file".into())),
                Match::Several => return Err(wrong("matches several frames of the file".into())),
            };
            match owners[frame].replace(own) {
                Some(other) if other == *own => return Err(wrong("is in the list twice".into())),
                Some(other) => return Err(wrong(format!("is in the split \"{other}\" too"))),
                None => {}
            }
        }
    }
    let frames = (0..entries.len()).filter(|&frame| owners[frame] == Some(split)).collect();
    Ok(Selection::Listed(frames, owners.iter().filter(|owner| owner.is_none()).count()))
}

/// Returns the error for a split that does not exist.
pub(crate) fn unknown(place: &Path, split: &str, known: &str) -> Error {
    Error::input(
        place.display(),
        format!("has no split \"{split}\", only {known}"),
        "choose one of them for data.train and data.test",
    )
}

/// Returns the error for a split without frames.
pub(crate) fn empty(place: &Path, split: &str, frames: usize, selection: &Selection) -> Error {
    let advice = match selection {
        Selection::All => "export the frames again",
        Selection::Train | Selection::Test => "add frames: at least two are needed",
        Selection::Listed(..) => "add frames to its list",
    };
    Error::input(place.display(), format!("has no frame for split \"{split}\" among its {frames}"), advice)
}
