//! The stages of Tri-MipRF on any GPU through wgpu: `gpu/` wraps the device and is independent of the stages; each stage
//! is a file with its kernels. The WGSL in `shaders/` mirrors `trimip-core`'s mathematics under the same names. Structs
//! and constants in WGSL are generated from Rust. A training step is one submission. No parameters are transferred, and
//! the sums of a step are read while later steps run.
//!
//! ```text
//! recorded by the host, executed on the device:
//! sampler → renderer (march) → encoder  → field (mlp) → renderer (composite) → loss → sums → host
//! Rays      Samples            features   Radiance      Pixel                   │            2 steps later
//! parameters ← optimizer ← gradients of the slots ← encoder ← field ← renderer ←┘
//! ```
//!
//! Start with [`open`], which trains, and [`load`], which renders. [`adapters`] lists the adapters of this machine, and
//! [`WgpuConfig`] selects one. [`WgpuBackend`] is the device for a program that calls the stages itself.
//!
//! ```no_run
//! use trimip_core::{Config, ViewSet};
//!
//! fn train(views: ViewSet) -> trimip_core::Result<()> {
//!     let camera = views.views[0].camera;
//!     let mut session = trimip_wgpu::open(&Config::default(), views, 0)?;
//!     for step in 0..1000 {
//!         session.step(f64::from(step) / 1000.0)?;
//!     }
//!     let model = session.finish()?;
//!     // An empty name selects the best adapter.
//!     let frame = trimip_wgpu::load(&model, "", 0)?.render(&camera)?;
//!     println!("{} pixels", frame.pixels.len());
//!     Ok(())
//! }
//! ```

#![deny(unsafe_code)]

#[macro_use]
mod gpu;

mod backend;
mod capacity;
mod deferred;
mod encoder;
mod encoders;
mod field;
mod field_params;
mod hybrid;
mod loss;
mod losses;
mod memory;
mod mlp;
mod occupancy;
mod optimizer;
mod poses;
#[cfg(test)]
mod probe;
mod products;
mod projections;
mod renderer;
mod sampler;
mod settings;
mod shaders;
mod space;
mod speed;
mod tiles;
#[cfg(test)]
mod validation;
mod workspace;

pub use gpu::{AdapterFacts, Buffer, Ceilings, Counts, adapters, software};
pub use memory::memory;
pub use settings::{Photographs, SECTION, WgpuConfig};
pub use speed::{SOFTWARE_CELLS_PER_SECOND, SOFTWARE_SAMPLES_PER_SECOND, compute};
pub use workspace::{Addition, Stream, WgpuBackend};

use std::sync::Arc;
use trimip_core::engine::exchange::{Ranks, Summed};
use trimip_core::engine::loaded::LoadedModel;
use trimip_core::engine::trainer::Trainer;
use trimip_core::field::model::Model;
use trimip_core::{Config, Result, Session, ViewSet, Viewer};

/// Creates an untrained model, to be trained on `views` on the configured adapter. `index`, modulo their number, selects one of
/// several equally good adapters.
///
/// # Errors
/// When there is no such adapter, or the configuration does not fit its limits.
pub fn open(config: &Config, views: ViewSet, index: usize) -> Result<Box<dyn Session>> {
    let own: WgpuConfig = config.section()?;
    let backend = WgpuBackend::one_of(&own.adapter, index, own.deterministic)?;
    Ok(Box::new(Trainer::new(backend, config, views)?))
}

/// Creates an untrained model as [`open`] does, to be trained together with other ranks. If a machine has several GPUs,
/// its ranks are spread over them.
///
/// # Errors
/// As [`open`].
pub fn open_over(config: &Config, views: ViewSet, ranks: Arc<dyn Ranks>) -> Result<Box<dyn Session>> {
    let gpu = ranks.on_machine().id;
    let own: WgpuConfig = config.section()?;
    let backend = WgpuBackend::one_of(&own.adapter, gpu, own.deterministic)?;
    let mut trainer = Trainer::new(backend, config, views)?;
    trainer.exchange_by(Box::new(Summed::new(ranks)));
    Ok(Box::new(trainer))
}

/// Loads a finished model to render on the adapter whose name contains `adapter`. `index`, modulo their number, selects one of
/// several equally good adapters.
///
/// # Errors
/// When there is no such adapter, or the model does not fit its limits.
pub fn load(model: &Model, adapter: &str, index: usize) -> Result<Box<dyn Viewer>> {
    let backend = WgpuBackend::one_of(adapter, index, true)?;
    Ok(Box::new(LoadedModel::new(backend, model)?))
}

/// Loads a model as [`load`] does, without blocking, for a page in a browser. The model renders with
/// [`render_async`](LoadedModel::render_async).
///
/// # Errors
/// As [`load`].
pub async fn load_async(model: &Model, adapter: &str) -> Result<LoadedModel<WgpuBackend>> {
    LoadedModel::new(WgpuBackend::new_async(adapter, true).await?, model)
}
