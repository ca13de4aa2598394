//! The result of reading a split: its frames, and the metadata of the scene.

use crate::{points::Cloud, source::Source};
use trimip_core::scene_plan::StatedBox;

/// The frames of a split, with warnings about them.
#[derive(Debug, Default)]
pub(crate) struct Split {
    pub(crate) sources: Vec<Source>,
    pub(crate) warnings: Vec<String>,
    /// Lines of the scene's description.
    pub(crate) notes: Vec<String>,
    /// The bounding box that the file states.
    pub(crate) stated: Option<StatedBox>,
    /// The points that the file states. If the file has several splits, the first that is read takes them.
    pub(crate) cloud: Cloud,
}
