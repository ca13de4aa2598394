//! Names of images: finds an image by the different names that files, lists and users write, and makes short unique names for pictures.

use std::{collections::HashMap, path::Path};

/// Endings of photographs.
pub(crate) const ENDINGS: [&str; 7] = [".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp"];

/// Returns true if a path has the ending of a photograph and is not hidden: macOS puts `._1.jpg` next to `1.jpg` on other file systems.
pub(crate) fn is_picture(path: &Path) -> bool {
    let name = path.to_string_lossy().to_lowercase();
    !is_hidden(path) && ENDINGS.iter().any(|end| name.ends_with(end))
}

/// Returns true for a name that begins with a dot.
pub(crate) fn is_hidden(path: &Path) -> bool {
    path.file_name().is_some_and(|name| name.to_string_lossy().starts_with('.'))
}

/// Returns a path with forward slashes, without `./` before it and without the ending of a photograph.
pub(crate) fn key(named: &str) -> String {
    let path = named.replace('\\', "/");
    let path = path.trim_start_matches("./");
    let known = ENDINGS.iter().find(|end| path.to_lowercase().ends_with(**end));
    // Lower-casing keeps the length of these ASCII endings, so the cut lies on a boundary.
    known.and_then(|end| path.get(..path.len() - end.len())).unwrap_or(path).to_string()
}

/// Returns the file name without folder and ending, for pictures and messages.
pub(crate) fn stem(named: &str) -> String {
    let key = key(named);
    key.rsplit('/').next().unwrap_or(&key).to_string()
}

/// Returns a unique name for the pictures of each image: its stem. If any two stems are equal, the names are the paths
/// below the common folder of all images, with `_` for `/`; equal paths get numbers.
pub(crate) fn unique<T: AsRef<str>>(images: &[T]) -> Vec<String> {
    let stems: Vec<String> = images.iter().map(|image| stem(image.as_ref())).collect();
    let mut counts: HashMap<&str, usize> = HashMap::new();
    stems.iter().for_each(|stem| *counts.entry(stem).or_default() += 1);
    if counts.values().all(|count| *count == 1) {
        return stems;
    }
    let keys: Vec<String> = images.iter().map(|image| key(image.as_ref())).collect();
    let shared = shared_folder(&keys);
    let mut used: HashMap<String, usize> = HashMap::new();
    keys.iter()
        .map(|key| {
            let path = key[shared..].replace('/', "_");
            let mut name = path.clone();
            while let Some(count) = used.get_mut(&name) {
                *count += 1;
                name = format!("{path}_{count}");
            }
            used.insert(name.clone(), 1);
            name
        })
        .collect()
}

/// Returns the length of the common folder of all paths, including its last slash.
fn shared_folder(keys: &[String]) -> usize {
    let Some((first, others)) = keys.split_first() else { return 0 };
    let ends = first.match_indices('/').map(|(at, _)| at + 1);
    ends.take_while(|&end| others.iter().all(|key| key.starts_with(&first[..end]))).last().unwrap_or(0)
}

/// Finds images by the names that users write.
pub(crate) struct Index {
    keys: Vec<String>,
    /// Indices of the images with each stem.
    stems: HashMap<String, Vec<usize>>,
}

/// The image that a name means.
#[derive(Debug, PartialEq)]
pub(crate) enum Match {
    One(usize),
    None,
    Several,
}

impl Index {
    pub(crate) fn new<T: AsRef<str>>(images: impl Iterator<Item = T>) -> Self {
        let keys: Vec<String> = images.map(|image| key(image.as_ref())).collect();
        let mut stems: HashMap<String, Vec<usize>> = HashMap::new();
        for (index, key) in keys.iter().enumerate() {
            stems.entry(stem(key)).or_default().push(index);
        }
        Self { keys, stems }
    }

    /// Finds the image with the path `written`. Otherwise, finds the only image whose path ends with `written` or is the end of `written`.
    pub(crate) fn find(&self, written: &str) -> Match {
        let written = key(written);
        let near = self.stems.get(&stem(&written)).map_or(&[][..], Vec::as_slice);
        let only = |fits: &dyn Fn(&str) -> bool| {
            let mut found = near.iter().copied().filter(|&index| fits(&self.keys[index]));
            match (found.next(), found.next()) {
                (None, _) => Match::None,
                (Some(index), None) => Match::One(index),
                _ => Match::Several,
            }
        };
        let exact = only(&|key| key == written);
        if exact != Match::None {
            return exact;
        }
        let ends = |long: &str, short: &str| long.strip_suffix(short).is_some_and(|rest| rest.ends_with('/'));
        only(&|key| ends(key, &written) || ends(&written, key))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_short_where_they_can_be_and_unique_everywhere() {
        assert_eq!(unique(&["images/0001.jpg", "./images\\0002.png", "b"]), ["0001", "0002", "b"]);
        assert_eq!(unique(&["a/1.jpg", "b/1.jpg", "b/2.jpg"]), ["a_1", "b_1", "b_2"]);
        assert_eq!(unique(&["in/a/1.jpg", "in/b/1.jpg", "in/2.jpg"]), ["a_1", "b_1", "2"]);
        for hard in [&["a/1.jpg", "a/1.png", "a_1.png"][..], &["x", "x", "x", "x_2", "x_3"], &["", ""]] {
            let mut names = unique(hard);
            names.sort();
            names.dedup();
            assert_eq!(names.len(), hard.len(), "{hard:?} {names:?}");
        }
    }

    #[test]
    fn an_image_is_found_by_every_way_to_write_it() {
        let index =
            Index::new(["images/left/0001.jpg", "images/right/0001.jpg", "images/left/0002.JPG"].iter());
        for written in ["images/left/0001.jpg", "./left/0001", "left\\0001.jpg", "/data/images/left/0001.png"]
        {
            assert_eq!(index.find(written), Match::One(0), "{written}");
        }
        assert_eq!(index.find("0002"), Match::One(2));
        assert_eq!(index.find("0001.jpg"), Match::Several);
        for absent in ["0003", "eft/0001", "middle/0001.jpg", ""] {
            assert_eq!(index.find(absent), Match::None, "{absent}");
        }
    }
}
