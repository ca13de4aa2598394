//! The words, mathematics, traits and training loop of Tri-MipRF (Hu et al., ICCV 2023), free of any device.
//!
//! Data flows one way: images and cameras → cones → spheres along the cone → features → density and colour →
//! composited pixels → loss, and back. [`Viewer`] and [`Session`] are the doors
//! a program uses: what renders, and what trains; [`run::Run`] drives the latter.
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

pub mod aabb;
pub mod activation;
pub mod adamw;
pub mod atomic;
pub mod backend;
pub mod batch;
pub mod bits;
pub mod camera;
pub mod checkpoint;
pub mod compositing;
mod cone_pattern;
pub mod cones;
pub mod config;
mod defaults;
mod deflate;
pub mod edge_exponents;
mod elements;
pub mod encoders;
mod error;
pub mod evaluate;
pub mod events;
pub mod exact;
pub mod exchange;
pub mod exposure;
pub mod fingerprint;
pub mod frame;
pub mod hull;
pub mod lens;
pub mod loaded;
pub mod losses;
pub mod memory;
pub mod metrics;
pub mod model;
pub mod networks;
pub mod occupancy;
pub mod packed;
pub mod params;
pub mod perception;
pub mod pixels;
pub mod plural;
pub mod policy;
pub mod projections;
pub mod proxy;
pub mod quality;
mod query;
mod range;
mod ranks;
pub mod ray_allocation;
pub mod rng;
pub mod run;
pub mod scalar;
pub mod scene_plan;
pub mod schedule;
mod session;
mod settings;
pub mod sh;
pub mod silhouettes;
mod slot;
pub mod space;
mod stages;
mod tensor_names;
pub mod tensors;
pub mod text;
mod timekeeper;
pub mod trainer;
pub mod views;

pub use aabb::Aabb;
pub use backend::{Backend, Encoder, Field, Optimizer, Renderer};
pub use camera::{Camera, Cone, Intrinsics};
pub use config::Config;
pub use defaults::{Definitions, DocumentedSection, DocumentedSetting, ForeignSection, Fragment};
pub use elements::Query;
pub use error::{Error, ErrorKind, Result, STOPPED};
pub use frame::{Frame, Pixel};
pub use lens::Lens;
pub use params::Layout;
pub use pixels::Pixels;
pub use session::{Session, StepReport, Viewer};
pub use settings::{Origin, Settings, checker::Checker, section::Section};
pub use slot::Slot;
pub use space::Space;
pub use views::{Alpha, Frames, Scale, View, ViewSet};
