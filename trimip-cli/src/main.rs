//! `trimip-cli`: plan, train, evaluate, render and report Tri-MipRF models. Exit codes: 0 done, 1 the run failed or missed
//! its quality floor, 2 the user's input is wrong, 3 the device failed, 130 stopped by Ctrl-C (what was done is saved).

mod args;
mod backends;
mod cameras;
mod history;
mod interrupt;
mod machine;
mod pictures;
mod plan;
mod progress;
mod report;
mod run_folder;
mod settings;
mod store;
mod terminal;
mod verbs;

use clap::Parser;
use std::process::ExitCode;

fn main() -> ExitCode {
    ExitCode::from(match verbs::run(args::Arguments::parse()) {
        Ok(code) => code,
        Err(error) => {
            terminal::error(&error);
            error.exit_code()
        }
    })
}
