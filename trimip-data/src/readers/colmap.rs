//! The reader of COLMAP models: [`Capture`] as a scene.

use super::reader::{OpenScene, Reader};
use crate::{
    colmap::{Capture, is_there},
    split::Split,
};
use trimip_core::Result;

pub(super) static READER: Reader = Reader {
    format: "colmap",
    name: "COLMAP model",
    files: Some("a COLMAP model (sparse/0)"),
    recognises: is_there,
    open: |root, config| Ok(Box::new(Capture::open(root, config)?)),
    images: Some("COLMAP models"),
    divisible: true,
    ..Reader::PLAIN
};

impl OpenScene for Capture {
    fn split(&self, split: &str) -> Result<Split> {
        Self::split(self, split)
    }

    fn undivided(&self) -> Result<Option<Split>> {
        self.all().map(Some)
    }
}
