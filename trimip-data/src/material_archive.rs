//! Archives of photographs or films, which are no scenes yet.

use crate::{
    archive::{self, Wanted},
    material::Material,
    readers::found,
};
use std::path::{Path, PathBuf};
use trimip_core::Result;

/// Unpacks an archive of photographs or of a film, unless that was done before, as an archive of a scene is unpacked: into a folder
/// beside it. Returns the folder, and what was unpacked where in words.
///
/// # Errors
/// Of kind `Input`: an archive that is broken, not to be trusted or holds nothing of this, and a folder that cannot be written or is another's.
pub fn unpack_material(archive: &Path) -> Result<(PathBuf, String)> {
    let is_scene = |folder: &Path| found(folder).is_some() || Material::of(folder).is_any();
    let unpacked =
        archive::unpacked(archive, &Wanted { is_scene: &is_scene, files: "photographs and films" })?;
    Ok((unpacked.root, unpacked.note))
}
