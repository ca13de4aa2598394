//! Finds the parts of a capture with a COLMAP model: the folder of the model, its files, and the folder of the photographs.

use super::{
    binary,
    model::{Encoding, File, Model},
    text,
};
use crate::{
    files,
    pictures::{self, Pictures},
};
use std::{
    io::Read,
    path::{Path, PathBuf},
};
use trimip_core::{Error, Result, plain_file, text::decoded};

/// Folders of a model within a scene, in the order in which they are tried.
const FOLDERS: [&str; 11] = [
    "",
    "sparse/0",
    "sparse",
    "colmap/sparse/0",
    "colmap/sparse",
    "colmap/bin",
    "colmap/txt",
    "colmap",
    "dense/0/sparse",
    "dense/sparse",
    "undistorted/sparse",
];
/// Folders that may hold several numbered models.
const SEVERAL: [&str; 2] = ["sparse", "colmap/sparse"];
/// Number of levels above a model that are searched for its photographs.
const LEVELS_UP: usize = 3;

/// The folder of a model.
pub(super) struct Found {
    pub(super) folder: PathBuf,
    /// A warning about other models next to it, if there are any.
    pub(super) warning: Option<String>,
}

/// Returns true if a folder holds a model.
pub(crate) fn is_there(root: &Path) -> bool {
    first(root).is_some()
}

fn first(root: &Path) -> Option<(&'static str, PathBuf)> {
    let mut folders = FOLDERS.map(|name| (name, if name.is_empty() { root.into() } else { root.join(name) }));
    // A mapper that starts again leaves no model 0: the lowest number takes its place.
    for several in SEVERAL {
        if let Some((_, folder)) = folders.iter_mut().find(|(name, _)| *name == format!("{several}/0")) {
            let models = numbered(&root.join(several));
            *folder = models.into_iter().next().unwrap_or_else(|| folder.clone());
        }
    }
    folders.into_iter().find(|(_, folder)| encoding(folder).is_some())
}

/// Returns the folders within `folder` that hold a model and have a number as their name, sorted by number.
fn numbered(folder: &Path) -> Vec<PathBuf> {
    let number = |path: &PathBuf| path.file_name()?.to_str()?.parse::<u32>().ok();
    let entries = folder.read_dir().into_iter().flatten().flatten().map(|entry| entry.path());
    let mut models: Vec<PathBuf> =
        entries.filter(|path| number(path).is_some() && encoding(path).is_some()).collect();
    models.sort_by_key(number);
    models
}

/// Returns the encoding of the files of a model, or `None` if the folder holds no model. Binary files take precedence.
fn encoding(folder: &Path) -> Option<Encoding> {
    let both = |extension: &str| {
        ["cameras", "images"].iter().all(|name| folder.join(format!("{name}.{extension}")).is_file())
    };
    [(Encoding::Binary, "bin"), (Encoding::Text, "txt")]
        .into_iter()
        .find(|(_, extension)| both(extension))
        .map(|(encoding, _)| encoding)
}

/// Returns the model of a scene: among several numbered models, the one with the most images.
pub(super) fn model(root: &Path) -> Result<Found> {
    let Some((name, folder)) = first(root) else {
        return Err(Error::input(
            root.display(),
            "holds no COLMAP model: looked for cameras and images (.bin or .txt) in it, in sparse/0, sparse and colmap",
            "set data.root to the folder that holds sparse/ and images/",
        ));
    };
    let Some(parent) = name.strip_suffix("/0").map(|parent| root.join(parent)) else {
        return Ok(Found { folder, warning: None });
    };
    let models: Vec<(PathBuf, u64)> =
        numbered(&parent).into_iter().map(|folder| (folder.clone(), images_in(&folder))).collect();
    // Among models with equally many images, the first is taken.
    let best = models.iter().rev().max_by_key(|(_, images)| *images).map(|(folder, _)| folder.clone());
    let Some(best) = best.filter(|_| models.len() > 1) else { return Ok(Found { folder, warning: None }) };
    let counts: Vec<String> = models
        .iter()
        .map(|(folder, images)| {
            format!("{} with {images}", folder.file_name().unwrap_or_default().to_string_lossy())
        })
        .collect();
    let warning = format!(
        "{} holds {} models: {} images; {} is read",
        parent.display(),
        models.len(),
        counts.join(", "),
        best.display()
    );
    Ok(Found { folder: best, warning: Some(warning) })
}

