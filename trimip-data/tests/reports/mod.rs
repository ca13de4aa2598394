//! Problems with data that users reported to the trackers of other programs. Each entry of `../data/reports.toml` names
//! an input, which is written and opened here, and the expected result.

mod colmap;
mod phones;
mod photogrammetry;
mod photographs;
mod transforms;

use crate::common::{ring, settings};
use serde::Deserialize;
use std::{collections::BTreeSet, path::Path};
use trimip_core::Camera;
use trimip_data::open;

/// Writes an input into a folder. Returns the expected cameras of nine photographs, in order of their names, or none if
/// cameras are not compared.
type Input = fn(&Path) -> Vec<Camera>;

/// A report.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Report {
    /// Where it was reported: repository and number.
    source: String,
    /// The reported input, in words.
    tried: String,
    /// The correct behaviour.
    right: String,
    /// The name of its input.
    input: String,
    /// The number of training views.
    train: Option<usize>,
    /// A part of the message with which it is refused.
    refused: Option<String>,
    /// A part of a warning.
    warned: Option<String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Reports {
    report: Vec<Report>,
}

fn reports() -> Vec<Report> {
    toml::from_str::<Reports>(include_str!("../data/reports.toml")).unwrap().report
}

fn inputs() -> impl Iterator<Item = &'static (&'static str, Input)> {
    let all: [&[(&str, Input)]; 5] =
        [colmap::INPUTS, transforms::INPUTS, photogrammetry::INPUTS, phones::INPUTS, photographs::INPUTS];
    all.into_iter().flatten()
}

/// Opens the input of a report. Returns the result if it differs from the one that the report expects.
fn failure(report: &Report, input: Input) -> Option<String> {
    let folder = tempfile::tempdir().unwrap();
    let expected = input(folder.path());
    match (open(&settings(folder.path(), 1)), &report.refused) {
        (Ok(scene), None) => {
            if Some(scene.train.views.len()) != report.train {
                return Some(format!("{} training views: {:?}", scene.train.views.len(), scene.warnings));
            }
            let warned = |what: &String| scene.warnings.iter().any(|warning| warning.contains(what));
            if !report.warned.as_ref().is_none_or(warned) {
                return Some(format!("the warnings are {:?}", scene.warnings));
            }
            if !expected.is_empty() {
                ring::assert_cameras(&scene, &expected);
            }
            None
        }
        (Err(error), Some(what))
            if error.message().contains(what) && error.kind() == trimip_core::ErrorKind::Input =>
        {
            None
        }
        (Err(error), _) => Some(format!("refused: {}", error.message())),
        (Ok(scene), Some(_)) => Some(format!("read: {:?}", scene.warnings)),
    }
}

#[test]
fn every_report_comes_out_right() {
    let mut failures = Vec::new();
    for report in reports() {
        let name = &report.input;
        let (_, input) =
            inputs().find(|(other, _)| other == name).unwrap_or_else(|| panic!("no input {name}"));
        println!("{}: {name}", report.source);
        failures.extend(failure(&report, *input).map(|what| format!("{} ({name}): {what}", report.source)));
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

#[test]
fn every_report_is_complete_and_every_input_is_one_of_a_report() {
    let reports = reports();
    for report in &reports {
        assert!(report.train.is_some() != report.refused.is_some(), "{}: one of both", report.source);
        assert!(report.source.contains('#') && !report.tried.is_empty() && !report.right.is_empty());
    }
    let used: BTreeSet<&str> = reports.iter().map(|report| report.input.as_str()).collect();
    let known: Vec<&str> = inputs().map(|(name, _)| *name).collect();
    assert_eq!(used, known.iter().copied().collect(), "reports and inputs");
    assert_eq!(used.len(), known.len(), "inputs have names of their own");
}
