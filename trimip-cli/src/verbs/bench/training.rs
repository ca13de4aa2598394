//! Error against seconds of training of a set of configurations, several seeds each, on one plot and in one table, with the
//! variants marked that no other beats in both. Runs that are finished in the folder are not run again; `page.rs` writes
//! what came out.

use super::page;
use crate::args::{BenchArguments, ProgressStyle, SettingsArguments, TrainArguments};
use crate::curves::{Curve, Measure, Reach, aligned};
use crate::interrupt::EXIT_CODE;
use crate::report::svg;
use crate::{run_folder, settings, terminal, verbs::train};
use serde_json::Value;
use std::path::{Path, PathBuf};
use trimip_core::{Error, Result};

/// A configuration to be tried.
#[derive(Clone, Debug, PartialEq)]
struct Variant {
    name: String,
    assignments: Vec<String>,
}

/// What came of a run.
struct Outcome {
    folder: PathBuf,
    report: Value,
    curve: Curve,
}

/// A variant's figures over its seeds.
#[derive(Debug, serde::Serialize)]
pub struct Row {
    /// What it is called.
    pub name: String,
    /// What it sets.
    pub settings: Vec<String>,
    /// Number of its runs.
    pub seeds: usize,
    /// Of training.
    pub seconds: f64,
    /// Mean of the scales, dB.
    pub psnr: f64,
    /// Largest less smallest of the seeds, dB.
    pub spread: f64,
    /// Mean of the scales.
    pub ssim: f64,
    /// Samples kept.
    pub samples: f64,
    /// Size of the model file.
    pub model_bytes: f64,
    /// Largest resident memory, where known.
    pub peak_memory_bytes: Option<f64>,
    /// No other variant is both faster and better.
    pub pareto: bool,
    /// Mean time at which the seeds reach each PSNR, where all do; at most that where one was there before its first
    /// measure.
    pub reaches: Vec<Option<Reach>>,
    /// Folders of its runs.
    pub runs: Vec<PathBuf>,
}

/// Trains what is not trained yet, then lays everything beside each other.
pub fn run(arguments: &BenchArguments) -> Result<u8> {
    let variants = variants(arguments)?;
    // Every setting is checked before the first run begins.
    for variant in &variants {
        settings::load(&with(&arguments.settings, variant, 0)?)?;
    }
    let most = svg::COLORS.len();
    if variants.len() > most {
        return Err(Error::input(
            "bench",
            format!("{} variants", variants.len()),
            format!("try at most {most} at once"),
        ));
    }
    run_folder::create_writable(&arguments.out)?;
    let mut reach: Vec<f64> = arguments.reach.iter().copied().filter(|psnr| psnr.is_finite()).collect();
    reach.sort_by(f64::total_cmp);
    let mut rows = Vec::new();
    let mut lines = Vec::new();
    for (variant, color) in variants.iter().zip(svg::COLORS) {
        let mut outcomes = Vec::new();
        for seed in 0..arguments.seeds {
            terminal::aside(format!("{}, seed {} of {}", variant.name, seed + 1, arguments.seeds));
            let folder = arguments.out.join(format!("{}-{seed}", slug(&variant.name)));
            let code = train::run(&TrainArguments {
                settings: with(&arguments.settings, variant, seed)?,
                out: Some(folder.clone()),
                progress: if terminal::watched() { ProgressStyle::Bar } else { ProgressStyle::Json },
                ..TrainArguments::default()
            })?;
            if code != 0 {
                return Ok(if code == EXIT_CODE { EXIT_CODE } else { code });
            }
            outcomes.push(outcome(&folder)?);
        }
        lines.extend(outcomes.iter().map(|outcome| {
            let mut line = outcome.curve.line(color);
            line.name.clone_from(&variant.name);
            line
        }));
        rows.push(row(variant, &outcomes, &reach));
    }
    mark_front(&mut rows);
    terminal::line(aligned(&cells(&rows, &reach)));
    page::write(arguments, &rows, &lines, &reach)?;
    terminal::aside(format!("report: {}", arguments.out.join("bench.html").display()));
    Ok(0)
}

