//! Advice for a folder without a scene: the command that makes a scene of the files in it.

use crate::{foreign, names, readers::found, zip::is_archive};
use std::path::{Path, PathBuf};
use trimip_core::plural::count;

/// How deep below the folder is looked, and at how many files.
const MOST_DEPTH: usize = 3;
const MOST_FILES: usize = 100_000;

/// Endings of films, and of archives that are not unpacked.
const FILMS: [&str; 8] = ["mp4", "mov", "avi", "mkv", "webm", "m4v", "insv", "mts"];
const ARCHIVES: [&str; 5] = ["tar", "gz", "tgz", "7z", "rar"];

/// File in which COLMAP keeps features and matches.
const DATABASE: &str = "database.db";

/// The next command for a folder that holds no scene, in words.
pub(crate) fn advice(root: &Path) -> String {
    next(root, root).unwrap_or_else(|| "name a folder with one of them".into())
}

/// As [`advice`] for a folder that the command calls by `named`; `None` if it holds nothing to begin with.
pub(crate) fn next(root: &Path, named: &Path) -> Option<String> {
    let content = Content::of(root, named);
    let root = named;
    // A shell reads a name with blanks as one word only between quotes.
    let shown = |path: &Path| match path.display().to_string() {
        blank if blank.contains(char::is_whitespace) => format!("\"{blank}\""),
        plain => plain,
    };
    if let Some(inner) = &content.scene {
        return Some(format!("name {}, which holds one", shown(inner)));
    }
    let pictures = |folder: &Path| format!("--image_path {}", shown(folder));
    let folder = content.pictures.first().and_then(|path| path.parent()).unwrap_or(root);
    if let Some(database) = &content.database {
        let beside = database.parent().unwrap_or(root);
        return Some(format!(
            "COLMAP has not placed its photographs: mkdir {0}/sparse && colmap mapper --database_path {1} {2} --output_path {0}/sparse",
            shown(beside),
            shown(database),
            pictures(folder)
        ));
    }
    let cameras = |folder: &Path| {
        format!(
            "colmap automatic_reconstructor --workspace_path {} {} --dense 0",
            shown(root),
            pictures(folder)
        )
    };
    if !content.pictures.is_empty() {
        return Some(format!(
            "its {} cameras, which COLMAP finds: {}",
            match content.pictures.len() {
                1 => "picture needs".into(),
                several => format!("{} need", count(several, "picture")),
            },
            cameras(folder)
        ));
    }
    if let Some((path, format)) = &content.foreign {
        let folder = path.parent().unwrap_or(root);
        return Some(format!(
            "{} is {}: {}; then find their cameras: {}",
            shown(path),
            format.name,
            format.remedy(path),
            cameras(folder)
        ));
    }
    if let Some(film) = &content.film {
        let images = film.parent().unwrap_or(root).join("images");
        return Some(format!(
            "{} is a film: take photographs out of it, mkdir {1} && ffmpeg -i {0} -vf fps=2 -q:v 2 {1}/%04d.jpg, and find \
             their cameras: {2}",
            shown(film),
            shown(&images),
            cameras(&images)
        ));
    }
    if let Some(zip) = &content.zip {
        return Some(format!("name {}, which is unpacked then", shown(zip)));
    }
    content.archive.map(|archive| format!("unpack {}, and name the folder in it", shown(&archive)))
}

/// The files in a folder and below it: the first of each kind, in order of their paths.
#[derive(Default)]
struct Content {
    /// A folder with a scene.
    scene: Option<PathBuf>,
    /// Photographs in formats that are read.
    pictures: Vec<PathBuf>,
    foreign: Option<(PathBuf, &'static foreign::Foreign)>,
    film: Option<PathBuf>,
    zip: Option<PathBuf>,
    archive: Option<PathBuf>,
    database: Option<PathBuf>,
}

impl Content {
    /// What is in `root`, below `named`.
    fn of(root: &Path, named: &Path) -> Self {
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
                        below.push(path);
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

    fn take(&mut self, path: PathBuf) {
        let ending =
            path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default();
        if names::is_picture(&path) {
            self.pictures.push(path);
        } else if path.file_name().is_some_and(|name| name == DATABASE) {
            self.database.get_or_insert(path);
        } else if let Some(format) = foreign::of_name(&path) {
            self.foreign.get_or_insert((path, format));
        } else if FILMS.contains(&ending.as_str()) {
            self.film.get_or_insert(path);
        } else if is_archive(&path) {
            self.zip.get_or_insert(path);
        } else if ARCHIVES.contains(&ending.as_str()) {
            self.archive.get_or_insert(path);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn a_folder_without_a_scene_has_a_next_command() {
        let table: [(&[&str], &[&str]); 14] = [
            (&["0.webp", "1.TIF", "2.bmp"], &["its 3 pictures need cameras"]),
            (&["DSC_1.DNG"], &["ROOT/DSC_1.DNG is a camera's raw image", "darktable-cli ROOT/DSC_1.DNG"]),
            (&["a.avif"], &["ROOT/a.avif is an AVIF image", "ffmpeg -i ROOT/a.avif ROOT/a.png"]),
            (&["a.jxl"], &["ROOT/a.jxl is a JPEG XL image", "djxl ROOT/a.jxl ROOT/a.png"]),
            (&["a/b/transforms_train.json", "a/b/train/r_0.png"], &["name ROOT/a/b, which holds one"]),
            (
                &["images/0.jpg", "images/1.jpg"],
                &["its 2 pictures need cameras", "automatic_reconstructor", "--image_path ROOT/images"],
            ),
            (&["0.JPG"], &["its picture needs cameras", "--image_path ROOT "]),
            (
                &["IMG_0.HEIC"],
                &["ROOT/IMG_0.HEIC is a HEIC image", "heif-convert", "automatic_reconstructor"],
            ),
            (&["scan.MP4"], &["ROOT/scan.MP4 is a film", "ffmpeg -i ROOT/scan.MP4", "ROOT/images/%04d.jpg"]),
            (
                &["database.db", "images/0.png"],
                &["colmap mapper --database_path ROOT/database.db --image_path ROOT/images"],
            ),
            (&["lego.zip"], &["name ROOT/lego.zip, which is unpacked then"]),
            (&["lego.7z", "lego.tar"], &["unpack ROOT/lego.7z, and name the folder in it"]),
            (&["my walk/0.jpg"], &["--image_path \"ROOT/my walk\" --dense 0"]),
            (&["notes.txt"], &["name a folder with one of them"]),
        ];
        for (files, expected) in table {
            let folder = tempfile::tempdir().unwrap();
            for file in files {
                let path = folder.path().join(file);
                fs::create_dir_all(path.parent().unwrap()).unwrap();
                fs::write(path, b"").unwrap();
            }
            let told = advice(folder.path()).replace(&folder.path().display().to_string(), "ROOT");
            for part in expected {
                assert!(told.contains(part), "{files:?}: {told}");
            }
        }
    }
}
