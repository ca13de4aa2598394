//! The reader of COLMAP models: [`Capture`] as a scene.

use super::reader::{OpenScene, Reader};
use crate::{
    colmap::{Capture, is_there},
    names,
    split::Split,
};
use std::path::Path;
use trimip_core::Result;

pub(super) static READER: Reader = Reader {
    format: "colmap",
    name: "COLMAP model",
    files: Some("a COLMAP model (sparse/0)"),
    recognises: is_there,
    open: |root, config| Ok(Box::new(Capture::open(root, config)?)),
    advises: pictures,
    images: Some("COLMAP models"),
    divisible: true,
    ..Reader::PLAIN
};

/// Photographs alone lack cameras.
fn pictures(root: &Path) -> Option<String> {
    let entries = root.read_dir().into_iter().flatten().flatten();
    match entries.filter(|entry| names::is_picture(&entry.path())).count() {
        0 => None,
        count => Some(format!(
            "its {count} pictures need cameras: COLMAP finds them, and its model in sparse/0 is read"
        )),
    }
}

impl OpenScene for Capture {
    fn split(&self, split: &str) -> Result<Split> {
        Capture::split(self, split)
    }

    fn undivided(&self) -> Result<Option<Split>> {
        self.all().map(Some)
    }
}
