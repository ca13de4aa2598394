//! The types, mathematics, traits and training loop of Tri-MipRF (Hu et al., ICCV 2023), independent of any device.
//!
//! ```text
//! photographs + cameras → cones → samples along each cone → features → density, colour → cones → pixels → loss
//! ViewSet                 Rays    Samples                   rows       Radiance          Pixel   Pixel    StepSums
//!                                                                                                          │
//! Model ← parameters ← AdamW ← [exchange] ← gradients of the slots ← the same way back ←───────────────────┘
//! ```
//!
//! Start with [`Config`] and [`ViewSet`], which every run needs. A program renders through [`Viewer`] and trains through
//! [`Session`], which [`run::Run`] drives. [`engine::backend`] has the traits of the stages in the picture above.
//!
//! ```
//! use glam::DVec3;
//! use trimip_core::{Camera, Cone, Intrinsics};
//!
//! // The cone of the centre pixel of an 800-pixel camera, and the radius of its sphere at distance 4 (Eq. 3).
//! let intrinsics = Intrinsics::from_angle(800, 800, 0.6911);
//! let camera = Camera::look_at(intrinsics, DVec3::new(0.0, -4.0, 0.0), DVec3::ZERO, DVec3::Z);
//! let cone: Cone<f32> = camera.cone(400, 400);
//! assert!((4.0 * cone.slope - 4.0 / (1111.1 * std::f32::consts::PI.sqrt())).abs() < 1e-5);
//! ```

#![forbid(unsafe_code)]

pub mod atomic;
pub mod config;
pub mod engine;
mod error;
pub mod field;
pub mod geometry;
pub mod math;
pub mod measures;
pub mod memory;
pub mod plain_file;
pub mod plural;
pub mod run;
pub mod scene;
pub mod scene_plan;
pub mod text;

pub use config::{
    Config, Crop,
    defaults::{Addition, Definitions, DocumentedSection, DocumentedSetting, ForeignSection, Fragment},
    origin::Origin,
    settings::{Settings, checker::Checker, section::Section, setting_value::SettingValue},
};
pub use engine::{
    backend::{Backend, Encoder, Field, Optimizer, Renderer},
    session::{Session, StepReport, Viewer},
};
pub use error::{Advice, Error, ErrorKind, Place, Result};
pub use field::{params::Layout, slot::Slot};
pub use geometry::{
    aabb::Aabb,
    camera::{Camera, Cone, Intrinsics},
    elements::Query,
    lens::Lens,
    space::Space,
};
pub use scene::{
    frame::{Frame, Pixel},
    pixels::Pixels,
    views::{Alpha, Frames, Scale, View, ViewSet},
};
