//! Files of a scene: their paths, and their bytes.

use std::{
    fs,
    path::{Path, PathBuf},
};
use trimip_core::{Error, Result};

/// The bytes of a file.
///
/// # Errors
/// Of kind `Input`: it cannot be read.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>> {
    fs::read(path).map_err(|error| {
        Error::input(path.display(), format!("cannot be read: {error}"), "check the path and its permissions")
    })
}

/// The first of several paths below a folder that is a file.
pub(crate) fn first(root: &Path, places: &[&str]) -> Option<PathBuf> {
    places.iter().map(|place| root.join(place)).find(|path| path.is_file())
}
