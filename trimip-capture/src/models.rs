//! The models that a mapper wrote. There are several if the pictures fall apart into groups without common points. The model with the most
//! pictures whose cameras are not lost is used.

use super::folder::unwritable;
use serde::{Deserialize, Serialize};
use std::{
    collections::BTreeSet,
    fs,
    path::{Path, PathBuf},
};
use trimip::Result;
use trimip_core::scene::strays::{LOST, lost};
use trimip_data::colmap::Model;

/// A model of the mapper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Placed {
    /// Folder of the model in `models/`.
    pub folder: String,
    /// Pictures whose cameras the model contains.
    pub pictures: BTreeSet<String>,
    /// Pictures of this model with a [lost](trimip_core::scene::strays::lost) camera.
    #[serde(default)]
    pub lost: BTreeSet<String>,
    /// Number of points of the model.
    pub points: usize,
    /// Mean reprojection error over the points, pixels; `None` if the model states none.
    pub error: Option<f64>,
}

impl Placed {
    /// Returns the number of pictures of this model whose cameras are not lost.
    pub fn sound(&self) -> usize {
        self.pictures.len() - self.lost.len()
    }
}

/// Result of the mapper.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Models {
    /// All models; the one with the most pictures whose cameras are not lost comes first.
    pub models: Vec<Placed>,
}

impl Models {
    /// Returns the number of pictures of the best model whose cameras are not lost.
    pub fn sound(&self) -> usize {
        self.models.first().map_or(0, Placed::sound)
    }

    /// Returns the number of lost cameras in the best model, in words; `None` if it has none.
    pub fn lost(&self) -> Option<String> {
        let best = self.models.first().filter(|best| !best.lost.is_empty())?;
        Some(format!(
            "{} of {} are more than {LOST} times as far from the centre as the median camera",
            best.lost.len(),
            best.pictures.len()
        ))
    }
}

/// Reads the models in the folders of `root`. The one with the most pictures whose cameras are not lost comes first; if these numbers are
/// equal, the one with more points.
///
/// # Errors
/// When a model cannot be read.
pub fn read(root: &Path) -> Result<Models> {
    let entries = root.read_dir().map_err(|error| unwritable(root, &error))?;
    let mut folders: Vec<PathBuf> =
        entries.flatten().map(|entry| entry.path()).filter(|path| holds_model(path)).collect();
    folders.sort();
    // Some mappers write a single model directly into the folder.
    if folders.is_empty() && holds_model(root) {
        folders.push(root.into());
    }
    let mut models = folders.iter().map(|folder| placed(root, folder)).collect::<Result<Vec<_>>>()?;
    models.retain(|model| !model.pictures.is_empty());
    models.sort_by(|a, b| b.sound().cmp(&a.sound()).then(b.points.cmp(&a.points)));
    Ok(Models { models })
}

fn holds_model(folder: &Path) -> bool {
    ["bin", "txt"].iter().any(|end| folder.join(format!("images.{end}")).is_file())
}

fn placed(root: &Path, folder: &Path) -> Result<Placed> {
    let model = Model::read(folder)?;
    let errors: Vec<f64> =
        model.points.iter().map(|point| point.error).filter(|error| *error >= 0.0).collect();
    let name = folder.strip_prefix(root).unwrap_or(folder).display().to_string();
    // If cameras cannot be read, the reader of the scene reports that later.
    let lost = model.cameras_of_images(&name).map_or_else(|_| Vec::new(), |cameras| lost(&cameras));
    Ok(Placed {
        folder: name,
        lost: lost.into_iter().map(|index| model.images[index].name.clone()).collect(),
        points: model.points.len(),
        error: (!errors.is_empty()).then(|| errors.iter().sum::<f64>() / errors.len() as f64),
        pictures: model.images.into_iter().map(|image| image.name).collect(),
    })
}

/// Copies the files of a model into a new folder.
///
/// # Errors
/// When they cannot be copied.
pub fn copy(from: &Path, to: &Path) -> Result<()> {
    fs::create_dir_all(to).map_err(|error| unwritable(to, &error))?;
    for entry in from.read_dir().map_err(|error| unwritable(from, &error))?.flatten() {
        let (path, target) = (entry.path(), to.join(entry.file_name()));
        if path.is_file() {
            fs::copy(&path, &target).map_err(|error| unwritable(&target, &error))?;
        }
    }
    Ok(())
}
