//! Folders of scenes: the eight Blender scenes of NeRF, at one scale or as multi-scale sets, in the order of the papers' tables.

use crate::layout::{self, Layout};
use crate::readers::found;
use crate::settings::DataConfig;
use std::path::{Path, PathBuf};
use trimip_core::{Error, Result};

/// The eight Blender scenes (Mildenhall et al. 2020), in the order of the papers' tables.
pub const BLENDER_SCENES: [&str; 8] =
    ["chair", "drums", "ficus", "hotdog", "lego", "materials", "mic", "ship"];

/// The Blender scenes in a folder.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Collection {
    /// Folders of the scenes that exist, in the order of [`BLENDER_SCENES`].
    pub found: Vec<PathBuf>,
    /// Names of the scenes that do not exist.
    pub missing: Vec<&'static str>,
}

impl Collection {
    /// Looks for the Blender scenes in a folder by their names.
    ///
    /// # Errors
    /// If none of them exists.
    pub fn open(folder: &Path) -> Result<Self> {
        if !folder.is_dir() {
            let what = if folder.exists() { "is not a folder" } else { "does not exist" };
            return Err(Error::input(
                folder.display(),
                what,
                "name the folder of a scene, or one that holds scenes",
            ));
        }
        let (there, missing): (Vec<_>, Vec<_>) =
            BLENDER_SCENES.into_iter().partition(|name| is_scene(&folder.join(name)));
        if there.is_empty() {
            return Err(Error::input(
                folder.display(),
                "holds no scene, and no folder chair, drums, ficus, hotdog, lego, materials, mic or ship with a scene",
                "name the folder of a scene, with transforms_train.json or metadata.json, or the folder of these scenes",
            ));
        }
        Ok(Self { found: there.into_iter().map(|name| folder.join(name)).collect(), missing })
    }
}

/// Returns true if the files in a folder are those of a scene.
pub fn is_scene(folder: &Path) -> bool {
    found(folder).is_some()
}

/// Returns false if the scene that the settings name is known to have no such split. Reads no image.
///
/// # Errors
/// If the folder holds no scene.
pub fn has_split(config: &DataConfig, split: &str) -> Result<bool> {
    let (config, _) = layout::unpacked(config)?;
    Layout::open(&config)?.has_split(split)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scenes_of_a_folder_come_in_the_order_of_the_tables() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["ship", "chair", "lego", "other"] {
            std::fs::create_dir(folder.path().join(name)).unwrap();
        }
        for name in ["ship", "lego", "other"] {
            std::fs::write(folder.path().join(name).join("transforms_train.json"), "{\"frames\": []}")
                .unwrap();
        }
        let collection = Collection::open(folder.path()).unwrap();
        assert_eq!(collection.found, ["lego", "ship"].map(|name| folder.path().join(name)));
        assert_eq!(collection.missing, ["chair", "drums", "ficus", "hotdog", "materials", "mic"]);
        for bad in ["other", "absent"] {
            assert_eq!(
                Collection::open(&folder.path().join(bad)).unwrap_err().kind(),
                trimip_core::ErrorKind::Input
            );
        }
    }
}
