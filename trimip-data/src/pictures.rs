//! Finds the photographs of a scene. The path in an entry is often that of another machine, has another ending (`.jpg`
//! for `.JPG`), or names a folder that exists only as a reduced copy (`images` for `images_4`).

use crate::{foreign, names};
use std::{
    collections::{HashMap, HashSet},
    path::{Path, PathBuf},
    sync::OnceLock,
};
use trimip_core::{Error, Place, Result, plural::count};

/// Number of levels below the scene's folder that are searched for photographs, and most files.
const MOST_DEPTH: usize = 5;
const MOST_FILES: usize = 200_000;

/// Beginnings of the names of folders whose pictures are no photographs.
const OTHERS: [&str; 7] = ["mask", "depth", "normal", "semantic", "segment", "confidence", "."];

/// Names of folders of splits: a photograph of one split never replaces a photograph of another.
const SPLITS: [&str; 5] = ["train", "val", "valid", "test", "eval"];

/// The usual folders of photographs.
const USUAL: [&str; 7] = ["images", "image", "rgb", "input", "frames", "photos", "color"];

/// The photographs of a scene.
pub(crate) struct Pictures {
    /// The folder to which the paths of entries are relative.
    folder: PathBuf,
    /// The folder that is searched for photographs that `folder` does not have.
    root: PathBuf,
    /// All pictures below `root`, listed as soon as a photograph is not where its entry says.
    listed: OnceLock<List>,
}

/// The pictures below a folder.
#[derive(Default)]
struct List {
    /// Pictures by their stems in lower case, each list sorted.
    by_stem: HashMap<String, Vec<Picture>>,
    /// Names of the folders that hold them, in lower case.
    folders: HashSet<String>,
}

/// A picture below the folder.
struct Picture {
    path: PathBuf,
    /// Names of the folders between the scene's folder and the picture, in lower case.
    folders: Vec<String>,
}

/// Where a photograph was found.
#[derive(Debug, PartialEq)]
pub(crate) struct Location {
    pub(crate) path: PathBuf,
    /// True if it is not where its entry says.
    pub(crate) moved: bool,
}

impl Pictures {
    /// Searches the pictures below a folder, to which the paths of entries are relative.
    pub(crate) fn new(root: impl Into<PathBuf>) -> Self {
        let root = root.into();
        Self { folder: root.clone(), root, listed: OnceLock::new() }
    }

    /// Searches the pictures below `root`; the paths of entries are relative to `folder`.
    pub(crate) fn named_from(folder: &Path, root: &Path) -> Self {
        Self { folder: folder.into(), ..Self::new(root) }
    }

    /// Finds the photograph that an entry names: as written, with one of the usual endings added, or with forward
    /// slashes. Otherwise returns the only picture that the entry may mean: its name differs only in the ending and the
    /// case of letters, and its folder has the same name, or another name if neither folder is that of a split.
    ///
    /// # Errors
    /// Of kind `Input`, at `place`: the photograph does not exist, several pictures may be meant, or its format is not read.
    pub(crate) fn find(&self, named: &str, place: &Place) -> Result<Location> {
        let turned = named.replace('\\', "/");
        let written = if turned == named { vec![named] } else { vec![named, &turned] };
        let candidates: Vec<PathBuf> = written
            .iter()
            .flat_map(|named| {
                let endings = [""].into_iter().chain(names::ENDINGS);
                endings.map(move |ending| self.folder.join(format!("{named}{ending}")))
            })
            .collect();
        if let Some(path) = candidates.iter().find(|path| path.is_file()) {
            return Ok(Location { path: path.clone(), moved: false });
        }
        match self.elsewhere(&turned).as_slice() {
            [] => Err(missing(named, &candidates, place)),
            [path] => Ok(Location { path: path.to_path_buf(), moved: true }),
            several => {
                let told: Vec<String> = several.iter().map(|path| path.display().to_string()).collect();
                let what = format!(
                    "image {} does not exist, and {} may be meant: {}",
                    candidates[0].display(),
                    count(several.len(), "picture"),
                    told[..told.len().min(3)].join(", ")
                );
                Err(Error::input(place, what, "name one of them, or keep only the one that is meant"))
            }
        }
    }

