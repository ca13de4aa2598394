//! The programs `colmap`, of any version since 3.6, and `glomap`. Option names differ between versions; this module uses those that the
//! program's help lists.

use crate::{
    decisions::{Cameras, Decisions, Pairs},
    folder::Folder,
    process::{Call, ask},
    programs,
};
use std::{
    collections::BTreeSet,
    ffi::OsString,
    path::{Path, PathBuf},
};

/// An option: its names in different versions, and its value. The first name that the program has is used.
type Choice = (&'static [&'static str], OsString);

/// The program `colmap`.
pub struct Colmap {
    program: PathBuf,
    /// Name and version, such as `colmap 3.8`.
    pub version: String,
    /// True if it is built with CUDA.
    pub has_cuda: bool,
    /// True if it has a global mapper, which places all cameras at once.
    pub has_global: bool,
}

impl Colmap {
    /// Finds the program, if it is on the path and runs.
    pub fn find() -> Option<Self> {
        let program = programs::find("colmap")?;
        let help = ask(&program, &["help"])?;
        let first = help.lines().find(|line| line.contains("COLMAP")).unwrap_or_default();
        let version = first.split("COLMAP").nth(1).and_then(|rest| rest.split_whitespace().next());
        let version = format!("colmap {}", version.unwrap_or("of an unknown version"));
        let has_cuda = help.contains("with CUDA");
        // The help lists one command per line.
        let has_global = help.lines().any(|line| line.trim() == "global_mapper");
        Some(Self { program, version, has_cuda, has_global })
    }

    /// Returns a call of a command. An option may have several names, of which the first that the command has is used. An option that the
    /// command lacks is left out.
    fn call<'a>(&'a self, folder: &'a Folder, log: &str, command: &str, options: &[Choice]) -> Call<'a> {
        let known = self.options_of(command);
        let mut arguments: Vec<OsString> = vec![command.into()];
        for (names, value) in options {
            // These options exist in every version, so they are passed even if the help cannot be parsed.
            let required = names.len() == 1 && names[0].ends_with("_path") && !names[0].contains('.');
            let name = names.iter().find(|name| known.contains(**name) || required);
            if let Some(name) = name {
                arguments.push(format!("--{name}").into());
                arguments.push(value.clone());
            }
        }
        Call {
            name: format!("colmap {command}"),
            program: &self.program,
            arguments,
            // Arguments are paths relative to this folder: the user's own path may contain special characters, these do not.
            folder: folder.root(),
            log: folder.log(log),
        }
    }

    /// Returns the options that the help of a command lists.
    fn options_of(&self, command: &str) -> BTreeSet<String> {
        let help = ask(&self.program, &[command, "--help"]).or_else(|| ask(&self.program, &[command, "-h"]));
        options(&help.unwrap_or_default())
    }

    /// Returns the call that finds features.
    pub fn features<'a>(&'a self, folder: &'a Folder, database: &str, by: &Decisions) -> Call<'a> {
        let flag = |cameras: Cameras| OsString::from(if by.cameras == cameras { "1" } else { "0" });
        let options = vec![
            choice(&["database_path"], database),
            choice(&["image_path"], "images"),
            choice(&["ImageReader.camera_model"], by.camera),
            choice(&["ImageReader.single_camera"], flag(Cameras::One)),
            choice(&["ImageReader.single_camera_per_folder"], flag(Cameras::PerFolder)),
            choice(&["ImageReader.single_camera_per_image"], flag(Cameras::PerImage)),
            choice(&["FeatureExtraction.max_image_size", "SiftExtraction.max_image_size"], number(by.size)),
            choice(&["FeatureExtraction.use_gpu", "SiftExtraction.use_gpu"], u32::from(by.gpu).to_string()),
            choice(&["FeatureExtraction.num_threads", "SiftExtraction.num_threads"], threads(by)),
        ];
        self.call(folder, "features", "feature_extractor", &options)
    }

