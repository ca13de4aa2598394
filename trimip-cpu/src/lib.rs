//! The stages of Tri-MipRF on the CPU: rayon over tiles of rays, SIMD chosen at run time, bit-identical results for
//! any number of threads.
//!
//! ```text
//! each tile of rays, on any thread:
//! sampler → march   → encoder  → field    → renderer → loss
//! Rays      Samples   features   Radiance   Pixel       │
//! partial gradients ← encoder ← field ← renderer ←──────┘
//!
//! each step, in a fixed order:
//! partial gradients of all tiles → reduction_tree ↔ data_parallel (other ranks) → optimizer → parameters
//! ```
//!
//! Start with [`open`], which trains, and [`load`], which renders. [`CpuBackend`] is the device for a program that calls the
//! stages itself, and [`DataParallel`] joins the processes that train one model.
//!
//! ```
//! use trimip_core::Config;
//! use trimip_data::settings::DataConfig;
//!
//! # fn main() -> trimip_core::Result<()> {
//! let mut config = Config::default();
//! config.encoder.plane_size = 32;
//! config.encoder.levels = 4;
//! config.train.samples_per_step = 1024;
//!
//! let small = DataConfig { builtin_size: 16, builtin_train: 4, ..DataConfig::default() };
//! let scene = trimip_data::open(&DataConfig { format: trimip_data::builtin::FORMAT.into(), ..small })?;
//! let camera = scene.train.views[0].camera;
//! let mut session = trimip_cpu::open(&config, scene.train)?;
//! for step in 0..4 {
//!     session.step(f64::from(step) / 4.0)?;
//! }
//! assert_eq!(session.render(&camera)?.pixels.len(), 16 * 16);
//! # Ok(())
//! # }
//! ```

mod backend;
mod buffer;
mod cursor;
mod data_parallel;
mod device;
mod distance;
mod encoder;
mod encoders;
mod field;
pub mod gemm;
mod hybrid;
mod loss;
mod march;
mod memory;
mod mlp;
mod occupancy;
mod optimizer;
mod pages;
mod poses;
mod reduction_tree;
mod renderer;
mod sampler;
pub mod simd;
mod visibility;
mod wire;
mod worker;

pub use buffer::Buffer;
pub use data_parallel::DataParallel;
pub use device::CpuBackend;
pub use encoder::CpuEncoder;
pub use field::CpuField;
pub use occupancy::CpuOccupancy;
pub use renderer::CpuRenderer;
pub use worker::WorkerScratch;

use simd::Simd;
use std::sync::Arc;
use trimip_core::engine::exchange::Ranks;
use trimip_core::engine::loaded::LoadedModel;
use trimip_core::engine::trainer::Trainer;
use trimip_core::field::model::Model;
use trimip_core::scene_plan::Compute;
use trimip_core::{Config, Result, Session, ViewSet, Viewer};

/// Creates an untrained model, to be trained on `views` with the configured number of threads.
///
/// # Errors
/// When the threads cannot be started, or the views have no pixels.
pub fn open(config: &Config, views: ViewSet) -> Result<Box<dyn Session>> {
    let backend = CpuBackend::new(config.threads, Simd::detect())?.without_emulation();
    Ok(Box::new(Trainer::new(backend, config, views)?))
}

/// Creates an untrained model as [`open`] does, to be trained together with other ranks. The result is bit-identical to
/// training on one rank.
///
/// # Errors
/// As [`open`], and when there are more ranks than a step has leaves.
pub fn open_over(config: &Config, views: ViewSet, ranks: Arc<dyn Ranks>) -> Result<Box<dyn Session>> {
    let exchange = DataParallel::new(ranks, &config.train)?;
    let backend = CpuBackend::new(config.threads, Simd::detect())?.without_emulation();
    let mut trainer = Trainer::new(backend, config, views)?;
    trainer.exchange_by(Box::new(exchange));
    Ok(Box::new(trainer))
}

/// Predicts the memory of a training run with these settings and views. Returns the name and bytes of each part.
pub fn memory(config: &Config, views: &ViewSet) -> Vec<(String, u64)> {
    let threads = match config.threads {
        0 => std::thread::available_parallelism().map_or(1, usize::from),
        threads => threads as usize,
    };
    memory::predict(config, views, threads, backend::partials(config.train.samples_per_step))
}

/// Returns the number of kept samples per second of one thread that trains networks of 64 units on *lego*. Three values
/// were measured: AVX-512 BF16 (327 M samples in 300 s on two threads of a Zen 4), AMX (24 M samples in 20 s on two
/// threads of an Emerald Rapids, in f32) and AVX2 (two threads of a Zen). The other values are scaled by the speed of the
/// networks' products; the value of NEON is scaled by its multiply-adds per cycle, without a measurement.
fn samples_per_second(simd: Simd) -> f64 {
    match simd {
        Simd::Amx => 6.0e5,
        Simd::Avx512Bf16 => 5.4e5,
        Simd::Avx512 => 4.2e5,
        Simd::Avx2 => 3.5e5,
        Simd::Neon => 2.5e5,
        Simd::Portable => 1.0e5,
    }
}

/// Returns the training speed of `threads` threads (0: all cores) of this processor.
pub fn compute(threads: u32) -> Compute {
    let threads = match threads {
        0 => std::thread::available_parallelism().map_or(1, usize::from),
        threads => threads as usize,
    };
    let simd = Simd::detect();
    Compute {
        name: format!("{} of {simd}", trimip_core::plural::count(threads, "thread")),
        samples_per_second: threads as f64 * samples_per_second(simd),
        bf16_from: simd.bf16_from(),
        wide: false,
    }
}

/// Returns the names of this processor's instruction sets, widest first. The backend uses the first.
pub fn features() -> String {
    Simd::available().iter().map(ToString::to_string).collect::<Vec<_>>().join(", ")
}

/// Loads a finished model to render with `threads` threads (0: all cores).
///
/// # Errors
/// When the threads cannot be started, or the model's tensors do not fit its configuration.
pub fn load(model: &Model, threads: u32) -> Result<Box<dyn Viewer>> {
    let backend = CpuBackend::new(threads, Simd::detect())?.without_emulation();
    Ok(Box::new(LoadedModel::new(backend, model)?))
}
