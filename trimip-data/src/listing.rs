//! Frames that a file lists with their cameras, as other programs export them. Their photographs are found, and measured against the
//! cameras, when a split is read.

use crate::{
    division::{self, Selection},
    intrinsics::{factors, scaled},
    names,
    photograph::Photograph,
    pictures::{self, Pictures},
    points::{Cloud, Point},
    readers::reader::OpenScene,
    settings::DataConfig,
    source::{Pixels, Source, map_in_order},
    split::Split,
};
use glam::{DMat3, DVec3};
use std::{
    cell::Cell,
    path::{Path, PathBuf},
};
use trimip_core::{Camera, Error, Intrinsics, Lens, Result, scene_plan::StatedBox};

/// A frame of a file.
#[derive(Clone, Debug)]
pub(crate) struct Listed {
    /// The path that the file states for its photograph.
    pub(crate) named: String,
    /// The entry, for messages.
    pub(crate) place: String,
    /// Camera-to-world rotation in OpenGL axes.
    pub(crate) rotation: DMat3,
    /// Centre of projection, world units.
    pub(crate) origin: DVec3,
    pub(crate) calibration: Calibration,
    /// Its split, if the file divides frames.
    pub(crate) split: Option<&'static str>,
}

/// What a file states of the scene beside its frames.
#[derive(Default)]
pub(crate) struct Stated {
    /// The box; without it, it lies around the points.
    pub(crate) aabb: Option<StatedBox>,
    pub(crate) points: Vec<Point>,
    pub(crate) warnings: Vec<String>,
}

/// How a photograph was projected.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Calibration {
    /// For photographs of a stated size.
    Sized(Intrinsics),
    /// For photographs as they are, with the principal point in their middle: the focal length in their pixels, and the lens.
    Centred(f64, Lens),
    /// For photographs as they are: lengths are in their pixels, and the size of these intrinsics means nothing.
    Unsized(Intrinsics),
}

impl Listed {
    /// The camera of a photograph of that size.
    pub(crate) fn camera(&self, size: [u32; 2]) -> Camera {
        let intrinsics = match self.calibration {
            Calibration::Sized(intrinsics) => intrinsics,
            Calibration::Unsized(intrinsics) => Intrinsics { width: size[0], height: size[1], ..intrinsics },
            Calibration::Centred(focal, lens) => {
                let [width, height] = size;
                let [cx, cy] = size.map(|side| 0.5 * f64::from(side));
                Intrinsics { width, height, fx: focal, fy: focal, cx, cy, lens }
            }
        };
        Camera { intrinsics, rotation: self.rotation, origin: self.origin }
    }
}

/// A frame whose pose is world-to-camera with x right, y down and z forward, as in computer vision.
pub(crate) fn vision_pose(to_camera: DMat3, translation: DVec3) -> (DMat3, DVec3) {
    let to_world = to_camera.transpose();
    (DMat3::from_cols(to_world.x_axis, -to_world.y_axis, -to_world.z_axis), -(to_world * translation))
}

/// All frames of a scene; every 8th is the test split, unless the file divides them.
pub(crate) struct Listing {
    file: PathBuf,
    frames: Vec<Listed>,
    names: Vec<String>,
    pictures: Pictures,
    scales: u32,
    warnings: Vec<String>,
    aabb: Option<StatedBox>,
    /// Given to the first split that is read.
    cloud: Cell<Cloud>,
}

impl Listing {
    /// The frames of `file` in the folder of a scene.
    ///
    /// # Errors
    /// Of kind `Input`: there is no frame, or `data.images` is no folder.
    pub(crate) fn new(
        root: &Path,
        config: &DataConfig,
        file: &Path,
        mut frames: Vec<Listed>,
        stated: Stated,
    ) -> Result<Self> {
        let Stated { aabb, points, warnings } = stated;
        if frames.is_empty() {
            return Err(Error::input(file.display(), "has no frame with a pose", "export the cameras again"));
        }
        frames.sort_by(|a, b| a.named.cmp(&b.named));
        let names = names::unique(&frames.iter().map(|frame| frame.named.as_str()).collect::<Vec<_>>());
        let pictures = Pictures::new(pictures::stated(root, &config.images)?);
        let cloud = Cell::new(Cloud { points, frames: names.clone() });
        Ok(Self { file: file.into(), frames, names, pictures, scales: config.scales, warnings, aabb, cloud })
    }

