//! Frames and cameras that a file of another program lists. Their photographs are found when the file is opened, and
//! compared with the cameras when a split is read.

use crate::{
    depth_image::DepthFile,
    division::{self, Selection},
    intrinsics::{Fitted, fitted, scaled_along},
    names,
    photograph::Photograph,
    pictures::{self, Pictures},
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
use trimip_core::{Camera, Error, Intrinsics, Lens, Place, Result};

/// A frame of a file.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    /// The path that the file states for its photograph.
    pub(crate) named: String,
    /// The entry, for messages.
    pub(crate) place: Place,
    /// Camera-to-world rotation in OpenGL axes.
    pub(crate) rotation: DMat3,
    /// Centre of projection, world units.
    pub(crate) origin: DVec3,
    pub(crate) calibration: Calibration,
    /// Its split, if the file divides frames.
    pub(crate) split: Option<&'static str>,
}

/// Intrinsics of a photograph, in the form in which its file states them.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Calibration {
    /// For photographs of a stated size.
    Sized(Intrinsics),
    /// For photographs of any size: lengths are in pixels of the photograph. Without `centre`, the principal point is
    /// the middle of the photograph.
    Unsized { focal: [f64; 2], centre: Option<[f64; 2]>, lens: Lens },
    /// For photographs of any size: lengths are multiples of the photograph's longer side, and the principal point is
    /// relative to its middle.
    Relative { focal: f64, centre: [f64; 2], lens: Lens },
}

impl Calibration {
    /// Returns the intrinsics; `[width, height]` is the size of the photograph if the file states none.
    fn intrinsics(&self, [width, height]: [u32; 2]) -> Intrinsics {
        match *self {
            Self::Sized(intrinsics) => intrinsics,
            Self::Unsized { focal: [fx, fy], centre, lens } => {
                let [cx, cy] = centre.unwrap_or([width, height].map(|side| 0.5 * f64::from(side)));
                Intrinsics { width, height, fx, fy, cx, cy, lens }
            }
            Self::Relative { focal, centre: [x, y], lens } => {
                let longer = f64::from(width.max(height));
                let (fx, fy) = (focal * longer, focal * longer);
                let (cx, cy) = (0.5 * f64::from(width) + x * longer, 0.5 * f64::from(height) + y * longer);
                Intrinsics { width, height, fx, fy, cx, cy, lens }
            }
        }
    }
}

impl Frame {
    /// Returns the camera; `size` is the size of the photograph if the file states none.
    pub(crate) fn camera(&self, size: [u32; 2]) -> Camera {
        let intrinsics = self.calibration.intrinsics(size);
        Camera { intrinsics, rotation: self.rotation, origin: self.origin }
    }
}

/// Converts a world-to-camera pose with x right, y down and z forward, as in computer vision, to the camera-to-world
/// rotation in OpenGL axes and the centre.
pub(crate) fn vision_pose(to_camera: DMat3, translation: DVec3) -> (DMat3, DVec3) {
    let to_world = to_camera.transpose();
    (DMat3::from_cols(to_world.x_axis, -to_world.y_axis, -to_world.z_axis), -(to_world * translation))
}

/// All frames of a scene whose photographs exist. Every 8th is a test frame, unless the file divides the frames.
pub(crate) struct Listing {
    file: PathBuf,
    frames: Vec<(Frame, PathBuf)>,
    /// The depth image of each frame that has one.
    depths: Vec<Option<DepthFile>>,
    names: Vec<String>,
    scales: u32,
    /// Metadata of the file; the first split that is read takes it.
    facts: Cell<Split>,
}

impl Listing {
    /// Collects the frames of `file` in the folder of a scene, without those whose photographs are missing. `facts` is
    /// the other metadata of the file, as a split without frames. If it states no box, the box lies around its points.
    ///
    /// # Errors
    /// Of kind `Input`: there is no frame, more than half of the photographs are missing, or `data.images` is no folder.
    pub(crate) fn new(
        root: &Path,
        config: &DataConfig,
        file: &Path,
        mut frames: Vec<Frame>,
        mut facts: Split,
    ) -> Result<Self> {
        if frames.is_empty() {
            return Err(Error::input(file.display(), "has no frame with a pose", "export the cameras again"));
        }
        frames.sort_by(|a, b| a.named.cmp(&b.named));
        let pictures = Pictures::new(pictures::stated(root, &config.images)?);
        let entries = frames.iter().map(|frame| (frame.named.as_str(), frame.place.clone()));
        let (paths, warnings) = pictures::of_most_entries(&pictures, file, entries)?;
        facts.warnings.extend(warnings);
        let found = frames.into_iter().zip(paths).filter_map(|(frame, path)| Some((frame, path?)));
        let frames: Vec<(Frame, PathBuf)> = found.collect();
        let names = names::unique(&frames.iter().map(|(frame, _)| frame.named.as_str()).collect::<Vec<_>>());
        facts.stated = facts.stated.or_else(|| facts.cloud.stated(&format!("of {}", file.display())));
        let facts = Cell::new(facts);
        let depths = vec![None; frames.len()];
        Ok(Self { file: file.into(), frames, depths, names, scales: config.scales, facts })
    }

    /// Returns the same frames with the depth images that `of` finds for the paths of photographs.
    pub(crate) fn with_depths(mut self, of: impl Fn(&Path) -> Option<DepthFile>) -> Self {
        self.depths = self.frames.iter().map(|(_, path)| of(path)).collect();
        self
    }

    /// Returns true if the file divides the frames.
    fn is_divided(&self) -> bool {
        self.frames.iter().any(|(frame, _)| frame.split.is_some())
    }

    fn selected(&self, split: &str, selection: &Selection) -> Result<Split> {
        let chosen: Vec<usize> = match selection {
            Selection::Train | Selection::Test if self.is_divided() => {
                (0..self.frames.len()).filter(|&index| self.frames[index].0.split == Some(split)).collect()
            }
            _ => selection.choose(self.frames.len()),
        };
        if chosen.is_empty() {
            return Err(division::empty(&self.file, split, self.frames.len(), selection));
        }
        let Self { frames, depths, names, scales, .. } = self;
        let found = map_in_order(&chosen, |_, index| {
            let (frame, path) = &frames[*index];
            let image = Photograph::open(path.clone(), frame.place.clone())?;
            let camera = frame.camera([image.width, image.height]);
            let Fitted { image, intrinsics, factors } = fitted(image, camera.intrinsics)?;
            let (camera, pixels) = (Camera { intrinsics, ..camera }, Pixels::Photograph(image));
            let source = Source::averaged(names[*index].clone(), camera, *scales, &frame.place, pixels)?;
            Ok((Source { depth: depths[*index].clone(), ..source }, factors))
        })?;
        let (sources, factors): (Vec<Source>, Vec<[f64; 2]>) = found.into_iter().unzip();
        let divided = selection.note(&self.file, "in order of their names").filter(|_| !self.is_divided());
        let facts = self.facts.take();
        let warnings = facts.warnings.into_iter().chain(scaled_along(&self.file, factors)).collect();
        let notes = divided.into_iter().chain(facts.notes).collect();
        Ok(Split { sources, warnings, notes, ..facts })
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
        let is_there = |(frame, _): &(Frame, PathBuf)| frame.split == Some(split);
        Ok(!self.is_divided() && ["train", "test"].contains(&split) || self.frames.iter().any(is_there))
    }

    fn states_splits(&self) -> Result<bool> {
        Ok(self.is_divided())
    }

    fn undivided(&self) -> Result<Option<Split>> {
        self.selected("train", &Selection::All).map(Some)
    }
}
