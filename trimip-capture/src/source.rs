//! The input of a capture: a film, or photographs in a folder or in an archive.

use std::path::{Path, PathBuf};
use trimip::{Error, Result};
use trimip_data::{Foreign, Material, foreign_format, has_cameras, is_archive, is_film, unpack_material};

/// Minimum number of photographs from which cameras can be estimated.
const FEWEST: usize = 3;

/// The input of a capture.
pub enum Source {
    /// A film.
    Film(PathBuf),
    /// Photographs.
    Photographs(Vec<Photograph>),
}

/// A photograph of the user.
pub struct Photograph {
    /// Absolute path of the file.
    pub path: PathBuf,
    /// Path relative to the folder of all photographs.
    pub name: PathBuf,
    /// Format of the file, if it has to be converted.
    pub foreign: Option<&'static Foreign>,
}

/// A source, and remarks about it.
pub struct Found {
    /// The source.
    pub source: Source,
    /// Lines for the user.
    pub notes: Vec<String>,
}

/// Determines the kind of input that a path names.
///
/// # Errors
/// Of kind `Input`: the path does not exist, or it names a scene that has cameras, too few photographs, several films or something else.
pub fn find(input: &Path) -> Result<Found> {
    let place = input.display();
    let absolute = std::path::absolute(input).unwrap_or_else(|_| input.into());
    if !input.exists() {
        return Err(Error::input(
            place,
            "does not exist",
            "name a film, a folder of photographs or a zip archive",
        ));
    }
    if input.is_dir() {
        return of_folder(&absolute, input, Vec::new());
    }
    if is_archive(input) {
        let (folder, note) = unpack_material(input)?;
        let absolute = std::path::absolute(&folder).unwrap_or_else(|_| folder.clone());
        return of_folder(&absolute, input, vec![note]);
    }
    if is_film(input) {
        return Ok(Found { source: Source::Film(absolute), notes: Vec::new() });
    }
    Err(Error::input(
        place,
        "is no film, no folder and no zip archive",
        "name a film (.mp4, .mov, .mkv, …), or the folder of all photographs",
    ))
}

/// Determines what a folder contains. `named` is the path that the user typed.
fn of_folder(folder: &Path, named: &Path, mut notes: Vec<String>) -> Result<Found> {
    let place = named.display();
    let material = Material::of(folder);
    if let Some(scene) = has_cameras(folder).then(|| folder.to_path_buf()).or(material.scene) {
        let shown = if scene == folder { named } else { &scene };
        return Err(Error::input(
            shown.display(),
            "holds a scene with cameras already",
            format!(
                "train on it, `trimip-cli {}`, or name the folder of its photographs alone",
                shown.display()
            ),
        ));
    }
    let mut photographs = Vec::new();
    let named_foreign = material.foreign.into_iter().map(|(path, _)| path);
    for path in material.pictures.into_iter().chain(named_foreign) {
        let name = path.strip_prefix(folder).unwrap_or(&path).to_path_buf();
        // Phones may send HEIC files that are named like JPEGs.
        let foreign = foreign_format(&path);
        photographs.push(Photograph { path, name, foreign });
    }
    if photographs.is_empty() {
        return match &material.films[..] {
            [] => Err(Error::input(
                place,
                "holds neither photographs nor a film",
                "name a folder with JPEG, PNG or HEIC files, or a film",
            )),
            [film] => {
                notes.push(format!("film: {}", film.display()));
                Ok(Found { source: Source::Film(film.clone()), notes })
            }
            [first, second, ..] => Err(Error::input(
                place,
                format!("holds several films: {}, {}, …", first.display(), second.display()),
                "name one of them",
            )),
        };
    }
    if !material.films.is_empty() {
        notes.push(format!(
            "left out: {}, because the folder holds photographs; name the film to capture it",
            material.films[0].display()
        ));
    }
    without_copies(&mut photographs, &mut notes);
    if let Some((path, format)) = photographs
        .iter()
        .find_map(|photograph| Some((&photograph.path, photograph.foreign.filter(|f| !f.is_heif())?)))
    {
        return Err(Error::input(path.display(), format!("is {}", format.name), format.remedy(path)));
    }
    if photographs.len() < FEWEST {
        return Err(Error::input(
            place,
            format!("holds only {}", trimip_core::plural::count(photographs.len(), "photograph")),
            format!(
                "take more: cameras need at least {FEWEST} that overlap, and 50 to 200 make a good scene"
            ),
        ));
    }
    photographs.sort_by(|a, b| a.name.cmp(&b.name));
    Ok(Found { source: Source::Photographs(photographs), notes })
}

/// Leaves out photographs that need conversion if the folder also has the same photograph in a readable format.
fn without_copies(photographs: &mut Vec<Photograph>, notes: &mut Vec<String>) {
    let stem = |photograph: &Photograph| photograph.name.with_extension("");
    let read: std::collections::BTreeSet<PathBuf> =
        photographs.iter().filter(|photograph| photograph.foreign.is_none()).map(stem).collect();
    let before = photographs.len();
    photographs.retain(|photograph| photograph.foreign.is_none() || !read.contains(&stem(photograph)));
    if photographs.len() < before {
        notes.push(format!(
            "left out: {} that the folder also holds in another format",
            trimip_core::plural::count(before - photographs.len(), "photograph")
        ));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_path_is_a_film_photographs_or_refused_with_what_to_do() {
        let folder = tempfile::tempdir().unwrap();
        let root = folder.path();
        let make = |names: &[&str]| {
            for name in names {
                let path = root.join(name);
                std::fs::create_dir_all(path.parent().unwrap()).unwrap();
                std::fs::write(path, b"").unwrap();
            }
        };
        make(&["a/1.jpg", "a/2.jpg", "a/b/3.png", "a/way.mov", "a/2.heic"]);
        make(&["film/walk.MP4", "films/1.mp4", "films/2.mp4", "two/1.jpg", "two/2.jpg"]);
        make(&[
            "scene/transforms.json",
            "raw/1.cr2",
            "raw/2.jpg",
            "raw/3.jpg",
            "empty/x.txt",
            "x.mp4",
            "y.doc",
        ]);
        let found = find(&root.join("a")).unwrap();
        assert_eq!(found.notes.len(), 2, "{:?}", found.notes);
        match found.source {
            Source::Photographs(all) => {
                let names: Vec<_> =
                    all.iter().map(|photograph| photograph.name.display().to_string()).collect();
                assert_eq!(
                    names,
                    ["1.jpg", "2.jpg", "b/3.png"].map(|name| Path::new(name).display().to_string())
                );
            }
            Source::Film(film) => panic!("{}", film.display()),
        }
        for film in ["film", "x.mp4"] {
            assert!(matches!(find(&root.join(film)).unwrap().source, Source::Film(_)), "{film}");
        }
        for (name, what) in [
            ("films", "several films"),
            ("two", "only 2 photographs"),
            ("scene", "holds a scene with cameras already"),
            ("raw", "camera's raw image"),
            ("empty", "neither photographs nor a film"),
            ("y.doc", "is no film"),
            ("gone", "does not exist"),
        ] {
            let error = find(&root.join(name)).err().unwrap();
            assert!(
                error.kind() == trimip_core::ErrorKind::Input && error.message().contains(what),
                "{name}: {error}"
            );
        }
    }
}
