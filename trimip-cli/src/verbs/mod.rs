//! One file per verb; each returns the program's exit code.

mod bake;
pub mod bench;
mod capture;
mod check;
mod compare;
mod config;
mod data;
mod doctor;
mod eval;
mod export;
mod jobs;
mod paper;
mod plan;
mod render;
mod selection;
mod strip;
mod train;
mod view;

use crate::args::{Arguments, Verb};
use crate::terminal;
use trimip_core::{Error, Result, engine::exchange::Ranks};

/// Suggested commands, printed if the user typed no arguments.
const NEXT: &str = "\
nothing to train on; type one of
  trimip-cli FOLDER                             photographs with transforms.json: trains 5 minutes, then reports
  trimip-cli FOLDER --minutes 30                the same for longer
  trimip-cli capture FILM|FOLDER --train        a film, or photographs without cameras: finds them first
  trimip-cli --config configs/quickstart.toml   the built-in scene, nothing to download
  trimip-cli --help                             every verb and option";

/// Does this rank's part of a verb's jobs; called on ranks other than 0.
///
/// # Errors
/// When the verb has no jobs, or its jobs fail.
pub fn work(arguments: &Arguments, ranks: &dyn Ranks) -> Result<()> {
    match &arguments.verb {
        Some(Verb::Eval(eval)) => eval::work(eval, ranks),
        Some(Verb::Render(render)) => render::work(render, ranks),
        Some(Verb::Bench(bench)) => bench::training::help_run(bench, ranks),
        Some(Verb::Paper(paper)) => paper::work(paper, ranks),
        Some(Verb::Plan(plan)) => plan::work(plan, ranks),
        _ => Err(Error::run("rank 0 hands out jobs, but this verb has none")),
    }
}

/// Dispatches the command line to its verb.
pub fn run(arguments: &Arguments) -> Result<u8> {
    match &arguments.verb {
        None if arguments.train.is_bare() => {
            terminal::aside(NEXT);
            Ok(2)
        }
        None => train::run(&arguments.train),
        Some(Verb::Train(train)) => train::run(train),
        Some(Verb::Capture(capture)) => capture::run(capture),
        Some(Verb::Plan(plan)) => plan::run(plan),
        Some(Verb::Eval(eval)) => eval::run(eval),
        Some(Verb::View(view)) => view::run(view),
        Some(Verb::Bake(bake)) => bake::run(bake),
        Some(Verb::Export(export)) => export::run(export),
        Some(Verb::Render(render)) => render::run(render),
        Some(Verb::Data(data)) => data::run(data),
        Some(Verb::Config(config)) => config::run(config),
        Some(Verb::Compare(compare)) => compare::run(compare),
        Some(Verb::Bench(bench)) => bench::run(bench),
        Some(Verb::Paper(paper)) => paper::run(paper),
        Some(Verb::Check(check)) => check::run(check),
        Some(Verb::Doctor) => doctor::run(),
    }
}
