//! `trimip-cli`: plan, train, evaluate, render and report Tri-MipRF models. Exit codes: 0 done, 1 the run failed or
//! missed its quality floor, 2 the user's input is wrong, 3 the device or the system failed, 130 stopped by Ctrl-C (progress is
//! saved).

#![deny(unsafe_code)]

#[allow(unsafe_code)] // implementing an allocator is unsafe
mod allocator;
mod args;
mod cameras;
mod capture_display;
mod check;
mod curves;
mod interrupt;
mod measures;
mod mistake;
mod progress;
mod ranks;
mod settings;
mod terminal;
mod verbs;
mod wording;

use clap::{Parser, error::ErrorKind as Mistake};
use std::process::ExitCode;
use trimip_capture::guard;
use trimip_core::{ErrorKind, Result};

fn main() -> ExitCode {
    if guard::is_one() {
        return ExitCode::from(guard::run(std::env::args_os().skip(1)));
    }
    let arguments = match args::Arguments::try_parse() {
        Ok(arguments) => arguments,
        Err(answer) if !ranks::speaks() => return ExitCode::from(answer.exit_code() as u8),
        // Help and version are not errors. All other parse results are errors, which the program prints on one line like every error.
        Err(answer) if !answer.use_stderr() => {
            terminal::note_failure(answer.print());
            return ended(Ok(0));
        }
        Err(mistake) if mistake.kind() == Mistake::DisplayHelpOnMissingArgumentOrSubcommand => mistake.exit(),
        Err(mistake) => {
            return ended(Err(mistake::error(&mistake, std::env::args_os().nth(1).as_deref())));
        }
    };
    ended(ranks::among(|| verbs::run(&arguments), |ranks| verbs::work(&arguments, ranks)))
}

/// Returns the exit code for an outcome. If there is no other error, a failed write to standard output counts as the error.
fn ended(outcome: Result<u8>) -> ExitCode {
    ExitCode::from(match outcome.and_then(|code| terminal::printed().map(|()| code)) {
        Ok(code) => code,
        Err(error) if error.kind() == ErrorKind::Stopped => {
            terminal::note(wording::text(&error));
            wording::exit_code(&error)
        }
        Err(error) => {
            terminal::error(&error);
            wording::exit_code(&error)
        }
    })
}
