//! The device, independent of the stages that compute on it. A [`Gpu`] is an opened adapter; a [`Buffer`] is an array on
//! it. A [`Kernel`] is composed of [`Source`]s, among them structs and constants that Rust and WGSL share; a stage looks
//! up its [`Pipeline`] once, and dispatches it with [`Bind`]ings, parameters and a [`Size`]. Dispatches are recorded and
//! submitted together; a [`Receipt`] is a pending copy to the host.

#[macro_use]
mod declare;

mod adapter;
mod bind;
mod buffer;
mod ceilings;
mod device;
mod kernel;
mod lock;
mod mapping;
mod matrices;
mod pipeline;
mod read_back;
mod recorder;
mod rows;
mod shared;
mod source;

pub use adapter::{AdapterFacts, adapters, choose_one_of, largest_binding, software};
pub use bind::{Bind, Binds, Size};
pub use buffer::Buffer;
pub use ceilings::Ceilings;
pub use device::{Counts, Gpu};
pub use kernel::{Access, GRID, GROUP, Kernel};
pub use lock::lock;
pub use matrices::{COOPERATING, Matrices};
pub use pipeline::Pipeline;
pub use read_back::Receipt;
pub use rows::{BLOCK, Rows};
pub use shared::{Layout, Member, Shared, Wgsl};
pub use source::{Source, Value};

/// Returns the kernels of this folder, for validation.
#[cfg(test)]
pub fn all() -> Vec<Kernel> {
    vec![recorder::arguments(), ceilings::peak()]
}