    /// Returns the call that compares pairs.
    pub fn matches<'a>(&'a self, folder: &'a Folder, database: &str, by: &Decisions) -> Call<'a> {
        let mut options = matching(database, by);
        let command = match &by.pairs {
            Pairs::Exhaustive => "exhaustive_matcher",
            Pairs::Vocabulary { tree } => {
                options.push(choice(&["VocabTreeMatching.vocab_tree_path"], tree));
                "vocab_tree_matcher"
            }
            Pairs::Sequential { overlap, tree, .. } => {
                options.push(choice(&["SequentialMatching.overlap"], number(*overlap)));
                options.push(choice(&["SequentialMatching.quadratic_overlap"], "1"));
                options.push(choice(
                    &["SequentialMatching.loop_detection"],
                    u32::from(tree.is_some()).to_string(),
                ));
                if let Some(tree) = tree {
                    options.push(choice(&["SequentialMatching.vocab_tree_path"], tree));
                }
                "sequential_matcher"
            }
        };
        self.call(folder, "matches", command, &options)
    }

    /// Returns the call that compares the pairs of a list.
    pub fn loops<'a>(&'a self, folder: &'a Folder, database: &str, list: &str, by: &Decisions) -> Call<'a> {
        let mut options = matching(database, by);
        options.push(choice(&["match_list_path"], list));
        options.push(choice(&["match_type"], "pairs"));
        self.call(folder, "loops", "matches_importer", &options)
    }

    /// Returns the call that places cameras.
    pub fn model<'a>(&'a self, folder: &'a Folder, models: &str, by: &Decisions) -> Call<'a> {
        let mut options = vec![
            choice(&["database_path"], "database.db"),
            choice(&["image_path"], "images"),
            choice(&["output_path"], models),
            choice(&["Mapper.num_threads", "GlobalMapper.num_threads"], threads(by)),
        ];
        if !by.distortion {
            options.push(choice(&["Mapper.ba_refine_extra_params"], "0"));
        }
        let command = if by.global { "global_mapper" } else { "mapper" };
        self.call(folder, "model", command, &options)
    }
}

/// Returns the call that places cameras with glomap.
pub fn glomap<'a>(folder: &'a Folder, program: &'a Path, models: &str) -> Call<'a> {
    let call = Call {
        name: "glomap mapper".into(),
        program,
        arguments: Vec::new(),
        folder: folder.root(),
        log: folder.log("model"),
    };
    call.with(["mapper", "--database_path", "database.db", "--image_path", "images", "--output_path", models])
}

/// Returns the options that all matchers share.
fn matching(database: &str, by: &Decisions) -> Vec<Choice> {
    vec![
        choice(&["database_path"], database),
        choice(&["FeatureMatching.use_gpu", "SiftMatching.use_gpu"], u32::from(by.gpu).to_string()),
        choice(&["FeatureMatching.num_threads", "SiftMatching.num_threads"], threads(by)),
    ]
}

fn choice(names: &'static [&'static str], value: impl Into<OsString>) -> Choice {
    (names, value.into())
}

fn number(value: u32) -> OsString {
    value.to_string().into()
}

/// Returns the number of threads; for all threads COLMAP expects −1.
fn threads(by: &Decisions) -> OsString {
    if by.threads == 0 { "-1".into() } else { number(by.threads) }
}

/// Returns the options in a help text: words that begin with two hyphens.
fn options(help: &str) -> BTreeSet<String> {
    let words = help.split(|c: char| c.is_whitespace() || c == '=' || c == '[' || c == ',');
    words
        .filter_map(|word| word.strip_prefix("--"))
        .filter(|word| !word.is_empty())
        .map(String::from)
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_those_of_the_help() {
        let help = "Options:\n  -h [ --help ]\n  --SiftExtraction.use_gpu arg (=1)\n  --match_type arg (=pairs)   {'pairs'}\n";
        let expected = ["SiftExtraction.use_gpu", "help", "match_type"].map(String::from);
        assert_eq!(options(help).into_iter().collect::<Vec<_>>(), expected);
    }
}
