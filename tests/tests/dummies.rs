//! Follows every list of ARCHITECTURE.md for a small new member, a dummy of `tests/dummies`: the files that the dummy adds or changes are
//! those that the list names, and the workspace with all dummies compiles. The folder of a dummy contains whole files under their paths in
//! the workspace, and a `lines.toml` with lines to add to existing files.
//!
//! `cargo test -p trimip-tests --test dummies -- --ignored --nocapture` also runs the suites of the registries over the dummies. It
//! builds the tests a second time, which takes minutes.

use serde::Deserialize;
use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::process::Command;
use trimip_tests::binary::{profile, root, target};
use trimip_tests::lists::{Need, places, section};

/// Kinds of dummies: the folder, the title of the list, and the largest number of files that the list may have.
const KINDS: [(&str, &str, usize); 6] = [
    ("encoder", "Adding an encoder", 21),
    ("loss", "Adding a loss term", 8),
    ("camera", "Adding a camera model", 8),
    ("reader", "Adding a scene reader", 6),
    ("verb", "Adding a verb", 5),
    ("page", "Adding a page", 4),
];

/// Paths below the root that do not belong to the sources.
const LEFT_OUT: [&str; 4] = ["target", "runs", "data", "tests/dummies"];

/// Tests that run over the registries, in addition to those in the crates.
const SUITES: [&str; 8] =
    ["structure", "scenes", "conformance", "gpu", "gpu_and_cpu", "library", "formats", "formats_memory"];

/// Contents of files by path, with slashes.
type Files = BTreeMap<String, Vec<u8>>;

/// A change of a file.
#[derive(Deserialize)]
struct Line {
    file: String,
    #[serde(flatten)]
    place: Place,
    text: String,
}

/// Position of a text in a file. A line is identified by its beginning, without indentation; no other line may begin with the same text.
#[derive(Deserialize)]
#[serde(rename_all = "lowercase")]
enum Place {
    /// On lines of its own, after the line with this beginning.
    After(String),
    /// On lines of its own, before the line with this beginning.
    Before(String),
    /// In place of this text, which the file contains once.
    Replace(String),
}

impl Line {
    /// Returns the text of the file with the change applied. The error names a place that is missing or ambiguous.
    fn apply(&self, text: &str) -> Result<String, String> {
        let at = match &self.place {
            Place::Replace(old) => {
                let start = one(text.match_indices(old).map(|(at, _)| at), old)?;
                return Ok([&text[..start], &self.text, &text[start + old.len()..]].concat());
            }
            Place::After(anchor) => line(text, anchor)?.end,
            Place::Before(anchor) => line(text, anchor)?.start,
        };
        Ok([&text[..at], &self.text, "\n", &text[at..]].concat())
    }
}

/// Returns the byte range of the line that begins with `anchor`.
fn line(text: &str, anchor: &str) -> Result<Range<usize>, String> {
    let mut at = 0;
    let lines = text.split_inclusive('\n').map(|line| {
        at += line.len();
        (line.trim_start(), at - line.len()..at)
    });
    one(lines.filter(|(line, _)| line.starts_with(anchor)).map(|(_, range)| range), anchor)
}

/// Returns the only one of `places`; the error contains `text`.
fn one<T>(mut places: impl Iterator<Item = T>, text: &str) -> Result<T, String> {
    match (places.next(), places.next()) {
        (Some(place), None) => Ok(place),
        (None, _) => Err(format!("there is no `{text}`")),
        (Some(_), Some(_)) => Err(format!("there is more than one `{text}`")),
    }
}

/// Returns the files below a folder of the root, without [`LEFT_OUT`], hidden files, and folders in which cargo builds.
fn files(folder: &str) -> Files {
    let mut found = Files::new();
    for entry in fs::read_dir(root().join(folder)).expect("a folder of the workspace") {
        let entry = entry.expect("an entry");
        let name = entry.file_name().into_string().expect("names of sources are UTF-8");
        let path = if folder.is_empty() { name.clone() } else { format!("{folder}/{name}") };
        if name.starts_with('.') || name == "__pycache__" || LEFT_OUT.contains(&path.as_str()) {
            continue;
        }
        if !entry.path().is_dir() {
            found.insert(path, fs::read(entry.path()).expect("a file of the workspace"));
        } else if !entry.path().join("CACHEDIR.TAG").exists() {
            found.append(&mut files(&path));
        }
    }
    found
}

