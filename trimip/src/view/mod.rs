//! Pictures and metrics of a model: cameras, picture files, and the comparison with test photographs.

pub mod cameras;
mod files;
mod measure;
pub mod pictures;
pub mod turntable;

pub use cameras::Named;
pub use files::{PictureFormat, Quantity, depth_range, write, write_cameras};
pub use measure::{Measured, Watching, evaluate};