    /// Returns the pictures that an entry may mean if there is no file at its path `named`, which has forward slashes.
    fn elsewhere(&self, named: &str) -> Vec<&Path> {
        let mut parts: Vec<String> = named
            .split('/')
            .filter(|part| !part.is_empty() && *part != "." && *part != "..")
            .map(str::to_lowercase)
            .collect();
        let Some(file) = parts.pop() else { return Vec::new() };
        let listed = self.listed.get_or_init(|| list(&self.root));
        let Some(alike) = listed.by_stem.get(&names::key(&file)) else { return Vec::new() };
        // Number of folders that agree, counted back from the name.
        let agreeing = |picture: &Picture| {
            parts.iter().rev().zip(picture.folders.iter().rev()).take_while(|(a, b)| a == b).count()
        };
        let most = alike.iter().map(agreeing).max().unwrap_or(0);
        let mut meant: Vec<&Picture> = alike.iter().filter(|picture| agreeing(picture) == most).collect();
        if most == 0 {
            let folder = parts.last().map_or("", String::as_str);
            // The named folder holds pictures, but not this one.
            if listed.folders.contains(folder) {
                return Vec::new();
            }
            let of_split = |name: &str| SPLITS.contains(&name);
            meant.retain(|picture| {
                let own = picture.folders.last().map_or("", String::as_str);
                !(of_split(folder) || of_split(own))
            });
            // Among reduced copies (`images_2`, `images_4`), the largest is taken.
            let reduction = |picture: &Picture| {
                picture.folders.last()?.strip_prefix(folder)?.strip_prefix('_')?.parse::<u32>().ok()
            };
            let usual =
                |picture: &Picture| picture.folders.last().is_none_or(|own| USUAL.contains(&own.as_str()));
            if let Some(least) = meant.iter().filter_map(|picture| reduction(picture)).min() {
                meant.retain(|picture| reduction(picture) == Some(least));
            } else if meant.iter().any(|picture| usual(picture)) {
                meant.retain(|picture| usual(picture));
            }
        }
        let depth = meant.iter().map(|picture| picture.folders.len()).min();
        meant.retain(|picture| Some(picture.folders.len()) == depth);
        // Files in one folder that differ only in their endings count as one picture.
        let folder = |picture: &Picture| picture.path.parent().map(Path::to_path_buf);
        let first = meant.first().map(|picture| folder(picture));
        if meant.iter().all(|picture| Some(folder(picture)) == first) {
            let rank = |picture: &&Picture| {
                let name = picture.path.file_name().map(|name| name.to_string_lossy().to_lowercase());
                (name.as_deref() != Some(file.as_str()), picture.path.clone())
            };
            meant = meant.into_iter().min_by_key(rank).into_iter().collect();
        }
        meant.into_iter().map(|picture| picture.path.as_path()).collect()
    }
}

/// Returns the folder to which the paths of entries are relative: the scene, or `images` within it if that is stated.
///
/// # Errors
/// Of kind `Input`: the stated path is not a folder.
pub(crate) fn stated(root: &Path, images: &str) -> Result<PathBuf> {
    if images.is_empty() {
        return Ok(root.into());
    }
    let folder = root.join(images);
    if folder.is_dir() {
        return Ok(folder);
    }
    let what = format!("is \"{images}\", but {} is not a folder", folder.display());
    Err(Error::input("data.images", what, "name the folder of the photographs relative to data.root"))
}

/// Lists all pictures below a folder.
fn list(root: &Path) -> List {
    let mut listed = List::default();
    let (mut folders, mut looked_at) = (vec![(root.to_path_buf(), Vec::new())], 0);
    while let Some((folder, names)) = folders.pop() {
        for path in folder.read_dir().into_iter().flatten().flatten().map(|entry| entry.path()) {
            looked_at += 1;
            if looked_at > MOST_FILES {
                break;
            }
            let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
            if path.is_dir() {
                if names.len() < MOST_DEPTH && !OTHERS.iter().any(|other| name.starts_with(other)) {
                    folders.push((path, [&names[..], &[name]].concat()));
                }
            } else if names::is_picture(&path) {
                let picture = Picture { path, folders: names.clone() };
                listed.folders.extend(names.last().cloned());
                listed.by_stem.entry(names::key(&name)).or_default().push(picture);
            }
        }
    }
    listed.by_stem.values_mut().for_each(|pictures| pictures.sort_by(|a, b| a.path.cmp(&b.path)));
    listed
}

/// Returns the error for a photograph that is not found.
fn missing(named: &str, candidates: &[PathBuf], place: &Place) -> Error {
    if let Some((path, format)) = candidates.iter().find_map(|path| foreign::beside(path)) {
        let what = format!(
            "image {} does not exist; {} in its folder is {}, which is not read",
            candidates[0].display(),
            path.display(),
            format.name
        );
        return Error::input(place, what, format.remedy(&path));
    }
    let has_ending = names::is_picture(Path::new(named));
    let tried = if has_ending { "" } else { " (nor with .png, .jpg or another ending added)" };
    Error::input(
        place,
        format!("image {} does not exist{tried}", candidates[0].display()),
        "copy it there or remove its entry",
    )
}

