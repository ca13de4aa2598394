//! `bench`: error against time, of training over a set of configurations, or of rendering over a model's
//! approximations.

mod page;
mod rendering;
pub mod stages;
pub mod training;

use crate::args::BenchArguments;
use trimip_core::Result;

/// Runs the benchmark that the arguments select.
pub fn run(arguments: &BenchArguments) -> Result<u8> {
    match &arguments.render {
        Some(model) => rendering::run(arguments, model),
        None => training::run(arguments),
    }
}
