//! Frames of a COLMAP model: their photographs, cameras at the size of the photographs, poses in OpenGL axes, and
//! points of the scene. Frames are sorted by the names of their images; every 8th is a test frame.

use super::{
    lenses::ModelCamera,
    locate,
    model::{Model, ModelImage},
};
use crate::settings::DataConfig;
use crate::{
    division::{self, Selection},
    intrinsics::{Fitted, fitted, scaled_along},
    names,
    photograph::Photograph,
    pictures::{self, Pictures},
    points::{Cloud, Observation, Point},
    realign::{self, Aligned, Gray, Torn},
    source::{Pixels, Source, map_in_order},
    split::Split,
};
use glam::{DMat3, DQuat, DVec3};
use std::{
    cell::Cell,
    collections::{BTreeSet, HashMap},
    path::{Path, PathBuf},
};
use trimip_core::{Camera, Error, Place, Result, plural::count};

/// A capture with a model, before any photograph is decoded.
pub(crate) struct Capture {
    /// The file that lists the images, for messages.
    file: PathBuf,
    frames: Vec<Frame>,
    scales: u32,
    warnings: Vec<String>,
    notes: Vec<String>,
    /// Points of the model; the first split that is read takes them.
    cloud: Cell<Cloud>,
}

/// A frame of the model.
struct Frame {
    name: String,
    place: Place,
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
            let advice = "take more photographs with more overlap: COLMAP placed none";
            return Err(Error::input(file.display(), "holds no image", advice));
        }
        let mut warnings: Vec<String> = found.warning.into_iter().collect();
        warnings.extend(without_camera(&mut model, &file)?);
        model.images.sort_unstable_by(|a, b| a.name.cmp(&b.name));
        let image_names: Vec<&str> = model.images.iter().map(|image| image.name.as_str()).collect();
        let folder = locate::photographs(root, &config.images, &found.folder, &image_names)?;
        warnings.extend(unplaced(&folder, &image_names));
        let looked_in = if config.images.is_empty() { root } else { &folder };
        let pictures = Pictures::named_from(&folder, looked_in);
        let entries = image_names.iter().map(|name| (*name, Place::from(&file)));
        let (paths, of_photographs) = pictures::of_most_entries(&pictures, &file, entries)?;
        warnings.extend(of_photographs);
        let mut there = paths.iter().map(Option::is_some);
        model.images.retain(|_| there.next().unwrap_or(false));

        let cameras = model.cameras_of_images(&file.display().to_string())?;
        let image_names: Vec<&str> = model.images.iter().map(|image| image.name.as_str()).collect();
        let names = names::unique(&image_names);
        let of_images = model.images.iter().zip(cameras).zip(&names).zip(paths.into_iter().flatten());
        let frames = of_images.map(|(((image, camera), name), path)| {
            let place = Place::part(&file, image.place());
            Frame { name: name.clone(), path, place, camera }
        });
        let mut frames: Vec<Frame> = frames.collect();
        let factors = scale_cameras(&mut frames)?;
        let mut cloud = cloud(&model, names, &factors);
        if config.realign {
            warnings.extend(realigned(&file, &mut frames, &mut cloud)?);
        }
        warnings.extend(scaled_along(&file, factors));
        let notes = vec![format!(
            "COLMAP model {}: {}, {}, {}; world units are the model's",
            found.folder.display(),
            count(model.cameras.len(), "camera"),
            count(model.images.len(), "image"),
            count(model.points.len(), "point"),
        )];
        let scales = config.scales;
        Ok(Self { file, frames, scales, warnings, notes, cloud: Cell::new(cloud) })
    }

    /// Returns the frames of "train" or "test".
    pub(crate) fn split(&self, split: &str) -> Result<Split> {
        let selection = match split {
            "train" => Selection::Train,
            "test" => Selection::Test,
            _ => return Err(division::unknown(&self.file, split, "train, test")),
        };
        self.selected(split, &selection)
    }

    /// Returns all frames.
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
        warnings.extend(selection.warning(&self.file));
        let divided = selection.note(&self.file, "in order of their names");
        let notes = divided.into_iter().chain(self.notes.iter().cloned()).collect();
        let cloud = self.cloud.take();
        let stated = cloud.stated("of the COLMAP model");
        Ok(Split { sources, warnings, notes, stated, cloud })
    }
}

impl Model {
    /// Returns the cameras of all images, in their order: camera-to-world with OpenGL axes. `file` names the file of the images in errors.
    ///
    /// # Errors
    /// Of kind `Input`: a pose or a camera that is not finite, and a missing camera.
    pub fn cameras_of_images(&self, file: &str) -> Result<Vec<Camera>> {
        let cameras: HashMap<u32, &ModelCamera> =
            self.cameras.iter().map(|camera| (camera.id, camera)).collect();
        let camera = |image: &ModelImage| {
            let place = Place::part(file, image.place());
            let (rotation, origin) = pose(image, &place)?;
            let wrong = |what: &str| Error::input(&place, what, "export the model again");
            let camera = cameras.get(&image.camera).ok_or_else(|| wrong("has an unknown camera"))?;
            if !camera.is_finite() {
                return Err(wrong("has a camera whose parameters are not finite"));
            }
            Ok(Camera { intrinsics: camera.intrinsics(), rotation, origin })
        };
        self.images.iter().map(camera).collect()
    }
}

