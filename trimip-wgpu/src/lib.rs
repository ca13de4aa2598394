//! The stages of Tri-MipRF on any GPU through wgpu: one WGSL file per stage in `shaders/`, twins of `trimip-core`'s
//! mathematics under the same names. A training step is one submission. No parameters are transferred, and the sums
//! of a step are read while later steps run.

#![deny(unsafe_code)]

mod adapter;
mod backend;
mod buffer;
mod ceilings;
mod device;
mod encoder;
mod encoders;
mod field;
mod hybrid;
mod kernel;
mod loss;
mod losses;
mod mapping;
mod memory;
mod mlp;
mod occupancy;
mod optimizer;
mod pipelines;
#[cfg(test)]
mod probe;
mod products;
mod read_back;
mod renderer;
mod rooms;
mod rows;
mod sampler;
mod settings;
mod space;
mod spans;

pub use adapter::{
    AdapterFacts, SOFTWARE_CELLS_PER_SECOND, SOFTWARE_SAMPLES_PER_SECOND, adapters, compute, software,
    take_turn,
};
pub use backend::{Lane, WgpuBackend};
pub use buffer::Buffer;
pub use ceilings::Ceilings;
pub use device::Counts;
pub use kernel::Addition;
pub use memory::memory;
pub use settings::{Photographs, SECTION, WgpuConfig};

use std::sync::Arc;
use trimip_core::exchange::{Ranks, Summed};
use trimip_core::loaded::LoadedModel;
use trimip_core::model::Model;
use trimip_core::trainer::Trainer;
use trimip_core::{Config, Result, Session, ViewSet, Viewer};

/// Creates an untrained model, to be trained on `views` on the configured adapter.
///
/// # Errors
/// When there is no such adapter, or the configuration does not fit it.
pub fn open(config: &Config, views: ViewSet) -> Result<Box<dyn Session>> {
    let own: WgpuConfig = config.section()?;
    let backend = WgpuBackend::new(&own.adapter, own.deterministic)?;
    Ok(Box::new(Trainer::new(backend, config, views)?))
}

/// As [`open`], trained together with other ranks, each on a GPU of its own where a machine has several.
///
/// # Errors
/// As [`open`].
pub fn open_over(config: &Config, views: ViewSet, ranks: Arc<dyn Ranks>) -> Result<Box<dyn Session>> {
    let gpu = ranks.on_machine().rank;
    let own: WgpuConfig = config.section()?;
    let backend = WgpuBackend::one_of(&own.adapter, gpu, own.deterministic)?;
    let mut trainer = Trainer::new(backend, config, views)?;
    trainer.exchange_by(Box::new(Summed::new(ranks)));
    Ok(Box::new(trainer))
}

/// Loads a finished model to render on the adapter whose name contains `adapter`.
///
/// # Errors
/// When there is no such adapter, or the model does not fit it.
pub fn load(model: &Model, adapter: &str) -> Result<Box<dyn Viewer>> {
    let backend = WgpuBackend::new(adapter, true)?;
    Ok(Box::new(LoadedModel::new(backend, model)?))
}

/// As [`load`], without blocking, for a page in a browser. The model renders with
/// [`render_async`](LoadedModel::render_async).
///
/// # Errors
/// As [`load`].
pub async fn load_async(model: &Model, adapter: &str) -> Result<LoadedModel<WgpuBackend>> {
    LoadedModel::new(WgpuBackend::new_async(adapter, true).await?, model)
}
