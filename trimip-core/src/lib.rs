//! The words, mathematics, traits and training loop of Tri-MipRF (Hu et al., ICCV 2023), free of any device.
//!
//! Data flows one way: images and cameras → cones → spheres along the cone → features → density and colour →
//! composited pixels → loss, and back. [`Session`] is the door a program uses; [`run::Run`] drives it.

pub mod camera;
pub mod checkpoint;
pub mod config;
mod error;
pub mod evaluate;
pub mod events;
pub mod frame;
pub mod metrics;
pub mod model;
pub mod run;
pub mod scalar;
mod session;
mod settings;
pub mod tensors;
pub mod views;

pub use camera::{Camera, Cone, Intrinsics};
pub use config::Config;
pub use error::{Error, ErrorKind, Result};
pub use frame::{Frame, Pixel};
pub use session::{Session, StepReport};
pub use settings::{DEFAULTS, Origin, Settings};
pub use views::{Alpha, Frames, Scale, View, ViewSet};
