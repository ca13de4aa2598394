//! `bench`: error against time, of training over a set of configurations, or of rendering over the shortcuts of a model.

mod page;
mod rendering;
pub mod stages;
pub mod training;

use crate::args::BenchArguments;
use trimip_core::Result;

/// Does what the arguments ask for.
pub fn run(arguments: &BenchArguments) -> Result<u8> {
    match &arguments.render {
        Some(model) => rendering::run(arguments, model),
        None => training::run(arguments),
    }
}