/// Returns the number of images of a model, or 0 if the model is broken.
fn images_in(folder: &Path) -> u64 {
    let head = || {
        let mut head = [0; 8];
        plain_file::open(&folder.join("images.bin")).ok()?.read_exact(&mut head).ok()?;
        Some(binary::stated_images(head))
    };
    let whole = || {
        let bytes = plain_file::read(&folder.join("images.txt")).ok()?;
        text::images(File { name: "", bytes: &bytes }).ok().map(|images| images.len() as u64)
    };
    match encoding(folder) {
        Some(Encoding::Binary) => head().unwrap_or(0),
        Some(Encoding::Text) => whole().unwrap_or(0),
        None => 0,
    }
}

impl Model {
    /// Reads the model in a folder. Binary files take precedence; the file of points may be missing.
    ///
    /// # Errors
    /// As [`Model::parse`], and files that cannot be read.
    pub fn read(folder: &Path) -> Result<Self> {
        let encoding = encoding(folder).ok_or_else(|| {
            Error::input(folder.display(), "holds no COLMAP model", "name a folder with cameras and images")
        })?;
        let path = |name: &str| folder.join(format!("{name}.{}", encoding.extension()));
        let read = |path: &Path| {
            let bytes = files::read(path)?;
            Ok::<_, Error>(match encoding {
                Encoding::Text => readable(&bytes),
                Encoding::Binary => bytes,
            })
        };
        let [cameras, images, points] = ["cameras", "images", "points3D"].map(path);
        let names = [&cameras, &images, &points].map(|path| path.display().to_string());
        let seen = points.is_file().then(|| read(&points)).transpose()?;
        Self::parse(
            encoding,
            File { name: &names[0], bytes: &read(&cameras)? },
            File { name: &names[1], bytes: &read(&images)? },
            seen.as_ref().map(|bytes| File { name: &names[2], bytes }),
        )
    }
}

/// Converts a text to UTF-8. Characters of a code page are replaced: they occur in names of photographs, and file names
/// are converted in the same way.
fn readable(bytes: &[u8]) -> Vec<u8> {
    String::from_utf8_lossy(&decoded(bytes)).into_owned().into_bytes()
}

impl Encoding {
    fn extension(self) -> &'static str {
        match self {
            Self::Text => "txt",
            Self::Binary => "bin",
        }
    }
}

/// Returns the file of the images in a folder with a model, for messages.
pub(super) fn images_file(folder: &Path) -> PathBuf {
    folder.join(format!("images.{}", encoding(folder).unwrap_or(Encoding::Binary).extension()))
}

/// Returns the folder of the photographs: `stated` within the scene, or the first folder that holds one of the files `names`.
pub(super) fn photographs(root: &Path, stated: &str, model: &Path, names: &[&str]) -> Result<PathBuf> {
    if !stated.is_empty() {
        return pictures::stated(root, stated);
    }
    // A relative path has no ancestors above its first folder, so it is made absolute.
    let model = std::path::absolute(model).unwrap_or_else(|_| model.into());
    let above = model.ancestors().skip(1).take(LEVELS_UP).map(|folder| folder.join("images"));
    let folders: Vec<PathBuf> = [root.join("images"), root.into()].into_iter().chain(above).collect();
    let found = folders.iter().find(|folder| names.iter().any(|name| folder.join(name).is_file()));
    let pictures = Pictures::new(root);
    let moved = || {
        names.iter().find_map(|name| {
            pictures
                .find(name, &images_file(&model).as_path().into())
                .ok()?
                .path
                .parent()
                .map(Path::to_path_buf)
        })
    };
    found.cloned().or_else(moved).ok_or_else(|| {
        Error::input(
            images_file(&model).display(),
            format!(
                "names {}, but none of its {} photographs is in {} or images/ above the model",
                names.first().unwrap_or(&"none"),
                names.len(),
                folders[0].display()
            ),
            "set data.images to their folder, relative to data.root",
        )
    })
}