/// Finds the photographs of all entries, in their order; an entry has the name of a photograph and a place for
/// messages. A photograph that is not where its entry says must not belong to another entry.
fn resolved<'a>(
    pictures: &Pictures,
    entries: impl Iterator<Item = (&'a str, Place)>,
) -> Vec<(&'a str, Result<Location>)> {
    let entries: Vec<(&str, Place)> = entries.collect();
    let found: Vec<Result<Location>> =
        entries.iter().map(|(named, place)| pictures.find(named, place)).collect();
    let mut uses: HashMap<PathBuf, usize> = HashMap::new();
    for location in found.iter().flatten() {
        *uses.entry(location.path.clone()).or_default() += 1;
    }
    let alone = |((named, place), found): ((&'a str, Place), Result<Location>)| {
        let found = found.and_then(|location| {
            match location.moved && uses.get(&location.path).is_some_and(|&uses| uses > 1) {
                false => Ok(location),
                true => Err(Error::input(
                    place,
                    format!(
                        "image {named} does not exist, and {} belongs to another entry",
                        location.path.display()
                    ),
                    "copy the photographs into the folders that the entries name",
                )),
            }
        });
        (named, found)
    };
    entries.into_iter().zip(found).map(alone).collect()
}

/// Returns a warning about photographs that are not where the entries of `file` say.
fn moved(file: &Path, resolved: &[(&str, Result<Location>)]) -> Option<String> {
    let is_moved = |(named, found): &'_ (&str, Result<Location>)| {
        let location = found.as_ref().ok().filter(|location| location.moved)?;
        Some(format!("{named} is at {}", location.path.display()))
    };
    let moved: Vec<String> = resolved.iter().filter_map(is_moved).collect();
    let first = moved.first()?;
    let all = count(resolved.len(), "photograph");
    Some(format!("{}: {} of {all} are not where the file says: {first}", file.display(), moved.len()))
}

/// Finds all photographs of the entries of `file`, in their order. The warning reports photographs that are not where their entries say.
///
/// # Errors
/// Of kind `Input`, if a photograph is not found. The error names the first one and counts the others.
pub(crate) fn of_entries<'a>(
    pictures: &Pictures,
    file: &Path,
    entries: impl Iterator<Item = (&'a str, Place)>,
) -> Result<(Vec<PathBuf>, Option<String>)> {
    let resolved = resolved(pictures, entries);
    let warning = moved(file, &resolved);
    let all = resolved.len();
    let others = resolved.iter().filter(|(_, found)| found.is_err()).count().saturating_sub(1);
    let found: Result<Vec<PathBuf>> =
        resolved.into_iter().map(|(_, found)| found.map(|location| location.path)).collect();
    let with_others = |error: Error| match others {
        0 => error,
        more => error.with_note(format_args!("{more} more of {} are missing", count(all, "photograph"))),
    };
    Ok((found.map_err(with_others)?, warning))
}

