//! `trimip-cli`: plan, train, evaluate, render and report Tri-MipRF models. Exit codes: 0 done, 1 the run failed or
//! missed its quality floor, 2 the user's input is wrong, 3 the device failed, 130 stopped by Ctrl-C (progress is
//! saved).

mod allocator;
mod args;
mod cameras;
mod check;
mod curves;
mod fresh;
mod interrupt;
mod progress;
mod report;
mod settings;
mod terminal;
mod verbs;

use clap::{Parser, error::ErrorKind};
use std::process::ExitCode;
use trimip_core::Error;

fn main() -> ExitCode {
    let arguments = match args::Arguments::try_parse() {
        Ok(arguments) => arguments,
        // Help and version are not errors. Other parse results are, and are printed on one line like every error.
        Err(answer) if !answer.use_stderr() => answer.exit(),
        Err(mistake) if mistake.kind() == ErrorKind::DisplayHelpOnMissingArgumentOrSubcommand => {
            mistake.exit()
        }
        Err(mistake) => {
            let text = mistake.to_string();
            let what = text.split("\nUsage:").next().unwrap_or_default();
            let what =
                what.split("\nFor more").next().unwrap_or_default().trim_start_matches("error: ").trim();
            let error = Error::input("command line", what, "see trimip-cli --help");
            terminal::error(&error);
            return ExitCode::from(error.exit_code());
        }
    };
    ExitCode::from(match verbs::run(arguments) {
        Ok(code) => code,
        Err(error) => {
            terminal::error(&error);
            error.exit_code()
        }
    })
}
