//! `check`: the catalogue of stiff and extreme cases on the backends of this build, as one table.

use crate::{args::CheckArguments, backends, check::Finding, terminal};
use serde_json::json;
use trimip_core::{Error, Result, tensors::write_atomically};

/// Prints a line for every case; exit code 1 when a law is broken.
pub fn run(arguments: &CheckArguments) -> Result<u8> {
    let mut all: Vec<(String, Finding)> = Vec::new();
    for name in &arguments.backend {
        backends::check(name)?;
    }
    let chosen = match arguments.backend.is_empty() {
        true => backends::usable(),
        false => arguments.backend.clone(),
    };
    terminal::line(format!(
        "{:<9} {:<8} {:<46} {:<62} {:>10} {:>10}",
        "part", "backend", "case", "law", "worst", "bound"
    ));
    for name in &chosen {
        let mut tell = |finding: &Finding| {
            let verdict = if finding.holds() { "" } else { "  BROKEN" };
            terminal::line(format!(
                "{:<9} {name:<8} {:<46} {:<62} {:>10.1e} {:>10.1e}{verdict}",
                finding.part, finding.case, finding.law, finding.worst, finding.bound
            ));
        };
        let findings =
            backends::catalogue(name, &arguments.adapter, arguments.threads, arguments.long, &mut tell)?;
        all.extend(findings.into_iter().map(|finding| (name.clone(), finding)));
    }
    let broken = all.iter().filter(|(_, finding)| !finding.holds()).count();
    if let Some(path) = &arguments.json {
        let cases: Vec<_> = all
            .iter()
            .map(|(backend, f)| {
                // JSON has no infinity.
                let worst = if f.worst.is_finite() { json!(f.worst) } else { json!(f.worst.to_string()) };
                json!({ "part": f.part, "case": f.case, "backend": backend, "law": f.law, "worst": worst, "bound": f.bound, "holds": f.holds() })
            })
            .collect();
        let text =
            serde_json::to_string_pretty(&json!({ "cases": cases, "broken": broken })).map_err(Error::run)?;
        write_atomically(path, text.as_bytes())?;
    }
    terminal::line(format!("{} laws on {}: {broken} broken", all.len(), chosen.join(", ")));
    match broken {
        0 => Ok(0),
        _ => Err(Error::run(format!("{broken} of {} laws are broken", all.len()))),
    }
}
