//! The files in a folder without a scene from which a scene can be made: photographs, films, archives, a database of COLMAP.

use crate::{
    foreign::{self, Foreign},
    names,
    readers::found,
    zip::is_archive,
};
use std::path::{Path, PathBuf};

/// Number of levels below the folder that are searched, and most files.
const MOST_DEPTH: usize = 3;
const MOST_FILES: usize = 100_000;

/// Endings of films, and of archives that the program cannot unpack.
const FILMS: [&str; 11] = ["mp4", "mov", "avi", "mkv", "webm", "m4v", "insv", "mts", "m2ts", "3gp", "mpg"];
const ARCHIVES: [&str; 5] = ["tar", "gz", "tgz", "7z", "rar"];

/// Beginnings of the names of folders whose pictures are no photographs, in lower case.
const NO_PHOTOGRAPHS: [&str; 3] = ["mask", "depth", "confidence"];

/// File in which COLMAP stores features and matches.
const DATABASE: &str = "database.db";

/// The files in a folder and below it from which a scene can be made, each kind sorted by level, then by path.
#[derive(Default)]
pub struct Material {
    /// The first folder below that holds a scene.
    pub scene: Option<PathBuf>,
    /// Photographs in formats that the program reads, judged by their names.
    pub pictures: Vec<PathBuf>,
    /// Photographs in formats that have to be converted first, judged by their names.
    pub foreign: Vec<(PathBuf, &'static Foreign)>,
    /// Films.
    pub films: Vec<PathBuf>,
    /// The first zip archive.
    pub(crate) zip: Option<PathBuf>,
    /// The first archive of another kind.
    pub(crate) archive: Option<PathBuf>,
    /// The first database of COLMAP.
    pub(crate) database: Option<PathBuf>,
}

impl Material {
    /// Lists the usable files of a folder. Folders of masks and depth images are left out.
    pub fn of(root: &Path) -> Self {
        Self::called(root, root)
    }

    /// Lists the files as [`of`](Self::of) does for `root`, with paths that begin with `named` instead.
    pub(crate) fn called(root: &Path, named: &Path) -> Self {
        let called =
            |path: PathBuf| path.strip_prefix(root).map_or_else(|_| path.clone(), |below| named.join(below));
        let mut content = Self::default();
        let mut level = vec![root.to_path_buf()];
        let mut looked_at = 0;
        for _ in 0..=MOST_DEPTH {
            let mut below = Vec::new();
            for folder in &level {
                let mut paths: Vec<PathBuf> =
                    folder.read_dir().into_iter().flatten().flatten().map(|entry| entry.path()).collect();
                paths.sort();
                looked_at += paths.len();
                for path in paths {
                    if path.is_dir() {
                        if content.scene.is_none() && found(&path).is_some() {
                            content.scene = Some(called(path.clone()));
                        }
                        if may_hold_photographs(&path) {
                            below.push(path);
                        }
                    } else {
                        content.take(called(path));
                    }
                }
                if looked_at > MOST_FILES {
                    return content;
                }
            }
            level = below;
        }
        content
    }

    /// Returns true if there is a scene, a photograph or a film.
    pub fn is_any(&self) -> bool {
        self.scene.is_some()
            || !(self.pictures.is_empty() && self.foreign.is_empty() && self.films.is_empty())
    }

    fn take(&mut self, path: PathBuf) {
        if names::is_hidden(&path) {
            return;
        }
        if names::is_picture(&path) {
            self.pictures.push(path);
        } else if path.file_name().is_some_and(|name| name == DATABASE) {
            self.database.get_or_insert(path);
        } else if let Some(format) = foreign::of_name(&path) {
            self.foreign.push((path, format));
        } else if is_film(&path) {
            self.films.push(path);
        } else if is_archive(&path) {
            self.zip.get_or_insert(path);
        } else if ARCHIVES.contains(&ending(&path).as_str()) {
            self.archive.get_or_insert(path);
        }
    }
}

/// Returns true for a path with the ending of a film.
pub fn is_film(path: &Path) -> bool {
    FILMS.contains(&ending(path).as_str())
}

/// Returns true if a folder is a scene: its files have cameras.
pub fn has_cameras(folder: &Path) -> bool {
    found(folder).is_some()
}

/// Returns the format of a photograph that has to be converted first, recognised by its first bytes, otherwise by its
/// name. `None` for a photograph in a format that the program reads.
pub fn foreign_format(path: &Path) -> Option<&'static Foreign> {
    foreign::of_file(path)
}

fn may_hold_photographs(folder: &Path) -> bool {
    let name = folder.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
    !name.starts_with('.') && !NO_PHOTOGRAPHS.iter().any(|start| name.starts_with(start))
}

/// Returns the ending of a name without its dot, in lower case.
fn ending(path: &Path) -> String {
    path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn photographs_films_and_scenes_are_told_apart() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let files = [
            "walk/1.JPG",
            "walk/2.heic",
            "walk/masks/1.png",
            "walk/._1.jpg",
            "walk/way.MOV",
            "walk/notes.txt",
            "scene/transforms.json",
        ];
        for file in files {
            let path = root.join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            std::fs::write(path, b"").unwrap();
        }
        let walk = Material::of(&root.join("walk"));
        assert_eq!(walk.pictures, [root.join("walk/1.JPG")]);
        assert_eq!((walk.foreign.len(), walk.films.len(), walk.scene.is_none()), (1, 1, true));
        assert!(walk.foreign[0].1.is_heif() && walk.is_any());
        assert_eq!(Material::of(root).scene, Some(root.join("scene")));
        assert!(has_cameras(&root.join("scene")) && !has_cameras(&root.join("walk")));
        assert!(!Material::of(&root.join("walk/masks/none")).is_any());
        assert!(is_film(Path::new("a.mp4")) && !is_film(Path::new("mp4")) && !is_film(Path::new("a.jpg")));
    }
}