/// Returns the camera-to-world rotation in OpenGL axes, Rᵀ·diag(1, −1, −1), and the centre of the camera, −Rᵀ·t.
fn pose(image: &ModelImage, place: &Place) -> Result<(DMat3, DVec3)> {
    // The largest component is scaled to ±1, so that no square leaves the range of f64.
    let largest = image.rotation.iter().fold(0.0_f64, |largest, part| largest.max(part.abs()));
    let [w, x, y, z] = image.rotation.map(|part| part / largest);
    let to_world = DMat3::from_quat(DQuat::from_xyzw(x, y, z, w).normalize()).transpose();
    let origin = -(to_world * DVec3::from(image.translation));
    if !(to_world.is_finite() && origin.is_finite()) {
        return Err(Error::input(place, "has a pose that is not finite", "export the model again"));
    }
    Ok((DMat3::from_cols(to_world.x_axis, -to_world.y_axis, -to_world.z_axis), origin))
}

/// Removes images whose cameras have parameters that are not finite, and returns a warning that names the first.
fn without_camera(model: &mut Model, file: &Path) -> Result<Option<String>> {
    let broken: BTreeSet<u32> =
        model.cameras.iter().filter(|camera| !camera.is_finite()).map(|camera| camera.id).collect();
    let all = model.images.len();
    let (out, kept) = model.images.drain(..).partition(|image| broken.contains(&image.camera));
    let out: Vec<ModelImage> = out;
    model.images = kept;
    let Some(first) = out.first() else { return Ok(None) };
    let what = format!("camera {} of {} has parameters that are not finite", first.camera, first.place());
    if model.images.is_empty() {
        return Err(Error::input(file.display(), what, "calibrate again and export the model"));
    }
    Ok(Some(format!(
        "{}: {what}: {} of {} are left out",
        file.display(),
        out.len(),
        count(all, "photograph")
    )))
}

/// Returns a warning if the folders of the model's photographs hold other photographs that are not in the model.
fn unplaced(folder: &Path, names: &[&str]) -> Option<String> {
    let parents: BTreeSet<PathBuf> =
        names.iter().filter_map(|name| folder.join(name).parent().map(Path::to_path_buf)).collect();
    let entries = parents.iter().flat_map(|parent| parent.read_dir().into_iter().flatten().flatten());
    let pictures = entries.filter(|entry| names::is_picture(&entry.path())).count();
    (pictures > names.len()).then(|| {
        format!("COLMAP placed {} of the {pictures} photographs in {}", names.len(), folder.display())
    })
}

/// Scales the cameras of frames to the size of their photographs. Returns for each frame the pixels of the photograph
/// per pixel of the camera, along x and y.
fn scale_cameras(frames: &mut [Frame]) -> Result<Vec<[f64; 2]>> {
    let fitted = map_in_order(frames, |_, frame| {
        let image = Photograph::open(frame.path.clone(), frame.place.clone())?;
        let Fitted { intrinsics, factors, .. } = fitted(image, frame.camera.intrinsics)?;
        Ok((intrinsics, factors))
    })?;
    for (frame, (intrinsics, _)) in frames.iter_mut().zip(&fitted) {
        frame.camera.intrinsics = *intrinsics;
    }
    Ok(fitted.into_iter().map(|(_, factors)| factors).collect())
}

/// Aligns detached parts of the model, and returns a warning if there are any.
fn realigned(file: &Path, frames: &mut [Frame], cloud: &mut Cloud) -> Result<Option<String>> {
    let picture = |index: usize| {
        let frame: &Frame = &frames[index];
        Gray::open(&Photograph::open(frame.path.clone(), frame.place.clone())?)
    };
    let model = realign::Model {
        names: frames.iter().map(|frame| frame.name.as_str()).collect(),
        cameras: frames.iter().map(|frame| frame.camera).collect(),
        points: cloud.points.clone(),
        picture: &picture,
    };
    let Some(Torn { aligned, warning }) = realign::realign(model)? else { return Ok(None) };
    if let Some(Aligned { cameras, points }) = aligned {
        frames.iter_mut().zip(cameras).for_each(|(frame, camera)| frame.camera = camera);
        cloud.points = points;
    }
    Ok(Some(format!("{}: {warning}", file.display())))
}

/// Returns the points, with the frames that saw them as tracks. `names` and `factors` are in the order of the model's images.
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
