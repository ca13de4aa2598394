//! Pictures and metrics of a model: cameras, picture files, and the comparison with test photographs.

mod camera_files;
pub mod cameras;
mod files;
mod flip;
pub mod flythrough;
mod home;
mod job;
#[cfg(feature = "lpips")]
mod lpips;
mod measure;
mod motion_blur;
mod perceptual_metrics;
pub mod pictures;
pub mod strip;
pub mod turntable;
pub mod video;

pub use camera_files::{CameraFormat, export_cameras};
pub use cameras::Named;
pub use files::{
    CAMERAS, PictureFormat, Quantity, Rendered, depth_range, expect_no_others, write, write_cameras,
};
pub use flip::{PIXELS_PER_DEGREE, flip_colors, flip_of_pictures};
pub use home::{Home, home};
pub use job::RenderJob;
pub use measure::{Measured, RankGroup, TestViews, Watching, evaluate, evaluate_on_worker};
pub use motion_blur::{Mean, MotionBlur};
pub use perceptual_metrics::PerceptualMetrics;
