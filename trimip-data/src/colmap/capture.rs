//! Frames of a COLMAP model: photographs found and measured against their cameras, poses in OpenGL axes, points of the scene.
//! Frames are sorted by the names of their images; every 8th is the test split.

use super::{
    locate,
    model::{Model, ModelImage},
};
use crate::settings::DataConfig;
use crate::{
    division::{self, Selection},
    names,
    photograph::Photograph,
    points::{Cloud, Observation, Point},
    source::{Pixels, Source, map_in_order},
    split::Split,
};
use glam::{DMat3, DQuat, DVec3};
use std::{
    cell::Cell,
    collections::{BTreeSet, HashMap},
    path::{Path, PathBuf},
};
use trimip_core::{Camera, Error, Intrinsics, Result, plural::count};

/// A capture with a model, before any photograph is decoded.
pub(crate) struct Capture {
    /// The file of the images, for messages.
    file: PathBuf,
    frames: Vec<Frame>,
    scales: u32,
    warnings: Vec<String>,
    notes: Vec<String>,
    /// Given to the first split that is read.
    cloud: Cell<Cloud>,
}

/// A frame of the model.
struct Frame {
    name: String,
    place: String,
    path: PathBuf,
    camera: Camera,
}

impl Capture {
    /// Reads the model of a scene and finds its photographs.
    pub(crate) fn open(root: &Path, config: &DataConfig) -> Result<Self> {
        let found = locate::model(root)?;
        let mut model = Model::read(&found.folder)?;
        let file = locate::images_file(&found.folder);
        if model.images.is_empty() {
            let advice = "COLMAP placed no photograph: take more of them, with more overlap";
            return Err(Error::input(file.display(), "holds no image", advice));
        }
        model.images.sort_unstable_by(|a, b| a.name.cmp(&b.name));
        let image_names: Vec<&str> = model.images.iter().map(|image| image.name.as_str()).collect();
        let folder = locate::photographs(root, &config.images, &found.folder, &image_names)?;
        complete(&file, &folder, &image_names)?;
        let mut warnings: Vec<String> =
            found.warning.into_iter().chain(unplaced(&folder, &image_names)).collect();

        let cameras = model.cameras_of_images(&file.display().to_string())?;
        let names = names::unique(&image_names);
        let frames = model.images.iter().zip(cameras).zip(&names).map(|((image, camera), name)| {
            let place = format!("{}: {}", file.display(), image.place());
            Frame { name: name.clone(), path: folder.join(&image.name), place, camera }
        });
        let frames = frames.collect();
        let scaled = frames_scaled(frames, !config.images.is_empty())?;
        warnings.extend(scaled.warning);
        let cloud = cloud(&model, names, &scaled.factors);
        let notes = vec![format!(
            "COLMAP model {}: {}, {}, {}; world units are the model's",
            found.folder.display(),
            count(model.cameras.len(), "camera"),
            count(model.images.len(), "image"),
            count(model.points.len(), "point"),
        )];
        let scales = config.scales;
        Ok(Self { file, frames: scaled.frames, scales, warnings, notes, cloud: Cell::new(cloud) })
    }

    /// The frames of "train" or "test".
    pub(crate) fn split(&self, split: &str) -> Result<Split> {
        let selection = match split {
            "train" => Selection::Train,
            "test" => Selection::Test,
            _ => return Err(division::unknown(&self.file, split, "train, test")),
        };
        self.selected(split, &selection)
    }

    /// All frames.
    pub(crate) fn all(&self) -> Result<Split> {
        self.selected("train", &Selection::All)
    }

    fn selected(&self, split: &str, selection: &Selection) -> Result<Split> {
        let chosen = selection.choose(self.frames.len());
        if chosen.is_empty() {
            return Err(division::empty(&self.file, split, self.frames.len(), selection));
        }
        let (frames, scales) = (&self.frames, self.scales);
        let sources = map_in_order(&chosen, |_, &index| {
            let frame = &frames[index];
            let k = &frame.camera.intrinsics;
            let image = Photograph::open(frame.path.clone(), frame.place.clone())?;
            let image = image.fit(Some(k.width), Some(k.height));
            let pixels = Pixels::Photograph(image);
            Source::averaged(frame.name.clone(), frame.camera, scales, &frame.place, pixels)
        })?;
        let mut warnings = self.warnings.clone();
        warnings.extend(selection.warning(&self.file, "in order of their names"));
        let cloud = self.cloud.take();
        let stated = cloud.stated("of the COLMAP model");
        Ok(Split { sources, warnings, notes: self.notes.clone(), stated, cloud })
    }
}

impl Model {
    /// Camera-to-world cameras in OpenGL axes of all images, in their order; `file` names the file of the images.
    ///
    /// # Errors
    /// Of kind `Input`: a pose that is not finite, a camera that is not there.
    pub fn cameras_of_images(&self, file: &str) -> Result<Vec<Camera>> {
        let cameras: HashMap<u32, Intrinsics> =
            self.cameras.iter().map(|camera| (camera.id, camera.intrinsics())).collect();
        let camera = |image: &ModelImage| {
            let place = format!("{file}: {}", image.place());
            let (rotation, origin) = pose(image, &place)?;
            let unknown = || Error::input(&place, "has an unknown camera", "export the model again");
            let intrinsics = *cameras.get(&image.camera).ok_or_else(unknown)?;
            Ok(Camera { intrinsics, rotation, origin })
        };
        self.images.iter().map(camera).collect()
    }
}

