//! `bench`: error against time, of training over a set of configurations or of rendering one model. Rendering is
//! benchmarked with varied approximations, in several ways with few samples, or with several numbers of cones per
//! pixel.

mod cones;
mod page;
mod rendering;
mod results;
pub mod stages;
pub mod training;
mod ways;

use crate::args::BenchArguments;
use trimip_core::Result;

/// Runs the benchmark that the arguments select.
pub fn run(arguments: &BenchArguments) -> Result<u8> {
    match &arguments.render {
        Some(model) if arguments.cones => cones::run(arguments, model),
        Some(model) if arguments.ways => ways::run(arguments, model),
        Some(model) => rendering::run(arguments, model),
        None => training::run(arguments),
    }
}
