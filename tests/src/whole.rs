//! Checks of a run that was interrupted and continued: it has everything that an uninterrupted run has, and nothing else.

use crate::files::files;
use serde_json::Value;
use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};
use trimip_core::engine::{checkpoint::Checkpoint, events::Event};

/// The files of an uninterrupted run.
pub struct Whole {
    files: BTreeMap<PathBuf, Vec<u8>>,
}

impl Whole {
    /// Reads the folder of a finished run.
    pub fn of(folder: &Path) -> Self {
        let whole = Self { files: files(folder) };
        assert_eq!(whole.is_ended_by(folder), Ok(()), "the run itself");
        whole
    }

    /// Checks that an interrupted and continued run has the same files as this one, bit for bit except for times, and a complete
    /// report.
    ///
    /// # Errors
    /// The first difference.
    pub fn is_ended_by(&self, folder: &Path) -> Result<(), String> {
        let found = files(folder);
        let names = |files: &BTreeMap<PathBuf, Vec<u8>>| files.keys().cloned().collect::<Vec<_>>();
        if names(&found) != names(&self.files) {
            return Err(format!("has {:?}, expected {:?}", names(&found), names(&self.files)));
        }
        let same = |name: &Path| found[name] == self.files[name];
        let timeless = |name: &&PathBuf| {
            name.starts_with("images") || TIMELESS.iter().any(|other| name.ends_with(other))
        };
        if let Some(name) = found.keys().filter(timeless).find(|name| !same(name)) {
            return Err(format!("{} differs", name.display()));
        }
        let curve =
            |files: &BTreeMap<PathBuf, Vec<u8>>| timeless_curve(&files[Path::new("error_vs_time.csv")]);
        if curve(&found) != curve(&self.files) {
            return Err(format!("the curve is {:?}, expected {:?}", curve(&found), curve(&self.files)));
        }
        let report: Value =
            serde_json::from_slice(&found[Path::new("report.json")]).map_err(|error| error.to_string())?;
        if report["status"] != "finished" || report["measure"]["complete"] != true {
            return Err(format!("the report says {} of a finished run", report["status"]));
        }
        let page = String::from_utf8_lossy(&found[Path::new("report.html")]);
        if !page.trim_end().ends_with("</html>") || !page.contains(">finished</b>") {
            return Err("the page is not that of a finished run".into());
        }
        is_sound(folder)
    }
}

/// Files that contain no time.
const TIMELESS: [&str; 4] = ["model.safetensors", "views.json", "config.toml", "plan.json"];

/// Returns the lines of a curve without seconds, samples and rays. A device that runs ahead reports these counts a step later, or
/// at once if a checkpoint waits for them.
fn timeless_curve(csv: &[u8]) -> Vec<String> {
    let text = String::from_utf8_lossy(csv);
    let kept = |line: &str| {
        let cells = line.split(',').enumerate().filter(|(column, _)| ![0, 2, 3].contains(column));
        cells.map(|(_, cell)| cell).collect::<Vec<_>>().join(",")
    };
    text.lines().map(kept).collect()
}

/// Checks that every file in a run folder is whole, however the run was interrupted. The last line of the events may be
/// torn, and a half-written `.tmp` file may remain.
///
/// # Errors
/// The broken file and its error.
pub fn is_sound(folder: &Path) -> Result<(), String> {
    for (name, bytes) in files(folder) {
        let sound = match name.to_string_lossy().as_ref() {
            "checkpoint.safetensors" => {
                Checkpoint::read(&folder.join(&name)).map(drop).map_err(|error| error.message())
            }
            "model.safetensors" => trimip_core::field::model::Model::read(&folder.join(&name))
                .map(drop)
                .map_err(|error| error.message()),
            "metrics.jsonl" => {
                let text = String::from_utf8_lossy(&bytes);
                let whole = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
                whole
                    .lines()
                    .try_for_each(|line| serde_json::from_str::<Event>(line).map(drop))
                    .map_err(|e| e.to_string())
            }
            json if json.ends_with(".json") => {
                serde_json::from_slice::<Value>(&bytes).map(drop).map_err(|error| error.to_string())
            }
            png if png.ends_with(".png") && !bytes.ends_with(b"IEND\xaeB`\x82") => Err("is torn".into()),
            _ => Ok(()),
        };
        sound.map_err(|error| format!("{}: {error}", name.display()))?;
    }
    Ok(())
}
