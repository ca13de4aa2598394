//! `cameras.json` of a run folder: the cameras of the training photographs at their finest scale, in the layout of a camera path.

use super::folder::RunFolder;
use crate::view::{self, Named};
use std::path::Path;
use trimip_core::{Camera, Intrinsics, Result, ViewSet, scene::origin::LocalOrigin};

/// File name of the finished model in a run folder.
const MODEL: &str = "model.safetensors";

/// Returns the cameras of the finest photographs of a set, in their order, with the names of the photographs.
pub fn finest(views: &ViewSet) -> Vec<Named> {
    let finest = views.scales.first().map(|scale| &views.views[scale.views.clone()]).unwrap_or_default();
    finest.iter().map(|view| (view.name.clone(), view.camera)).collect()
}

/// Returns the training cameras stored in the run folder `model`, or in the run folder of the model file `model`, in the order of
/// the photographs and in coordinates relative to `origin`, the model's local origin. `None` if no cameras are stored, as in runs
/// of earlier versions.
///
/// # Errors
/// When the file exists but contains no valid cameras.
pub fn training_cameras(model: &Path, origin: LocalOrigin) -> Result<Option<Vec<Camera>>> {
    let named = named_training_cameras(model, origin)?;
    Ok(named.map(|named| named.into_iter().map(|(_, camera)| camera).collect()))
}

/// Returns the cameras of [`training_cameras`] with the names of their photographs.
///
/// # Errors
/// As [`training_cameras`].
pub fn named_training_cameras(model: &Path, origin: LocalOrigin) -> Result<Option<Vec<Named>>> {
    let folder = match model.is_dir() {
        true => Some(model),
        false if model.file_name().is_some_and(|name| name == MODEL) => model.parent(),
        false => None,
    };
    let Some(path) = folder.map(|folder| RunFolder::new(folder).cameras()).filter(|path| path.is_file())
    else {
        return Ok(None);
    };
    // Every frame states its projection.
    view::cameras::named_path(&path, Intrinsics::default(), origin).map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::view::write_cameras;
    use glam::DVec3;

    #[test]
    fn cameras_are_those_of_the_run_of_the_model() {
        let folder = tempfile::tempdir().unwrap();
        let here = folder.path();
        let origin = LocalOrigin::at(&[448_260.0, 5_411_932.0, 311.0]);
        assert_eq!(training_cameras(here, origin).unwrap(), None);
        let eye = DVec3::new(3.0, 0.1, 0.7);
        let camera = Camera::look_at(Intrinsics::from_angle(40, 30, 0.7), eye, DVec3::ZERO, DVec3::Z);
        write_cameras(&RunFolder::new(here).cameras(), &[("a".into(), camera)], origin, None).unwrap();
        for model in [here.to_path_buf(), here.join(MODEL)] {
            let found = training_cameras(&model, origin).unwrap().unwrap();
            assert!(found.len() == 1 && (found[0].origin - eye).length() < 2e-9);
            assert_eq!(found[0].intrinsics.width, 40);
            assert_eq!(named_training_cameras(&model, origin).unwrap().unwrap()[0].0, "a");
        }
        assert_eq!(
            training_cameras(&here.join("other.safetensors"), origin).unwrap(),
            None,
            "it may be of another run"
        );
        std::fs::write(RunFolder::new(here).cameras(), "{").unwrap();
        assert_eq!(training_cameras(here, origin).unwrap_err().kind(), trimip_core::ErrorKind::Input);
    }
}
