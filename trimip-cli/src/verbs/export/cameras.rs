//! `export cameras`: writes the cameras of the photographs, or of a path, in a format that other programs read.

use crate::{
    args::{CameraSet, CamerasArguments},
    terminal,
};
use std::path::Path;
use trimip::run::folder::{self as run_folder, RunFolder};
use trimip::view::{self, CameraFormat, Named};
use trimip::{Config, Error, Intrinsics, Result};
use trimip_core::scene::origin::LocalOrigin;

/// Writes the cameras.
pub fn export(arguments: &CamerasArguments) -> Result<u8> {
    let model = run_folder::read_model(&arguments.model)?;
    let origin = LocalOrigin::of(&model.config.data);
    let beside = || {
        let own = &arguments.model;
        let folder = if own.is_dir() { own } else { own.parent().unwrap_or(Path::new("")) };
        folder.join("colmap")
    };
    let out = arguments.out.clone().unwrap_or_else(beside);
    CameraFormat::of(&out)?;
    let cameras = match (&arguments.path, arguments.views) {
        (Some(file), _) => view::cameras::named_path(file, Intrinsics::from_angle(800, 800, 0.7), origin)?,
        (None, CameraSet::Train) => training(&arguments.model, origin)?,
        (None, CameraSet::Test) => test(&model.config)?,
        (None, CameraSet::All) => [training(&arguments.model, origin)?, test(&model.config)?].concat(),
    };
    if let Some(folder) = out.parent().filter(|folder| !folder.as_os_str().is_empty()) {
        run_folder::create_writable(folder)?;
    }
    let (files, notes) = view::export_cameras(&out, &cameras, origin)?;
    notes.iter().for_each(|note| terminal::aside(format!("warning: {note}")));
    terminal::prose(terminal::many(cameras.len() as u64, "camera"));
    files.iter().for_each(|file| terminal::line(file.display()));
    Ok(0)
}

/// Returns the cameras of the training photographs as the run has used or refined them.
fn training(model: &Path, origin: LocalOrigin) -> Result<Vec<Named>> {
    let folder = if model.is_dir() { model } else { model.parent().unwrap_or(Path::new(".")) };
    let path = RunFolder::new(folder).cameras();
    if !path.is_file() {
        return Err(Error::input(
            path.display(),
            "does not exist: the cameras of the training photographs are unknown",
            "name the folder of a run, not a copy of its model",
        ));
    }
    // Every frame states its projection.
    view::cameras::named_path(&path, Intrinsics::default(), origin)
}

/// Returns the cameras of the test photographs at their finest scale, from the data set.
fn test(config: &Config) -> Result<Vec<Named>> {
    let frames = trimip_data::open_test(&config.section()?)?.frames;
    let (names, cameras) = (frames.names(), frames.cameras());
    let scales = cameras.len() / names.len().max(1);
    if scales * names.len() == cameras.len() {
        return Ok(names.into_iter().zip(cameras.into_iter().step_by(scales.max(1))).collect());
    }
    // The frames have different numbers of scales.
    let finest = |index: usize| {
        let set = frames.load(index)?;
        let view = set.views.first().ok_or_else(|| Error::run("a test frame has no view"))?;
        Ok((view.name.clone(), view.camera))
    };
    (0..frames.len()).map(finest).collect()
}
