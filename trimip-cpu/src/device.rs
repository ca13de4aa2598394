//! The processor as a device: its threads, its instruction set, and the workspaces of its workers.

use crate::simd::Simd;
use std::sync::Mutex;
use trimip_core::engine::batch::Workspace;
use trimip_core::{Error, Result};

/// The CPU with a given number of threads and a given instruction set.
pub struct CpuBackend {
    pub(crate) pool: rayon::ThreadPool,
    pub(crate) simd: Simd,
    /// True if bf16 products are computed even on a processor without bf16 instructions.
    pub(crate) emulates_bf16: bool,
    pub(crate) workspaces: Mutex<Vec<Workspace<Self>>>,
}

impl CpuBackend {
    /// Starts `threads` workers (0: one per core) that use the given instruction set.
    ///
    /// # Errors
    /// When the threads cannot be started.
    pub fn new(threads: u32, simd: Simd) -> Result<Self> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads as usize)
            .build()
            .map_err(|error| {
                let what = match threads {
                    0 => "a thread for each core".into(),
                    threads => format!("{threads} threads"),
                };
                Error::device(format!(
                    "cannot start {what}: {error}; lower threads, or raise the limits of processes and memory (ulimit -u, \
                     ulimit -v)"
                ))
            })?;
        Ok(Self { pool, simd, emulates_bf16: true, workspaces: Mutex::new(Vec::new()) })
    }

    /// Disables the emulation of bf16, which is slower than f32 and rounds more: without bf16 instructions, networks
    /// configured as bf16 are computed in f32.
    pub fn without_emulation(mut self) -> Self {
        self.emulates_bf16 = false;
        self
    }

    /// Returns the number of worker threads.
    pub fn threads(&self) -> usize {
        self.pool.current_num_threads()
    }
}
