//! The Python package `pycolmap`, which a script next to the logs calls.

use crate::{
    decisions::{Cameras, Decisions, Pairs},
    folder::{Folder, unwritable},
    process::{Call, ask},
    programs,
};
use serde_json::{Value, json};
use std::path::PathBuf;
use trimip::Result;
use trimip_core::atomic::write_atomically;

/// Names of the Python interpreter on the path, in the order in which they are tried.
const NAMES: [&str; 10] = [
    "python3",
    "python",
    "python3.14",
    "python3.13",
    "python3.12",
    "python3.11",
    "python3.10",
    "python3.9",
    "python3.8",
    "py",
];

/// Python program that prints the version and abilities of the package.
const QUESTION: &str = "import pycolmap\n\
                        print('pycolmap', pycolmap.__version__, bool(getattr(pycolmap, 'has_cuda', False)), \
                        hasattr(pycolmap, 'global_mapping'))";

/// Script that calls the package.
const SCRIPT: &str = include_str!("poses.py");

/// A Python interpreter that has the package.
pub struct Python {
    program: PathBuf,
    /// Name and version, such as `pycolmap 4.0.2`.
    pub version: String,
    /// True if it is built with CUDA.
    pub has_cuda: bool,
    /// True if it has a global mapper, which places all cameras at once.
    pub has_global: bool,
}

impl Python {
    /// Finds the first Python interpreter on the path that has the package.
    pub fn find() -> Option<Self> {
        NAMES.iter().filter_map(|name| programs::find(name)).find_map(|program| {
            let answer = ask(&program, &["-c", QUESTION])?;
            let line = answer.lines().find(|line| line.starts_with("pycolmap "))?;
            let words: Vec<&str> = line.split_whitespace().collect();
            let [name, version, has_cuda, has_global] = words[..] else { return None };
            let (has_cuda, has_global) = (has_cuda == "True", has_global == "True");
            Some(Self { program, version: format!("{name} {version}"), has_cuda, has_global })
        })
    }

    /// Writes the script and returns the call of a stage.
    fn call<'a>(&'a self, folder: &'a Folder, log: &str, stage: &str, options: Value) -> Result<Call<'a>> {
        let path = folder.path("log/poses.py");
        if let Some(parent) = path.parent() {
            std::fs::create_dir_all(parent).map_err(|error| unwritable(parent, &error))?;
        }
        write_atomically(&path, SCRIPT.as_bytes())?;
        let call = Call {
            name: "pycolmap".into(),
            program: &self.program,
            arguments: Vec::new(),
            folder: folder.root(),
            log: folder.log(log),
        };
        Ok(call.with(["log/poses.py", stage, &options.to_string()]))
    }

    /// Returns the call that finds features.
    pub fn features<'a>(&'a self, folder: &'a Folder, database: &str, by: &Decisions) -> Result<Call<'a>> {
        let mode = match by.cameras {
            Cameras::One => "SINGLE",
            Cameras::PerFolder => "PER_FOLDER",
            Cameras::PerImage => "PER_IMAGE",
        };
        let mut options = common(database, by);
        options["images"] = "images".into();
        options["camera_model"] = by.camera.into();
        options["camera_mode"] = mode.into();
        options["max_image_size"] = by.size.into();
        self.call(folder, "features", "features", options)
    }

    /// Returns the call that compares pairs.
    pub fn matches<'a>(&'a self, folder: &'a Folder, database: &str, by: &Decisions) -> Result<Call<'a>> {
        let mut options = common(database, by);
        let stage = match &by.pairs {
            Pairs::Exhaustive => "exhaustive",
            Pairs::Vocabulary { tree } => {
                options["vocab_tree"] = json!(tree);
                "vocabulary"
            }
            Pairs::Sequential { overlap, tree, .. } => {
                options["overlap"] = json!(overlap);
                options["vocab_tree"] = json!(tree);
                "sequential"
            }
        };
        self.call(folder, "matches", stage, options)
    }

    /// Returns the call that compares the pairs of a list.
    pub fn loops<'a>(
        &'a self,
        folder: &'a Folder,
        database: &str,
        list: &str,
        by: &Decisions,
    ) -> Result<Call<'a>> {
        let mut options = common(database, by);
        options["list"] = list.into();
        self.call(folder, "loops", "pairs", options)
    }

    /// Returns the call that places cameras.
    pub fn model<'a>(&'a self, folder: &'a Folder, models: &str, by: &Decisions) -> Result<Call<'a>> {
        let mut options = common("database.db", by);
        options["images"] = "images".into();
        options["models"] = models.into();
        options["distortion"] = by.distortion.into();
        self.call(folder, "model", if by.global { "global" } else { "incremental" }, options)
    }
}

fn common(database: &str, by: &Decisions) -> Value {
    // For all threads, pycolmap expects −1.
    let threads = if by.threads == 0 { -1 } else { i64::from(by.threads) };
    json!({ "database": database, "gpu": by.gpu, "threads": threads })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_script_has_every_stage() {
        for stage in ["features", "exhaustive", "sequential", "vocabulary", "pairs", "incremental", "global"]
        {
            assert!(SCRIPT.contains(&format!("    \"{stage}\": {stage}")), "{stage}");
        }
    }
}