    /// True if the file divides the frames.
    fn is_divided(&self) -> bool {
        self.frames.iter().any(|frame| frame.split.is_some())
    }

    fn selected(&self, split: &str, selection: &Selection) -> Result<Split> {
        let of_split = |frame: &Listed| frame.split == Some(split);
        let chosen = match selection {
            Selection::All => selection.choose(self.frames.len()),
            _ if self.is_divided() => {
                (0..self.frames.len()).filter(|&index| of_split(&self.frames[index])).collect()
            }
            _ => selection.choose(self.frames.len()),
        };
        if chosen.is_empty() {
            return Err(division::empty(&self.file, split, self.frames.len(), selection));
        }
        let entries =
            chosen.iter().map(|&index| (self.frames[index].named.as_str(), self.frames[index].place.clone()));
        let (paths, moved) = pictures::of_entries(&self.pictures, entries)?;
        let chosen: Vec<_> = chosen.into_iter().zip(paths).collect();
        let (frames, names, scales) = (&self.frames, &self.names, self.scales);
        let found = map_in_order(&chosen, |_, (index, path)| {
            let frame = &frames[*index];
            let image = Photograph::open(path.clone(), frame.place.clone())?;
            let (image, camera, factors) = fitted(frame, image)?;
            let (name, pixels) = (names[*index].clone(), Pixels::Photograph(image));
            Ok((Source::averaged(name, camera, scales, &frame.place, pixels)?, factors))
        })?;
        let (sources, factors): (Vec<Source>, Vec<_>) = found.into_iter().unzip();
        let by = factors.into_iter().flatten().next().map(|[x, _]| {
            format!(
                "the photographs of {} are {x:.4} times as wide as it states: cameras are scaled along",
                self.file.display()
            )
        });
        let divided = selection.warning(&self.file, "in order of their names").filter(|_| !self.is_divided());
        let warnings = self.warnings.iter().cloned().chain(divided).chain(moved).chain(by).collect();
        let cloud = self.cloud.take();
        let stated = self.aabb.clone().or_else(|| cloud.stated(&format!("of {}", self.file.display())));
        Ok(Split { sources, warnings, stated, cloud, ..Split::default() })
    }
}

impl OpenScene for Listing {
    fn split(&self, split: &str) -> Result<Split> {
        match split {
            "train" => self.selected(split, &Selection::Train),
            "test" => self.selected(split, &Selection::Test),
            _ if self.is_divided() && self.has_split(split)? => self.selected(split, &Selection::Train),
            _ => Err(division::unknown(&self.file, split, "train, test")),
        }
    }

    fn has_split(&self, split: &str) -> Result<bool> {
        let is_there = |frame: &Listed| frame.split == Some(split);
        Ok(!self.is_divided() && ["train", "test"].contains(&split) || self.frames.iter().any(is_there))
    }

    fn undivided(&self) -> Result<Option<Split>> {
        self.selected("train", &Selection::All).map(Some)
    }
}

/// A photograph turned as its camera sees it, the camera in its size, and by which factors it was scaled.
fn fitted(frame: &Listed, image: Photograph) -> Result<(Photograph, Camera, Option<[f64; 2]>)> {
    let Calibration::Sized(k) = frame.calibration else {
        let camera = frame.camera([image.width, image.height]);
        return Ok((image, camera, None));
    };
    let image = image.fit(Some(k.width), Some(k.height));
    let (own, sizes) = ([k.width, k.height], [image.width, image.height]);
    let camera = frame.camera(sizes);
    if own == sizes {
        return Ok((image, camera, None));
    }
    let Some(factors) = factors(own, sizes) else {
        let what = format!(
            "image {} is {}x{} pixels, but the file states {}x{}",
            image.path.display(),
            sizes[0],
            sizes[1],
            own[0],
            own[1]
        );
        return Err(Error::input(
            &frame.place,
            what,
            "use the images the cameras were computed for, or others of their shape",
        ));
    };
    Ok((image, Camera { intrinsics: scaled(camera.intrinsics, factors), ..camera }, Some(factors)))
}
