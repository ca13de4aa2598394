//! One file per verb; each returns the program's exit code.

pub mod bench;
mod check;
mod compare;
mod config;
mod data;
mod doctor;
mod eval;
mod plan;
mod render;
mod strip;
mod train;

use crate::args::{Arguments, Verb};
use trimip_core::Result;

/// Does what the command line asks for.
pub fn run(arguments: Arguments) -> Result<u8> {
    match arguments.verb {
        None => train::run(&arguments.train),
        Some(Verb::Train(train)) => train::run(&train),
        Some(Verb::Plan(plan)) => plan::run(&plan),
        Some(Verb::Eval(eval)) => eval::run(&eval),
        Some(Verb::Render(render)) => render::run(&render),
        Some(Verb::Data(data)) => data::run(&data),
        Some(Verb::Config(config)) => config::run(&config),
        Some(Verb::Compare(compare)) => compare::run(&compare),
        Some(Verb::Bench(bench)) => bench::run(&bench),
        Some(Verb::Check(check)) => check::run(&check),
        Some(Verb::Doctor) => doctor::run(),
    }
}
