//! The crop of a stored model.

use super::folder::RunFolder;
use super::lock::lock_for_writing;
use std::path::Path;
use trimip_core::field::model::Model;
use trimip_core::{Crop, Error, Result};

/// Makes `crop` the crop (`scene.crop`) of the model in a run folder, or of a model file. The crop is in the coordinates of the model, that
/// is, relative to `data.origin`. Training that continues replaces the model, and with it the crop.
///
/// # Errors
/// When there is no model, another process writes into the folder, or the file cannot be replaced.
pub fn keep_crop(model: &Path, crop: Crop) -> Result<()> {
    let file = if model.is_dir() { RunFolder::new(model).model() } else { model.to_path_buf() };
    if model.is_dir() && !file.exists() {
        return Err(Error::input(
            model.display(),
            "no model.safetensors in this folder",
            "train to the end first, or name a model file",
        ));
    }
    let _held = lock_for_writing(&file)?;
    let mut stored = Model::read(&file)?;
    stored.config.scene.crop = crop;
    Model::new(stored.config, stored.file).write(&file)?;
    Ok(())
}
