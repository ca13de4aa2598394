//! Training and rendering over a device. [`backend`] has the traits of the device and its stages, [`batch`] the buffers
//! that flow between the stages, [`policy`] the host's decisions for each stage. [`trainer`] computes steps and
//! [`loaded`] renders; programs use them through the traits [`Session`](crate::Session) and [`Viewer`](crate::Viewer).
//! [`exchange`] connects the processes that train one model.

pub mod backend;
pub mod batch;
pub mod checkpoint;
pub mod error_map;
pub mod events;
pub mod exchange;
pub mod exposure;
pub mod intrinsics;
pub(crate) mod lagged;
pub mod loaded;
pub mod policy;
pub mod poses;
pub mod preconditioner;
pub mod proxy;
mod query;
pub(crate) mod ranks;
pub mod ray_allocation;
pub(crate) mod session;
mod stages;
mod step_result;
pub mod trainer;
