//! `check`: the catalogue of stiff and extreme cases on the backends of this build, as one table.

use crate::check::{Catalogue, Finding};
use crate::{args::CheckArguments, progress::spinner, terminal};
use serde_json::json;
use trimip::{Error, Result, backends};
use trimip_core::atomic::write_atomically;

/// Prints a line for every case; the exit code is 1 if a law is violated.
pub fn run(arguments: &CheckArguments) -> Result<u8> {
    let mut all: Vec<(String, Finding)> = Vec::new();
    for name in &arguments.backend {
        backends::check(name)?;
    }
    let chosen = match arguments.backend.is_empty() {
        true => backends::usable(),
        false => arguments.backend.clone(),
    };
    let watched = terminal::watched();
    if !watched {
        let [worst, bound] = ["worst", "bound"];
        terminal::line(row(["part", "backend", "case", "law"], &format!("{worst:>10} {bound:>10}")));
    }
    for name in &chosen {
        // Each case takes seconds on a software adapter; the spinner shows that the program works.
        let bar = spinner();
        bar.set_message(name.clone());
        let mut tell = |finding: Finding| {
            let Finding { part, case, law, worst, bound } = &finding;
            let verdict = if finding.holds() { "" } else { "  BROKEN" };
            if watched {
                bar.suspend(|| {
                    terminal::prose(format!(
                        "{part}, {case}: {law}: {worst:.1e}, at most {bound:.1e}{verdict}"
                    ));
                });
            } else {
                let numbers = format!("{worst:>10.1e} {bound:>10.1e}{verdict}");
                terminal::line(row([part, name, case, law], &numbers));
            }
            all.push((name.clone(), finding));
            bar.set_message(format!("{name}, {}", terminal::count(all.len() as u64, "law")));
        };
        let catalogue = Catalogue { long: arguments.long, tell: &mut tell };
        backends::visit(name, &arguments.adapter, arguments.threads, catalogue)?;
        bar.finish_and_clear();
    }
    let broken = all.iter().filter(|(_, finding)| !finding.holds()).count();
    if let Some(path) = &arguments.json {
        let cases: Vec<_> = all
            .iter()
            .map(|(backend, f)| {
                // JSON has no infinity and no NaN.
                let worst = if f.worst.is_finite() { json!(f.worst) } else { json!(f.worst.to_string()) };
                json!({ "part": f.part, "case": f.case, "backend": backend, "law": f.law, "worst": worst, "bound": f.bound, "holds": f.holds() })
            })
            .collect();
        let text =
            serde_json::to_string_pretty(&json!({ "cases": cases, "broken": broken })).map_err(Error::run)?;
        write_atomically(path, text.as_bytes())?;
    }
    terminal::line(format!(
        "{} on {}: {broken} broken",
        terminal::count(all.len() as u64, "law"),
        chosen.join(", ")
    ));
    match broken {
        0 => Ok(0),
        _ => Err(Error::run(format!(
            "{broken} of {} {} broken",
            terminal::count(all.len() as u64, "law"),
            if broken == 1 { "is" } else { "are" }
        ))),
    }
}

/// Formats a line of the table for output that is not a terminal; the line is wider than any terminal.
fn row([part, backend, case, law]: [&str; 4], numbers: &str) -> String {
    format!("{part:<9} {backend:<8} {case:<46} {law:<62} {numbers}")
}
