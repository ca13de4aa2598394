//! Checks of the structure of the workspace: rings of files that import each other are small, the rooms of `trimip-core` depend
//! on each other in one direction, no file is too long to read, and the lists of ARCHITECTURE.md are complete.
//!
//! `cargo test -p trimip-tests --test structure -- --nocapture` prints every ring.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::{Path, PathBuf};
use syn::visit_mut::{self, VisitMut};
use syn::{Attribute, File, Item, ItemMod, ItemUse, UseTree, Visibility};
use trimip_tests::lists::{places, section};

/// Path of a module within its crate, or of an item, as a list of names.
type Names = Vec<String>;

/// Number of files in the largest ring that each crate may have.
const LARGEST_RINGS: [(&str, usize); 13] = [
    ("trimip", 1),
    ("trimip-cli", 2),
    // The device, its stages and the batches between them import each other.
    ("trimip-core", 3),
    ("trimip-cpu", 2),
    ("trimip-data", 1),
    ("trimip-mpi", 1),
    ("trimip-python", 1),
    ("trimip-report", 1),
    ("trimip-capture", 1),
    ("trimip-view", 1),
    ("trimip-web", 1),
    ("trimip-wgpu", 2),
    ("tests", 2),
];

/// Largest number of lines that a file may have.
const LONGEST_FILE: usize = 621;

/// The rooms of `trimip-core`, which are its top-level modules. A room may use only the rooms before it.
const ROOMS: [&str; 9] =
    ["config", "math", "geometry", "scene", "field", "measures", "engine", "run", "scene_plan"];

/// The sections of ARCHITECTURE.md that list the files of a new member of a registry. Each comes with an existing member, and
/// with the words by which files name that member.
const LISTS: [(&str, &str, &[&str]); 6] = [
    ("Adding an encoder", "voxels", &["voxels", "Voxels", "VoxelsConfig"]),
    ("Adding a loss term", "charbonnier", &["charbonnier", "Charbonnier"]),
    ("Adding a camera model", "orthographic", &["orthographic", "Orthographic"]),
    ("Adding a scene reader", "llff", &["llff"]),
    ("Adding a verb", "doctor", &["doctor", "Doctor"]),
    // Pages have no registry, so the test only checks that the files exist.
    ("Adding a page", "", &[]),
];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace").into()
}

/// Returns all files below `folder` with one of the given endings.
fn files(folder: &Path, endings: &[&str]) -> Vec<PathBuf> {
    let mut found = Vec::new();
    for entry in
        fs::read_dir(folder).expect("a folder of the workspace").map(|entry| entry.expect("an entry").path())
    {
        if entry.is_dir() {
            found.extend(files(&entry, endings));
        } else if entry.extension().is_some_and(|extension| endings.iter().any(|ending| extension == *ending))
        {
            found.push(entry);
        }
    }
    found.sort();
    found
}

/// Returns all Rust files below `folder`.
fn rust_files(folder: &Path) -> Vec<PathBuf> {
    files(folder, &["rs"])
}

/// The modules of a crate, one per file, and their re-exports.
struct Crate {
    modules: BTreeMap<Names, File>,
    /// Items that each module re-exports with `pub use`: name → path of the item.
    exports: BTreeMap<Names, BTreeMap<String, Names>>,
}

impl Crate {
    fn read(source: &Path) -> Self {
        let mut modules = BTreeMap::new();
        for path in rust_files(source) {
            let relative = path.strip_prefix(source).expect("below the source").with_extension("");
            let mut names: Names = relative.iter().map(|name| name.to_string_lossy().into_owned()).collect();
            if names.last().is_some_and(|name| ["lib", "main", "mod"].contains(&name.as_str())) {
                names.pop();
            }
            let text = fs::read_to_string(&path).expect("a source file");
            modules.insert(
                names,
                syn::parse_file(&text).unwrap_or_else(|error| panic!("{}: {error}", path.display())),
            );
        }
        let mut crate_ = Self { modules, exports: BTreeMap::new() };
        crate_.exports = crate_
            .modules
            .iter()
            .map(|(module, file)| (module.clone(), crate_.exports_of(module, file)))
            .collect();
        crate_
    }

