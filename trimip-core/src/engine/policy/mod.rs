//! The policy of each stage: the settings, schedules and shapes that the host decides, once for every backend.
//!
//! A policy is a plain value. It is built from a configuration, follows the progress of a run, and gives a backend's
//! kernels the numbers that they compute with. A backend's stage holds its policy next to its buffers and kernels, and
//! makes no decisions itself.

mod field;
mod occupancy;
mod optimizer;
mod poses;
mod renderer;
mod sampler;

pub use field::FieldPolicy;
pub use occupancy::OccupancyPolicy;
pub use optimizer::{OptimizerPolicy, SlotUpdate};
pub use poses::{PosePolicy, direction, moved};
pub use renderer::RendererPolicy;
pub use sampler::SamplerPolicy;