/// Adds the dummy of a kind. Returns the files that it adds or changes.
fn add(kind: &str, all: &mut Files) -> BTreeSet<String> {
    let folder = format!("tests/dummies/{kind}");
    let mut own = files(&folder);
    let lines = own.remove(&format!("{folder}/lines.toml")).expect("every dummy has lines");
    let mut touched = BTreeSet::new();
    for (path, bytes) in own {
        let path = path[folder.len() + 1..].to_string();
        assert!(all.insert(path.clone(), bytes).is_none(), "{path} is there already");
        touched.insert(path);
    }
    let lines: BTreeMap<String, Vec<Line>> =
        toml::from_slice(&lines).unwrap_or_else(|error| panic!("{folder}/lines.toml: {error}"));
    for line in &lines["line"] {
        let bytes = all.get_mut(&line.file).unwrap_or_else(|| panic!("{kind}: there is no {}", line.file));
        let text = std::str::from_utf8(bytes).expect("a text");
        let text = line.apply(text).unwrap_or_else(|error| panic!("{kind}, {}: {error}", line.file));
        *bytes = text.into_bytes();
        touched.insert(line.file.clone());
    }
    touched
}

/// Returns the files of the workspace with all dummies.
fn with_all() -> Files {
    let mut all = files("");
    KINDS.iter().for_each(|(kind, ..)| drop(add(kind, &mut all)));
    all
}

/// Every file of a dummy is an entry of its list, and every entry that all members need is a file of the dummy.
#[test]
fn lists_name_the_files_of_their_dummies() {
    let all = files("");
    let architecture = String::from_utf8(all["ARCHITECTURE.md"].clone()).expect("a text");
    for (kind, title, most) in KINDS {
        let mut with = all.clone();
        let touched = add(kind, &mut with);
        let places = places(section(&architecture, title), "dummy");
        for file in &touched {
            assert!(places.iter().any(|place| place.holds(file)), "\"{title}\" does not list {file}");
        }
        for place in &places {
            let is_here = |file: &String| place.holds(file);
            match place.need {
                Need::Every => {
                    assert!(touched.iter().any(is_here), "the {kind} has nothing in {}", place.path);
                }
                Need::Written => {
                    assert!(with.keys().any(is_here), "\"{title}\": {} is not there", place.path);
                }
                Need::Some => {}
            }
        }
        let written = places.iter().filter(|place| place.need == Need::Written);
        let count =
            touched.len() + written.filter(|place| !touched.iter().any(|file| place.holds(file))).count();
        println!("{kind}: {count} files");
        assert!(count <= most, "\"{title}\" has {count} files, at most {most} are allowed: {touched:?}");
        let page = format!("](tests/dummies/{kind})");
        assert!(section(&architecture, title).contains(&page), "\"{title}\" does not link to the {kind}");
    }
}

/// A copy of the workspace with all dummies, which cargo builds in the target folder of this test.
struct Workspace {
    folder: PathBuf,
    /// Keeps other tests from using the copy at the same time.
    _lock: File,
}

impl Workspace {
    /// Writes only the files that differ from those of the previous copy, so cargo compiles only what has changed.
    fn new() -> Self {
        let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("dummies");
        fs::create_dir_all(&folder).expect("the target folder can be written");
        let lock = File::create(folder.with_extension("lock")).expect("the target folder can be written");
        lock.lock().expect("a lock of the system");
        let mut all = with_all();
        give_another_version(&mut all);
        remove_others(&folder, &folder, &all);
        for (path, bytes) in &all {
            let path = folder.join(path);
            if fs::read(&path).ok().as_ref() != Some(bytes) {
                fs::create_dir_all(path.parent().expect("a folder")).expect("the copy can be written");
                fs::write(&path, bytes).expect("the copy can be written");
            }
        }
        Self { folder, _lock: lock }
    }

    /// Returns a command that runs cargo in the copy, without a network.
    fn cargo(&self, arguments: &[&str]) -> Command {
        let mut cargo = Command::new(env!("CARGO"));
        cargo.args(arguments).args(["--workspace", "--locked", "--offline", "--profile", &profile()]);
        cargo.arg("--target-dir").arg(target()).current_dir(&self.folder);
        cargo
    }
}

