//! The words, mathematics, traits and training loop of Tri-MipRF (Hu et al., ICCV 2023), free of any device.
//!
//! Data flows one way: images and cameras → cones → spheres along the cone → features → density and colour →
//! composited pixels → loss, and back. [`Session`] is the door a program uses; [`run::Run`] drives it.

pub mod aabb;
pub mod activation;
pub mod adamw;
pub mod backend;
pub mod batch;
pub mod camera;
pub mod checkpoint;
pub mod compositing;
pub mod config;
mod error;
pub mod evaluate;
pub mod events;
pub mod frame;
pub mod loss;
pub mod metrics;
pub mod model;
pub mod occupancy;
pub mod params;
pub mod rng;
pub mod run;
pub mod scalar;
mod session;
mod settings;
pub mod sh;
pub mod tensors;
pub mod trainer;
pub mod tri_mip;
pub mod views;

pub use aabb::Aabb;
pub use backend::{Backend, Encoder, Field, Optimizer, Renderer};
pub use camera::{Camera, Cone, Intrinsics};
pub use config::Config;
pub use error::{Error, ErrorKind, Result};
pub use frame::{Frame, Pixel};
pub use params::Layout;
pub use session::{Session, StepReport};
pub use settings::{DEFAULTS, Origin, Settings};
pub use views::{Alpha, Frames, Scale, View, ViewSet};