/// The variants that the arguments name, the shared settings first.
fn variants(arguments: &BenchArguments) -> Result<Vec<Variant>> {
    let mut variants = Vec::new();
    if !arguments.no_base {
        variants.push(Variant { name: "base".into(), assignments: Vec::new() });
    }
    for text in &arguments.variants {
        let (name, assignments) = text.split_once(':').ok_or_else(|| {
            Error::input(format!("--try '{text}'"), "no name", "write 'NAME: KEY=VALUE; KEY=VALUE'")
        })?;
        let assignments = assignments.split(';').map(|a| a.trim().to_string()).filter(|a| !a.is_empty());
        variants.push(Variant { name: name.trim().into(), assignments: assignments.collect() });
    }
    for text in &arguments.vary {
        let (key, values) = text.split_once('=').ok_or_else(|| {
            Error::input(format!("--vary '{text}'"), "no values", "write 'KEY=VALUE|VALUE'")
        })?;
        variants.extend(values.split('|').map(|value| {
            let assignment = format!("{}={}", key.trim(), value.trim());
            Variant { name: assignment.clone(), assignments: vec![assignment] }
        }));
    }
    let twice = variants
        .iter()
        .enumerate()
        .find(|(i, v)| variants[..*i].iter().any(|w| slug(&w.name) == slug(&v.name)));
    match twice {
        Some((_, variant)) => {
            Err(Error::input("bench", format!("two variants `{}`", variant.name), "name them apart"))
        }
        None if variants.is_empty() => {
            Err(Error::input("bench", "no variant", "name some by --try or --vary"))
        }
        None => Ok(variants),
    }
}

/// A name as a folder's.
fn slug(name: &str) -> String {
    let letters = name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '.' { c } else { '-' });
    letters.collect::<String>().trim_matches('-').to_lowercase()
}

/// Settings of a variant's run; later assignments win. The seeds of a bench follow the configured one.
fn with(shared: &SettingsArguments, variant: &Variant, seed: u32) -> Result<SettingsArguments> {
    let mut settings = shared.clone();
    settings.set.extend(variant.assignments.iter().cloned());
    let configured = settings::load(&settings)?.1.seed;
    settings.set.push(format!("seed={}", configured + u64::from(seed)));
    Ok(settings)
}

fn outcome(folder: &Path) -> Result<Outcome> {
    let path = folder.join("report.json");
    let unreadable = |error: &dyn std::fmt::Display| {
        Error::input(path.display(), error, "remove the run's folder to run it again")
    };
    let text = std::fs::read(&path).map_err(|error| unreadable(&error))?;
    let report: Value = serde_json::from_slice(&text).map_err(|error| unreadable(&error))?;
    if !report["mean"]["psnr"].is_f64() {
        return Err(Error::input(path.display(), "the run was not evaluated", "set eval.final = 1"));
    }
    let curve = Curve::read(&folder.display().to_string())?;
    Ok(Outcome { folder: folder.to_path_buf(), report, curve })
}

fn row(variant: &Variant, outcomes: &[Outcome], reach: &[f64]) -> Row {
    let values = |pick: &dyn Fn(&Value) -> &Value| -> Vec<f64> {
        outcomes.iter().filter_map(|outcome| pick(&outcome.report).as_f64()).collect()
    };
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let psnr = values(&|report| &report["mean"]["psnr"]);
    let largest = psnr.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let smallest = psnr.iter().copied().fold(f64::INFINITY, f64::min);
    let memory = values(&|report| &report["peak_memory_bytes"]);
    let reaches = reach.iter().map(|&psnr| {
        let times: Option<Vec<Reach>> = outcomes.iter().map(|outcome| outcome.curve.reaches(psnr)).collect();
        times.map(|times| Reach {
            seconds: mean(&times.iter().map(|reach| reach.seconds).collect::<Vec<_>>()),
            at_most: times.iter().any(|reach| reach.at_most),
        })
    });
    Row {
        name: variant.name.clone(),
        settings: variant.assignments.clone(),
        seeds: outcomes.len(),
        seconds: mean(&values(&|report| &report["train_seconds"])),
        psnr: mean(&psnr),
        spread: largest - smallest,
        ssim: mean(&values(&|report| &report["mean"]["ssim"])),
        samples: mean(&values(&|report| &report["samples"])),
        model_bytes: mean(&values(&|report| &report["model_bytes"])),
        peak_memory_bytes: (!memory.is_empty()).then(|| mean(&memory)),
        pareto: false,
        reaches: reaches.collect(),
        runs: outcomes.iter().map(|outcome| outcome.folder.clone()).collect(),
    }
}

