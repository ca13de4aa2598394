//! Archives of photographs or films without cameras.

use crate::{
    archive::{self, Wanted},
    material::Material,
    readers::found,
};
use std::path::{Path, PathBuf};
use trimip_core::Result;

/// Unpacks an archive of photographs or of a film to a folder next to it, as archives of scenes are unpacked, unless
/// this folder exists already. Returns the folder, and a note about the unpacked files.
///
/// # Errors
/// Of kind `Input`: an archive that is broken, unsafe or holds no such files, and a folder that cannot be written or
/// that was not made from this archive.
pub fn unpack_material(archive: &Path) -> Result<(PathBuf, String)> {
    let is_scene = |folder: &Path| found(folder).is_some() || Material::of(folder).is_any();
    let unpacked =
        archive::unpacked(archive, &Wanted { is_scene: &is_scene, files: "photographs and films" })?;
    Ok((unpacked.root, unpacked.note))
}