    fn exports_of(&self, module: &Names, file: &File) -> BTreeMap<String, Names> {
        let mut exports = BTreeMap::new();
        for item in &file.items {
            let Item::Use(item) = item else { continue };
            if matches!(item.vis, Visibility::Inherited) {
                continue;
            }
            for path in leaves(&item.tree) {
                if let (Some(name), Some(path)) = (path.last().cloned(), self.absolute(module, &path)) {
                    exports.insert(name, path);
                }
            }
        }
        exports
    }

    /// Resolves a path that is written in `module` to a path from the crate's root; `None` if it leads out of the crate.
    fn absolute(&self, module: &Names, path: &[String]) -> Option<Names> {
        let mut base = module.clone();
        let mut rest = path;
        match rest.first()?.as_str() {
            "crate" => (base, rest) = (Names::new(), &rest[1..]),
            "self" => rest = &rest[1..],
            "super" => {
                while rest.first().is_some_and(|name| name == "super") {
                    base.pop();
                    rest = &rest[1..];
                }
            }
            name => {
                let child: Names = base.iter().cloned().chain([name.to_string()]).collect();
                if !self.modules.contains_key(&child) {
                    return None;
                }
            }
        }
        Some(base.into_iter().chain(rest.iter().cloned()).collect())
    }

    /// Returns the module that defines the item at `path`, following re-exports.
    fn defining(&self, path: &[String], depth: usize) -> Option<Names> {
        for length in (0..=path.len()).rev() {
            let module = path[..length].to_vec();
            if !self.modules.contains_key(&module) {
                continue;
            }
            let exported = path.get(length).and_then(|name| self.exports.get(&module)?.get(name));
            return match exported {
                Some(target) if depth < 8 && target[..] != path[..=length] => {
                    let whole: Names = target.iter().chain(&path[length + 1..]).cloned().collect();
                    self.defining(&whole, depth + 1)
                }
                _ => Some(module),
            };
        }
        None
    }

    /// Returns the modules that each module imports, except in its tests.
    fn imports(&self) -> BTreeMap<Names, BTreeSet<Names>> {
        let of = |(module, file): (&Names, &File)| {
            let mut paths = Paths::default();
            paths.visit_file_mut(&mut file.clone());
            let found = paths.0.iter().filter_map(|path| self.defining(&self.absolute(module, path)?, 0));
            // The root only declares modules and re-exports what they define.
            (module.clone(), found.filter(|other| other != module && !other.is_empty()).collect())
        };
        self.modules
            .iter()
            .filter(|(module, _)| module.last().is_none_or(|name| name != "tests"))
            .map(of)
            .collect()
    }
}

/// The paths that a file names, except in `#[cfg(test)]` modules.
#[derive(Default)]
struct Paths(Vec<Names>);

fn is_test(attributes: &[Attribute]) -> bool {
    attributes.iter().any(|attribute| {
        attribute.path().is_ident("cfg")
            && attribute.parse_args::<syn::Ident>().is_ok_and(|name| name == "test")
    })
}

impl VisitMut for Paths {
    fn visit_item_mod_mut(&mut self, item: &mut ItemMod) {
        if !is_test(&item.attrs) {
            visit_mut::visit_item_mod_mut(self, item);
        }
    }

    fn visit_item_use_mut(&mut self, item: &mut ItemUse) {
        self.0.extend(leaves(&item.tree));
    }

    fn visit_path_mut(&mut self, path: &mut syn::Path) {
        let names: Names = path.segments.iter().map(|segment| segment.ident.to_string()).collect();
        if names.len() > 1 {
            self.0.push(names);
        }
        visit_mut::visit_path_mut(self, path);
    }
}