/// Camera-to-world rotation in OpenGL axes, and centre: Rᵀ·diag(1, −1, −1) and −Rᵀ·t.
fn pose(image: &ModelImage, place: &str) -> Result<(DMat3, DVec3)> {
    // The largest part is 1, so that no square leaves the range of f64.
    let largest = image.rotation.iter().fold(0.0_f64, |largest, part| largest.max(part.abs()));
    let [w, x, y, z] = image.rotation.map(|part| part / largest);
    let to_world = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()).transpose();
    let origin = -(to_world * DVec3::from(image.translation));
    if !(to_world.is_finite() && origin.is_finite()) {
        return Err(Error::input(place, "has a pose that is not finite", "export the model again"));
    }
    Ok((DMat3::from_cols(to_world.x_axis, -to_world.y_axis, -to_world.z_axis), origin))
}

/// Refuses a folder that lacks photographs of the model.
fn complete(file: &Path, folder: &Path, names: &[&str]) -> Result<()> {
    let missing: Vec<&&str> = names.iter().filter(|name| !folder.join(name).is_file()).collect();
    let Some(first) = missing.first() else { return Ok(()) };
    Err(Error::input(
        file.display(),
        format!(
            "{} of {} photographs are missing, the first is {}",
            missing.len(),
            names.len(),
            folder.join(first).display()
        ),
        "copy them there, or set data.images to their folder",
    ))
}

/// A warning if photographs beside those of the model are not in it.
fn unplaced(folder: &Path, names: &[&str]) -> Option<String> {
    let parents: BTreeSet<PathBuf> =
        names.iter().filter_map(|name| folder.join(name).parent().map(Path::to_path_buf)).collect();
    let entries = parents.iter().flat_map(|parent| parent.read_dir().into_iter().flatten().flatten());
    let pictures = entries.filter(|entry| names::is_picture(&entry.path())).count();
    (pictures > names.len())
        .then(|| format!("COLMAP placed {} of {pictures} photographs in {}", names.len(), folder.display()))
}

/// Frames with cameras in the size of their photographs.
struct Scaled {
    frames: Vec<Frame>,
    /// Pixels of the photograph per pixel of the camera, along x and y.
    factors: Vec<[f64; 2]>,
    warning: Option<String>,
}

/// Compares photographs with cameras. Where the folder was `named`, photographs of another size but the same shape are
/// accepted, and their cameras scaled.
fn frames_scaled(mut frames: Vec<Frame>, named: bool) -> Result<Scaled> {
    let factors = map_in_order(&frames, |_, frame| {
        let k = &frame.camera.intrinsics;
        let image = Photograph::open(frame.path.clone(), frame.place.clone())?;
        let image = image.fit(Some(k.width), Some(k.height));
        let (sizes, own) = ([image.width, image.height], [k.width, k.height]);
        if sizes == own {
            return Ok([1.0; 2]);
        }
        // The factors that round to each side.
        let range = |side: usize| [-1.0, 1.0].map(|by| (f64::from(sizes[side]) + by) / f64::from(own[side]));
        let ([low_x, high_x], [low_y, high_y]) = (range(0), range(1));
        if named && low_x.max(low_y) < high_x.min(high_y) {
            return Ok([0, 1].map(|side| f64::from(sizes[side]) / f64::from(own[side])));
        }
        Err(Error::input(
            &frame.place,
            format!(
                "image {} is {}x{} pixels, but its camera has {}x{}",
                image.path.display(),
                sizes[0],
                sizes[1],
                own[0],
                own[1]
            ),
            "use the images the cameras were computed for; for the same images in another size, name their folder in \
             data.images",
        ))
    })?;
    let mut warning = None;
    for (frame, [x, y]) in frames.iter_mut().zip(&factors).filter(|(_, factors)| **factors != [1.0; 2]) {
        let k = &mut frame.camera.intrinsics;
        let side = |side: u32, by: f64| (f64::from(side) * by).round() as u32;
        (k.width, k.height) = (side(k.width, *x), side(k.height, *y));
        (k.fx, k.cx, k.fy, k.cy) = (k.fx * x, k.cx * x, k.fy * y, k.cy * y);
        warning = warning.or(Some(format!(
            "the photographs of data.images are {x:.4} times as wide as those of the COLMAP model: cameras are scaled along"
        )));
    }
    Ok(Scaled { frames, factors, warning })
}

/// Points with their tracks by frame, which must be in order of their names.
fn cloud(model: &Model, names: Vec<String>, factors: &[[f64; 2]]) -> Cloud {
    let frames: HashMap<u32, usize> =
        model.images.iter().enumerate().map(|(index, image)| (image.id, index)).collect();
    let observation = |[image, feature]: &[u32; 2]| {
        let view = *frames.get(image)?;
        let [x, y] = *model.images[view].places.get(*feature as usize)?;
        let [by_x, by_y] = factors[view];
        Some(Observation { view: view as u32, at: [x * by_x, y * by_y] })
    };
    let points = model.points.iter().map(|point| Point {
        position: point.position,
        color: point.color,
        error: (point.error >= 0.0).then_some(point.error),
        seen: Some(point.track.len()),
        track: point.track.iter().filter_map(observation).collect(),
    });
    Cloud { points: points.collect(), frames: names }
}
