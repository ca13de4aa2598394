//! The type of a scene reader. Each reader is one file with a value of this type, and one line of the registry.

use crate::settings::DataConfig;
use crate::split::Split;
use std::path::Path;
use trimip_core::{Camera, Result};

/// A kind of scene and how it is read.
pub(crate) struct Reader {
    /// Value of `data.format` that selects the reader.
    pub(crate) format: &'static str,
    /// The kind of scene in words, after "a" or "this is a".
    pub(crate) name: &'static str,
    /// The files by which it recognises a scene, in words; `None` if the scene needs no folder.
    pub(crate) files: Option<&'static str>,
    /// True if the files of a folder are those of such a scene.
    pub(crate) recognises: fn(&Path) -> bool,
    /// Opens the scene in a folder. Cameras may be read here or with each split; no photograph is decoded.
    pub(crate) open: fn(&Path, &DataConfig) -> Result<Box<dyn OpenScene>>,
    /// Name of such scenes in the plural, if `data.images` can name the folder of their photographs; otherwise `None`.
    pub(crate) images: Option<&'static str>,
    /// True if `data.test_list` can divide the frames of such scenes.
    pub(crate) divisible: bool,
    /// Files of cameras, poses or intrinsics that can be read on their own.
    pub(crate) camera_files: &'static [CameraFile],
}

impl Reader {
    /// Defaults of optional fields: `..Reader::PLAIN` completes a reader.
    pub(super) const PLAIN: Self = Self {
        format: "",
        name: "",
        files: Some(""),
        recognises: |_| false,
        open: |_, _| Err(trimip_core::Error::run("a reader without a function that opens")),
        images: None,
        divisible: false,
        camera_files: &[],
    };
}

/// A scene that a reader has opened.
pub(crate) trait OpenScene {
    /// Returns the frames of a split with the headers of their photographs.
    fn split(&self, split: &str) -> Result<Split>;

    /// Returns false if the scene is known to have no such split. Some missing splits are found only when they are read.
    fn has_split(&self, _split: &str) -> Result<bool> {
        Ok(true)
    }

    /// Returns true if the files state which frames are for training and which for testing.
    fn states_splits(&self) -> Result<bool> {
        Ok(false)
    }

    /// Returns all frames of a file without splits, from which `data.test_list` chooses, or `None` if it chooses from
    /// the splits `data.train` and `data.test`.
    fn undivided(&self) -> Result<Option<Split>> {
        Ok(None)
    }
}

/// Cameras with the short names of their photographs.
pub type NamedCameras = Vec<(String, Camera)>;

/// A file of cameras that can be read on its own, from bytes in memory, and tested with arbitrary bytes.
#[derive(Clone, Copy, Debug)]
pub struct CameraFile {
    /// Name of this kind of file.
    pub kind: &'static str,
    /// Its usual path in the folder of the scene; if there are several, the most usual one.
    pub file: &'static str,
    /// Returns short names and cameras of all frames. The first argument names the file in errors. Photographs without a stated size
    /// have 8 × 6 pixels. Files with only poses get the reader's example of intrinsics, files with only intrinsics an example pose.
    ///
    /// # Errors
    /// Of kind `Input`: invalid syntax, and values that are missing or out of range.
    pub cameras: fn(&str, &[u8]) -> Result<NamedCameras>,
    /// A small valid file.
    pub example: fn() -> Vec<u8>,
    /// Most memory that reading takes, as a multiple of the file's bytes.
    pub memory: usize,
}
