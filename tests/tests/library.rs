//! Tests of runs, sessions and settings within one process: one binary, which is linked once.

mod asynchronous;
mod determinism;
mod exposure;
mod failing;
mod far;
mod jobs;
mod learning;
mod poses;
mod properties;
mod settings;
mod units;