/// Finds most photographs of the entries of `file`, in their order: `None` for one that is not found. Warnings report
/// missing photographs, and photographs that are not where their entries say.
///
/// # Errors
/// Of kind `Input`, if more than half are not found.
pub(crate) fn of_most_entries<'a>(
    pictures: &Pictures,
    file: &Path,
    entries: impl Iterator<Item = (&'a str, Place)>,
) -> Result<(Vec<Option<PathBuf>>, Vec<String>)> {
    let resolved = resolved(pictures, entries);
    let mut warnings: Vec<String> = moved(file, &resolved).into_iter().collect();
    let missing: Vec<&str> =
        resolved.iter().filter(|(_, found)| found.is_err()).map(|(named, _)| *named).collect();
    if let Some(first) = missing.first() {
        let what = format!(
            "{} of {} are missing, the first is {}",
            missing.len(),
            count(resolved.len(), "photograph"),
            pictures.folder.join(first).display()
        );
        if 2 * missing.len() > resolved.len() {
            if let Some((path, format)) = foreign::beside(&pictures.folder.join(first)) {
                let what =
                    format!("{what}; {} in its folder is {}, which is not read", path.display(), format.name);
                return Err(Error::input(file.display(), what, format.remedy(&path)));
            }
            let advice = "copy them there, or set data.images to their folder";
            return Err(Error::input(file.display(), what, advice));
        }
        warnings.push(format!("{}: {what}; they are left out", file.display()));
    }
    let path = |(_, found): (&str, Result<Location>)| found.ok().map(|location| location.path);
    Ok((resolved.into_iter().map(path).collect(), warnings))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    /// Returns the one of `files` that the name `named` means.
    fn found(files: &[&str], named: &str) -> std::result::Result<String, String> {
        let folder = tempfile::tempdir().unwrap();
        for file in files {
            let path = folder.path().join(file);
            fs::create_dir_all(path.parent().unwrap()).unwrap();
            fs::write(path, b"").unwrap();
        }
        let found =
            Pictures::new(folder.path()).find(named, &"entry".into()).map_err(|error| error.to_string())?;
        let path = found.path.strip_prefix(folder.path()).unwrap().display().to_string();
        assert_eq!(found.moved, !files.contains(&named.trim_start_matches("./")), "{named}");
        Ok(path)
    }

    #[test]
    fn photographs_are_found_where_copying_and_renaming_left_them() {
        let table: [(&[&str], &str, &str); 19] = [
            (&["images/a.webp"], "images/a.jpg", "images/a.webp"),
            (&["images/a.TIF"], "images/a.png", "images/a.TIF"),
            (&["images/a.tiff"], "/x/images/a.tif", "images/a.tiff"),
            (&["images/a.bmp", "depths/a.tif"], "D:\\x\\images\\a.png", "images/a.bmp"),
            (&["images/a.jpg", "a.jpg"], "images/a.jpg", "images/a.jpg"),
            (&["images/a.JPG"], "images/a.jpg", "images/a.JPG"),
            (&["images/a.JPG"], "./images/a", "images/a.JPG"),
            (&["Images/A.png"], "images/a.jpg", "Images/A.png"),
            (&["images/a.png", "images/a.jpg"], "images/a.JPG", "images/a.jpg"),
            (&["images/a.jpg"], "/home/someone/scene/images/a.jpg", "images/a.jpg"),
            (&["images/a.jpg"], "D:\\data\\scene\\images\\a.jpg", "images/a.jpg"),
            (&["rgb/a.jpg"], "./..\\data\\canister\\rgb/a.jpg", "rgb/a.jpg"),
            (&["images_4/a.png", "images_8/a.png"], "images/a.png", "images_4/a.png"),
            (&["images/a.png", "masks/a.png"], "undistorted/a.png", "images/a.png"),
            (&["images/a.png", "backup/a.png"], "undistorted/a.png", "images/a.png"),
            (&["a.png"], "images/a.png", "a.png"),
            (&["images/left/a.png", "images/right/a.png"], "/x/left/a.png", "images/left/a.png"),
            (&["images/a.png", "old/images/a.png"], "/x/images/a.png", "images/a.png"),
            (&["test/r_0.png", "train/r_0.png"], "/x/train/r_0", "train/r_0.png"),
        ];
        for (files, named, expected) in table {
            assert_eq!(found(files, named).as_deref(), Ok(expected), "{named} of {files:?}");
        }
    }

    #[test]
    fn no_photograph_is_taken_for_another() {
        let table: [(&[&str], &str, &str); 8] = [
            (&["left/b.png", "right/a.png"], "left/a.png", "does not exist"),
            (&["images/b.png", "backup/a.png"], "images/a.png", "does not exist"),
            (&["train/r_0.png"], "./test/r_0", "does not exist"),
            (&["images/r_0.png"], "./test/r_0", "does not exist"),
            (&["train/r_0.png"], "images/r_0.png", "does not exist"),
            (&["masks/a.png", "depths/a.png"], "images/a.png", "does not exist"),
            (&["left/a.png", "right/a.png"], "images/a.png", "2 pictures may be meant"),
            (&["images/a.heic"], "images/a.jpg", "is a HEIC image"),
        ];
        for (files, named, expected) in table {
            let error = found(files, named).unwrap_err();
            assert!(error.contains(expected), "{named} of {files:?}: {error}");
        }
    }

    #[test]
    fn two_entries_have_two_photographs() {
        let folder = tempfile::tempdir().unwrap();
        fs::create_dir(folder.path().join("images")).unwrap();
        fs::write(folder.path().join("images/a.png"), b"").unwrap();
        let pictures = Pictures::new(folder.path());
        let of = |named: &[&'static str]| {
            of_entries(&pictures, Path::new("a.json"), named.iter().map(|named| (*named, (*named).into())))
        };
        let (paths, warning) = of(&["/x/images/a.png"]).unwrap();
        assert_eq!(paths, [folder.path().join("images/a.png")]);
        assert!(
            warning
                .unwrap()
                .starts_with("a.json: 1 of 1 photograph are not where the file says: /x/images/a.png is at ")
        );
        let error = of(&["left/a.png", "right/a.png"]).unwrap_err();
        assert!(error.message().contains("belongs to another entry"), "{error}");
        let error = of(&["images/b.png", "images/a.png", "images/c.png"]).unwrap_err();
        assert!(error.message().contains("images/b.png does not exist"), "{error}");
        assert!(error.message().ends_with("; 1 more of 3 photographs are missing"), "{error}");
    }
}