/// Returns every path of a `use`.
fn leaves(tree: &UseTree) -> Vec<Names> {
    let below = |name: String, rest: Vec<Names>| {
        rest.into_iter().map(|path| [vec![name.clone()], path].concat()).collect()
    };
    match tree {
        UseTree::Path(path) => below(path.ident.to_string(), leaves(&path.tree)),
        UseTree::Name(name) if name.ident == "self" => vec![Names::new()],
        UseTree::Name(name) => vec![vec![name.ident.to_string()]],
        UseTree::Rename(rename) => vec![vec![rename.ident.to_string()]],
        UseTree::Glob(_) => vec![Names::new()],
        UseTree::Group(group) => group.items.iter().flat_map(leaves).collect(),
    }
}

/// Returns the rings of a graph, largest first: its strongly connected components of two or more nodes (Tarjan 1972), found by
/// reachability, because the graphs are small.
fn rings<T: Ord + Clone>(graph: &BTreeMap<T, BTreeSet<T>>) -> Vec<BTreeSet<T>> {
    let reach = |from: &T| {
        let (mut found, mut next) = (BTreeSet::new(), vec![from]);
        while let Some(node) = next.pop() {
            for other in graph.get(node).into_iter().flatten() {
                if found.insert(other.clone()) {
                    next.push(other);
                }
            }
        }
        found
    };
    let reached: BTreeMap<&T, BTreeSet<T>> = graph.keys().map(|node| (node, reach(node))).collect();
    let mut rings = BTreeSet::new();
    for (node, own) in &reached {
        if own.contains(node) {
            rings.insert(
                own.iter()
                    .filter(|other| reached.get(other).is_some_and(|back| back.contains(node)))
                    .cloned()
                    .collect(),
            );
        }
    }
    let mut rings: Vec<BTreeSet<T>> = rings.into_iter().collect();
    rings.sort_by_key(|ring| std::cmp::Reverse(ring.len()));
    rings
}

#[test]
fn rings_of_files_that_import_each_other_are_small() {
    for (name, most) in LARGEST_RINGS {
        let rings = rings(&Crate::read(&root().join(name).join("src")).imports());
        for ring in &rings {
            let files: Vec<String> = ring.iter().map(|module| module.join("::")).collect();
            println!("{name}: {} files import each other: {}", files.len(), files.join(", "));
        }
        let largest = rings.first().map_or(1, BTreeSet::len);
        assert!(
            largest <= most,
            "{name}: a ring of {largest} files, at most {most} are allowed; see the output above"
        );
    }
}

/// Checks [`rings`] on a graph whose rings are known.
#[test]
fn rings_are_found() {
    let graph = BTreeMap::from([
        ("a", BTreeSet::from(["b"])),
        ("b", BTreeSet::from(["c"])),
        ("c", BTreeSet::from(["a", "d"])),
        ("d", BTreeSet::from(["e"])),
        ("e", BTreeSet::new()),
        ("f", BTreeSet::from(["g"])),
        ("g", BTreeSet::from(["f", "a"])),
    ]);
    assert_eq!(rings(&graph), [BTreeSet::from(["a", "b", "c"]), BTreeSet::from(["f", "g"])]);
}

#[test]
fn files_are_short() {
    let mut lengths: Vec<(usize, PathBuf)> = Vec::new();
    for (name, _) in LARGEST_RINGS {
        for path in rust_files(&root().join(name)) {
            lengths.push((fs::read_to_string(&path).expect("a source file").lines().count(), path));
        }
    }
    lengths.sort();
    let (longest, path) = lengths.last().expect("files");
    println!("{} files, median {} lines, longest {longest}", lengths.len(), lengths[lengths.len() / 2].0);
    assert!(
        *longest <= LONGEST_FILE,
        "{} has {longest} lines, at most {LONGEST_FILE} are allowed",
        path.display()
    );
}

