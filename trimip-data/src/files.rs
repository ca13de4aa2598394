//! Reads files of a scene, and finds the first that exists.

use std::path::{Path, PathBuf};
use trimip_core::{Error, Result, plain_file};

/// Reads the bytes of a file.
///
/// # Errors
/// Of kind `Input`, if the file cannot be read.
pub(crate) fn read(path: &Path) -> Result<Vec<u8>> {
    plain_file::read(path).map_err(|error| {
        Error::input(path.display(), format!("cannot be read: {error}"), "check the path and its permissions")
    })
}

/// Returns the first of the paths `places` below `root` that is a file.
pub(crate) fn first(root: &Path, places: &[&str]) -> Option<PathBuf> {
    places.iter().map(|place| root.join(place)).find(|path| path.is_file())
}