/// Gives the crates of the copy another version. Cargo identifies a crate by its version and its path within the workspace. If the
/// versions were equal, cargo would mistake the copy's crates for those of the workspace, which share the target folder.
fn give_another_version(all: &mut Files) {
    let own = concat!("version = \"", env!("CARGO_PKG_VERSION"), "\"\n");
    let [major, minor] = [env!("CARGO_PKG_VERSION_MAJOR"), env!("CARGO_PKG_VERSION_MINOR")];
    let other = &format!("version = \"{major}.{minor}.9{}\"\n", env!("CARGO_PKG_VERSION_PATCH"));
    let mut replace = |path: &str, before: &str| {
        let bytes = all.get_mut(path).expect("a file of the workspace");
        let text = String::from_utf8_lossy(bytes).into_owned();
        let parts: Vec<&str> = text.split(before).collect();
        let mut whole = parts[0].to_string();
        for part in &parts[1..] {
            // In Cargo.lock a crate's name precedes its version.
            let (name, rest) = part.split_once(own).expect("a version of the workspace");
            whole += &[before, name, other, rest].concat();
        }
        assert!(parts.len() > 1, "{path} has no {before}");
        *bytes = whole.into_bytes();
    };
    replace("Cargo.toml", "[workspace.package]\n");
    replace("Cargo.lock", "name = \"trimip");
}

/// Removes the files below `folder` that the workspace does not have.
fn remove_others(copy: &Path, folder: &Path, all: &Files) {
    for path in fs::read_dir(folder).expect("a folder").map(|entry| entry.expect("an entry").path()) {
        let name = path.strip_prefix(copy).expect("below the copy").to_string_lossy().replace('\\', "/");
        if path.is_dir() {
            remove_others(copy, &path, all);
        } else if !all.contains_key(&name) {
            fs::remove_file(&path).expect("a file of the copy");
        }
    }
}

#[test]
fn the_workspace_compiles_with_all_dummies() {
    let checked =
        Workspace::new().cargo(&["check", "--quiet", "--all-targets"]).output().expect("cargo starts");
    let said = String::from_utf8_lossy(&checked.stderr);
    assert!(checked.status.success() && !said.contains("warning"), "{said}");
}

#[test]
fn dummies_are_formatted() {
    let cargo =
        |arguments: &[&str]| Command::new(env!("CARGO")).args(arguments).output().expect("cargo starts");
    if !cargo(&["fmt", "--version"]).status.success() {
        println!("skipped: there is no rustfmt");
        return;
    }
    let workspace = Workspace::new();
    let manifest = workspace.folder.join("Cargo.toml");
    let manifest = manifest.to_str().expect("a path in UTF-8");
    let output = cargo(&["fmt", "--all", "--check", "--manifest-path", manifest]);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stdout));
}

#[test]
#[ignore = "builds the tests a second time"]
fn the_suites_of_the_registries_hold_for_the_dummies() {
    let workspace = Workspace::new();
    let passes = |command: &mut Command| command.status().is_ok_and(|status| status.success());
    let mut generated = workspace.cargo(&["test", "--lib", "generated"]);
    assert!(passes(generated.env("TRIMIP_WRITE_DOCS", "1")), "the pages are written");
    let suites: Vec<&str> = SUITES.iter().flat_map(|name| ["--test", name]).collect();
    let mut suites = workspace.cargo(&[&["test", "--no-fail-fast", "--lib", "--bins"], &suites[..]].concat());
    assert!(passes(&mut suites), "a suite fails");
    assert!(passes(&mut workspace.cargo(&["test", "--test", "program", "dummy"])), "the program fails");
}

/// Lines are inserted at the places that they state.
#[test]
fn lines_are_put_where_they_say() {
    let apply = |place: &str| {
        let line = format!("file = 'f'\n{place}\ntext = 'x'");
        toml::from_str::<Line>(&line).expect("a line").apply("a b\n  c d\ne\n")
    };
    assert_eq!(apply("after = 'c'").unwrap(), "a b\n  c d\nx\ne\n");
    assert_eq!(apply("before = 'a b'").unwrap(), "x\na b\n  c d\ne\n");
    assert_eq!(apply("replace = 'd'").unwrap(), "a b\n  c x\ne\n");
    for wrong in ["after = 'd'", "before = ''", "replace = ' '", "replace = 'y'"] {
        assert!(apply(wrong).is_err(), "{wrong}");
    }
}
