//! Opening a scene: loads its training views, and gives access to its test frames.

use crate::settings::DataConfig;
use crate::{
    depth_images::{DepthImages, Known},
    depths, describe, masks,
    points::Point,
    source::{FrameList, Source, assemble_in, rows},
    survey::Survey,
    watch::{Meter, Watch, unwatched},
    workers,
};
use trimip_core::{
    Alpha, Camera, Error, Frames, Result, ViewSet, scene::origin::LocalOrigin, scene_plan::StatedBox,
};

/// A scene ready to train and test on.
pub struct Scene {
    /// Name of the folder, or "builtin".
    pub name: String,
    /// All training views at all scales.
    pub train: ViewSet,
    /// Test frames, each a set with one view per scale, decoded or rendered on request.
    pub test: Box<dyn Frames>,
    /// Name of each test frame, and its camera at full size.
    pub test_views: Vec<(String, Camera)>,
    /// The bounding box that the data state.
    pub stated: Option<StatedBox>,
    /// Points of the scene that the data state, with the training views that saw them.
    pub points: Vec<Point>,
    /// Origin of the coordinates of cameras, box and points, in the coordinates of the files (`data.origin`).
    pub origin: LocalOrigin,
    /// Note about where the archive of the scene was unpacked; a line of the description.
    pub unpacked: Option<String>,
    /// Warnings about the data, to be shown with every result.
    pub warnings: Vec<String>,
    /// A description in a few lines: layout, views, sizes, scales, memory.
    pub description: Vec<String>,
}

/// The test frames of a scene, without its training views.
pub struct TestSet {
    /// Name of the folder, or "builtin".
    pub name: String,
    /// Test frames, each a set with one view per scale, decoded or rendered on request.
    pub frames: Box<dyn Frames>,
    /// Cameras of the training views at their finest scale.
    pub train: Vec<Camera>,
    /// Training frames, in the form of `frames`.
    pub photographs: Box<dyn Frames>,
    /// Warnings about the data, to be shown with every result.
    pub warnings: Vec<String>,
}

impl std::fmt::Debug for Scene {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Scene").field("name", &self.name).field("description", &self.description).finish()
    }
}

/// Opens the scene that the settings name: reads every camera and image header, decodes the training images. Without
/// `data.origin`, a scene far from the origin of its files gets [a local origin](LocalOrigin::chosen) among its cameras.
///
/// # Errors
/// Of kind `Input`, one line each: what is wrong, in which file and frame, and what to do.
pub fn open(config: &DataConfig) -> Result<Scene> {
    open_watched(config, &unwatched)
}

/// Opens a scene as [`open`] does, and reports the progress of reading the training views to `watch`.
///
/// # Errors
/// As [`open`].
pub fn open_watched(config: &DataConfig, watch: Watch<'_>) -> Result<Scene> {
    workers::start()?;
    let (survey, train) = surveyed(config, watch)?;
    Ok(opened(survey, config, train))
}

/// Reads the scene that the settings name, and assembles its training views with their known depths.
pub(crate) fn surveyed(config: &DataConfig, watch: Watch<'_>) -> Result<(Survey, ViewSet)> {
    let mut survey = Survey::new(config)?.local(config, LocalOrigin::chosen)?;
    let images = DepthImages::find(config, &survey.train)?;
    let meter = Meter::new(rows(&survey.train), watch);
    let mut train = assemble_in(config.pixels, &survey.train, survey.alpha, &meter)?;
    let Known { depths, note, warnings } = images.known(&survey.train, &train)?;
    train.depths = depths::nearest([depths::of_points(&survey.points, &train), depths].concat());
    survey.notes.extend(note);
    survey.warnings.extend(warnings);
    Ok((survey, train))
}

/// Opens the test frames of the scene that the settings name. Reads every camera and image header as [`open`] does, but
/// decodes no training image, which saves time and memory. Without `data.origin`, the coordinates are those of the
/// files: right for a model that was trained without a local origin.
///
/// # Errors
/// As [`open`]; of kind `Input` if there is no test frame.
pub fn open_test(config: &DataConfig) -> Result<TestSet> {
    workers::start()?;
    let survey = Survey::new(config)?.local(config, |_| LocalOrigin::default())?;
    let cameras = survey.cameras();
    let Survey { name, train, test, warnings, alpha, .. } = survey;
    if test.is_empty() {
        let named = format!("data.test = \"{}\"", config.test);
        return Err(Error::input(named, "the test split holds no view", "name another data.test"));
    }
    let photographs = frames(train, alpha);
    Ok(TestSet { name, frames: frames(test, alpha), train: cameras, photographs, warnings })
}

/// Returns frames that are decoded or rendered on request.
fn frames(sources: Vec<Source>, alpha: Alpha) -> Box<dyn Frames> {
    Box::new(FrameList { sources, alpha })
}

/// Returns the scene with its training views.
pub(crate) fn opened(survey: Survey, config: &DataConfig, train: ViewSet) -> Scene {
    let description = describe::description(&survey, config, &train);
    let of_masks = masks::warnings(&survey.train, &train);
    let named = |source: &Source| Some((source.name.clone(), source.views.first()?.1));
    Scene {
        test_views: survey.test.iter().filter_map(named).collect(),
        name: survey.name,
        train,
        test: frames(survey.test, survey.alpha),
        stated: survey.stated,
        points: survey.points,
        origin: survey.origin,
        unpacked: survey.unpacked,
        warnings: [survey.warnings, of_masks].concat(),
        description,
    }
}
