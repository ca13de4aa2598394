//! `bench`: error against time, of training over a set of configurations, of rendering over a model's approximations, of
//! ways to few samples, or of pixels over their number of cones.

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