/// Marks the variants that no other beats in both time and error.
fn mark_front(rows: &mut [Row]) {
    let points: Vec<Measure> =
        rows.iter().map(|row| Measure { seconds: row.seconds, psnr: row.psnr }).collect();
    for (row, own) in rows.iter_mut().zip(&points) {
        let beats = |other: &Measure| other.seconds <= own.seconds && other.psnr >= own.psnr && other != own;
        row.pareto = !points.iter().any(beats);
    }
}

/// A head, then one row per variant.
pub fn cells(rows: &[Row], reach: &[f64]) -> Vec<Vec<String>> {
    let mut cells = vec![vec![
        "variant".to_string(),
        "seeds".into(),
        "seconds".into(),
        "PSNR / dB".into(),
        "spread".into(),
        "SSIM".into(),
        "samples".into(),
        "model".into(),
        "front".into(),
    ]];
    cells[0].extend(reach.iter().map(|psnr| format!("{psnr} dB after")));
    for row in rows {
        let mut line = vec![
            row.name.clone(),
            row.seeds.to_string(),
            format!("{:.1}", row.seconds),
            format!("{:.2}", row.psnr),
            format!("{:.2}", row.spread),
            format!("{:.4}", row.ssim),
            terminal::number(row.samples, ""),
            terminal::bytes(row.model_bytes as u64),
            if row.pareto { "*".into() } else { String::new() },
        ];
        line.extend(row.reaches.iter().map(|time| time.map_or("–".into(), |reach| reach.to_string())));
        cells.push(line);
    }
    cells
}

#[cfg(test)]
mod tests {
    use super::*;

    fn arguments(variants: &[&str], vary: &[&str]) -> BenchArguments {
        BenchArguments {
            render: None,
            width: 48,
            settings: SettingsArguments::default(),
            variants: variants.iter().map(|text| (*text).into()).collect(),
            vary: vary.iter().map(|text| (*text).into()).collect(),
            no_base: false,
            seeds: 1,
            reach: Vec::new(),
            out: PathBuf::new(),
        }
    }

    #[test]
    fn variants_are_named_and_told_apart() {
        let found =
            variants(&arguments(&["no mip: encoder.mipmap=false; seed=3"], &["field.hidden=32|64"])).unwrap();
        let names: Vec<&str> = found.iter().map(|variant| variant.name.as_str()).collect();
        assert_eq!(names, ["base", "no mip", "field.hidden=32", "field.hidden=64"]);
        assert_eq!(found[1].assignments, ["encoder.mipmap=false", "seed=3"]);
        assert_eq!(slug("field.hidden=32"), "field.hidden-32");
        for broken in [
            arguments(&["encoder.mipmap=false"], &[]),
            arguments(&[], &["field.hidden"]),
            arguments(&["a: seed=1", "A: seed=2"], &[]),
        ] {
            assert_eq!(variants(&broken).unwrap_err().exit_code(), 2);
        }
    }

    #[test]
    fn seeds_follow_the_configured_one() {
        let variant = Variant { name: String::new(), assignments: vec!["seed=5".into()] };
        let settings = with(&SettingsArguments::default(), &variant, 2).unwrap();
        assert_eq!(settings::load(&settings).unwrap().1.seed, 7);
    }

    #[test]
    fn the_front_has_what_nothing_beats_in_both() {
        let mut rows: Vec<Row> = [(10.0, 30.0), (20.0, 31.0), (15.0, 29.0), (20.0, 30.5), (10.0, 30.0)]
            .into_iter()
            .map(|(seconds, psnr)| Row {
                name: String::new(),
                settings: Vec::new(),
                seeds: 1,
                seconds,
                psnr,
                spread: 0.0,
                ssim: 1.0,
                samples: 1.0,
                model_bytes: 1.0,
                peak_memory_bytes: None,
                pareto: false,
                reaches: Vec::new(),
                runs: Vec::new(),
            })
            .collect();
        mark_front(&mut rows);
        assert_eq!(rows.iter().map(|row| row.pareto).collect::<Vec<_>>(), [true, true, false, false, true]);
    }
}