/// Every file of `tests/tests` is a test target of Cargo or a module of one, so none is forgotten.
#[test]
fn every_file_of_tests_is_run() {
    let manifest = fs::read_to_string(root().join("tests/Cargo.toml")).expect("a manifest");
    let manifest: toml::Table = toml::from_str(&manifest).expect("TOML");
    let tests = manifest["test"].as_array().expect("tests");
    let mut run: BTreeSet<String> =
        tests.iter().map(|test| test["name"].as_str().expect("a name").to_string()).collect();
    for name in ["library", "program"] {
        let text = fs::read_to_string(root().join(format!("tests/tests/{name}.rs"))).expect("a source file");
        let modules = text.lines().filter_map(|line| line.strip_prefix("mod ")?.strip_suffix(';'));
        run.extend(modules.map(str::to_string));
    }
    let name = |entry: std::io::Result<fs::DirEntry>| entry.expect("an entry").path();
    let there = fs::read_dir(root().join("tests/tests")).expect("a folder").map(name);
    let there: BTreeSet<String> = there
        .filter(|path| path.extension().is_some_and(|extension| extension == "rs"))
        .map(|path| path.file_stem().expect("a name").to_string_lossy().into_owned())
        .collect();
    assert_eq!(there, run);
}

#[test]
fn rooms_of_core_use_those_before_them() {
    let imports = Crate::read(&root().join("trimip-core/src")).imports();
    let place =
        |module: &Names| ROOMS.iter().position(|room| module.first().is_some_and(|name| name == room));
    let mut upward = Vec::new();
    for (module, others) in &imports {
        for other in others {
            if let (Some(own), Some(used)) = (place(module), place(other))
                && used > own
            {
                upward.push(format!("{} uses {}", module.join("::"), other.join("::")));
            }
        }
    }
    assert!(upward.is_empty(), "rooms use later ones: {upward:?}");
    let rooms = imports.keys().filter_map(place).collect::<BTreeSet<_>>();
    assert_eq!(rooms.len(), ROOMS.len(), "every room has files");
}

/// Returns true if `text` contains `word` with no letter or digit next to it.
fn names(text: &str, word: &str) -> bool {
    let part = |character: Option<char>| character.is_some_and(char::is_alphanumeric);
    text.match_indices(word)
        .any(|(at, _)| !part(text[..at].chars().next_back()) && !part(text[at + word.len()..].chars().next()))
}

/// Returns a source without its tests and comments.
fn code(text: &str) -> String {
    let text = text.find("#[cfg(test)]\nmod tests").map_or(text, |at| &text[..at]);
    let lines = text.lines().map(|line| line.split(" # ").next().unwrap_or(line).trim_start());
    // The meaning of a setting is prose, at the end of its line.
    let lines = lines.map(|line| line.split(" meaning = ").next().unwrap_or(line));
    let lines = lines.filter(|line| !line.starts_with("//") && !line.starts_with('#'));
    lines.map(|line| line.to_string() + "\n").collect()
}

/// For an existing member, each list names every file that mentions the member, and no file that does not exist.
#[test]
fn lists_of_files_are_complete() {
    let architecture = fs::read_to_string(root().join("ARCHITECTURE.md")).expect("ARCHITECTURE.md");
    let crates = LARGEST_RINGS.iter().map(|(name, _)| *name).filter(|name| *name != "tests");
    let sources = crates.flat_map(|name| files(&root().join(name).join("src"), &["rs", "wgsl", "toml"]));
    let sources: Vec<(String, String)> = sources
        .map(|path| {
            let name = path.strip_prefix(root()).expect("below the root").to_string_lossy().into_owned();
            (name, code(&fs::read_to_string(&path).expect("a source file")))
        })
        .collect();
    for (title, member, words) in LISTS {
        let listed = places(section(&architecture, title), member);
        let is_listed = |name: &str| listed.iter().any(|place| place.holds(name));
        let named = sources.iter().filter(|(_, text)| words.iter().any(|word| names(text, word)));
        let missing: Vec<&str> =
            named.map(|(name, _)| name.as_str()).filter(|name| !is_listed(name)).collect();
        println!("{title}: {} files are listed", listed.len());
        assert!(missing.is_empty(), "\"{title}\" does not list {missing:?}, which name {member}");
        let gone: Vec<&str> = listed
            .iter()
            .map(|place| place.path.as_str())
            .filter(|path| !root().join(path).exists())
            .collect();
        assert!(gone.is_empty(), "\"{title}\" lists {gone:?}, which do not exist");
    }
}
