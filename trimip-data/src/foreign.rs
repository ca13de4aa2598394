//! Photographs in formats that the program does not read: recognised by their first bytes or by their extension, with
//! the command that converts them to PNG or JPEG.

use std::{
    io::Read,
    path::{Path, PathBuf},
};
use trimip_core::plain_file;

/// A format of photographs that the program does not read.
#[derive(Debug, PartialEq)]
pub struct Foreign {
    /// Name of the format with its article, such as "a HEIC image".
    pub name: &'static str,
    /// Extensions of file names, in lower case.
    extensions: &'static [&'static str],
    /// Command that converts a file; `IN` and `OUT` stand for the file and for its name without extension.
    command: &'static str,
}

const HEIC: Foreign = Foreign {
    name: "a HEIC image",
    extensions: &["heic", "heif", "hif"],
    command: "heif-convert IN OUT.png",
};
const AVIF: Foreign =
    Foreign { name: "an AVIF image", extensions: &["avif"], command: "ffmpeg -i IN OUT.png" };
const RAW: Foreign = Foreign {
    name: "a camera's raw image",
    extensions: &["cr2", "cr3", "nef", "nrw", "dng", "arw", "srw", "orf", "rw2", "raf", "pef", "3fr", "iiq"],
    command: "darktable-cli IN OUT.png",
};
const GIF: Foreign = Foreign { name: "a GIF image", extensions: &["gif"], command: "magick IN OUT.png" };
const JXL: Foreign = Foreign { name: "a JPEG XL image", extensions: &["jxl"], command: "djxl IN OUT.png" };

const ALL: [&Foreign; 5] = [&HEIC, &AVIF, &RAW, &GIF, &JXL];

impl Foreign {
    /// Returns true for photographs in the container of HEIF: HEIC and AVIF.
    pub fn is_heif(&self) -> bool {
        [&HEIC, &AVIF].contains(&self)
    }

    /// Returns advice on converting such a file.
    pub fn remedy(&self, path: &Path) -> String {
        let shown = |path: &Path| path.display().to_string();
        let command =
            self.command.replace("IN", &shown(path)).replace("OUT", &shown(&path.with_extension("")));
        format!(
            "convert it and all similar files to PNG or JPEG of the same size, e.g. {command}, and name the converted files"
        )
    }
}

/// Returns the format of a file, if it is one that the program does not read.
pub(crate) fn of_file(path: &Path) -> Option<&'static Foreign> {
    let mut head = [0; 16];
    let length = plain_file::open(path).and_then(|mut file| file.read(&mut head)).unwrap_or(0);
    of_content(&head[..length]).or(of_name(path))
}

/// Returns true for a camera's raw image, recognised by its name. Most are TIFF files whose first picture is a small copy.
pub(crate) fn is_raw(path: &Path) -> bool {
    of_name(path) == Some(&RAW)
}

/// Returns a file in a format that the program does not read, next to the missing `path`: its name differs only in the extension.
pub(crate) fn beside(path: &Path) -> Option<(PathBuf, &'static Foreign)> {
    let (named, stem) = (path.file_name()?, path.file_stem()?);
    let mut found: Vec<_> = path
        .parent()?
        .read_dir()
        .ok()?
        .flatten()
        .map(|entry| entry.path())
        .filter(|other| other.file_stem().is_some_and(|other| other == stem || other == named))
        .filter_map(|other| of_name(&other).map(|format| (other, format)))
        .collect();
    found.sort_by(|a, b| a.0.cmp(&b.0));
    found.into_iter().next()
}

/// Returns the format to which the extension of a file belongs.
pub(crate) fn of_name(path: &Path) -> Option<&'static Foreign> {
    let extension = path.extension()?.to_str()?.to_lowercase();
    ALL.into_iter().find(|format| format.extensions.contains(&extension.as_str()))
}

/// Returns the format that the first bytes of a file show.
fn of_content(head: &[u8]) -> Option<&'static Foreign> {
    // ISO base media files state their brand after the type of their first box.
    if head.get(4..8) == Some(b"ftyp") {
        return match head.get(8..12)? {
            b"avif" | b"avis" => Some(&AVIF),
            b"crx " => Some(&RAW),
            b"heic" | b"heix" | b"heim" | b"heis" | b"hevc" | b"hevx" | b"mif1" | b"msf1" => Some(&HEIC),
            _ => None,
        };
    }
    let starts: [(&[u8], &'static Foreign); 5] = [
        (b"FUJIFILMCCD-RAW", &RAW),
        (b"IIRO", &RAW),
        (b"GIF8", &GIF),
        (b"\xff\x0a", &JXL),
        (b"\0\0\0\x0cJXL ", &JXL),
    ];
    starts.into_iter().find(|(start, _)| head.starts_with(start)).map(|(_, format)| format)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    #[test]
    fn formats_are_told_by_content_and_then_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let cases: [(&str, &[u8], Option<&Foreign>); 9] = [
            ("a.png", b"\0\0\0\x18ftypheic\0\0\0\0", Some(&HEIC)),
            ("b.png", b"\0\0\0\x18ftypavif\0\0\0\0", Some(&AVIF)),
            ("c.png", b"RIFF\x10\0\0\0WEBPVP8 ", None),
            ("d.nef", b"MM\0*\0\0\0\x08", Some(&RAW)),
            ("e.tif", b"II*\0\x08\0\0\0", None),
            ("f.HEIF", b"", Some(&HEIC)),
            ("g.gif", b"GIF89a", Some(&GIF)),
            ("h.png", b"\x89PNG\r\n\x1a\n", None),
            ("i.jpg", b"\xff\xd8\xff", None),
        ];
        for (name, bytes, expected) in cases {
            let path = folder.path().join(name);
            fs::write(&path, bytes).unwrap();
            assert_eq!(of_file(&path), expected, "{name}");
        }
        let found = |name: &str| beside(&folder.path().join(name)).map(|(path, _)| path);
        assert_eq!(found("f.jpg"), Some(folder.path().join("f.HEIF")));
        assert_eq!(found("d"), Some(folder.path().join("d.nef")));
        assert_eq!((found("h.jpg"), found("x.png")), (None, None));
        assert_eq!(of_file(&folder.path().join("nowhere.png")), None);
        let remedy = HEIC.remedy(Path::new("images/a.heic"));
        assert!(remedy.contains("heif-convert images/a.heic images/a.png"), "{remedy}");
    }
}
