//! Captures with a sparse model of COLMAP: text or binary files, a camera model for each camera, poses, and points.
//! World frame and units of the model are kept; camera axes are converted to OpenGL's.

mod binary;
mod capture;
mod lenses;
mod locate;
mod model;
mod parse;
mod text;
mod write;

pub(crate) use capture::Capture;
pub use lenses::ModelCamera;
pub(crate) use locate::is_there;
pub use model::{Encoding, File, Model, ModelImage, ModelPoint};
pub use write::Texts;
