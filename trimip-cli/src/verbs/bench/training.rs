//! Error against seconds of training for a set of configurations, with several seeds each, in one plot and one table. The Pareto-optimal
//! variants are marked. Runs that are already finished in the folder are not repeated. `page.rs` writes the results.

use super::page;
pub use super::results::{Bench, Variant, VariantRow, cells};
use crate::args::{BenchArguments, ProgressStyle};
use crate::curves::{Curve, Measure, Reach, aligned};
use crate::interrupt::EXIT_CODE;
use crate::{
    ranks, settings, terminal,
    verbs::{jobs, train},
};
use std::path::PathBuf;
use trimip::events::Totals;
use trimip::quality::{Measures, mean_quality};
use trimip::ranks::{digest, work_on_jobs};
use trimip::run::folder as run_folder;
use trimip::{Config, Error, Result, Settings, Trained, Training};
use trimip_core::engine::exchange::Ranks;
use trimip_data::settings::DataConfig;
use trimip_report::svg;

/// Result of a run.
struct Outcome {
    folder: PathBuf,
    mean: Measures,
    totals: Totals,
    model_bytes: Option<u64>,
    peak_memory_bytes: Option<u64>,
    curve: Curve,
}

/// Trains the runs that are not finished yet, then compares all of them.
pub fn run(arguments: &BenchArguments) -> Result<u8> {
    let mut reach: Vec<f64> = arguments.reach.iter().copied().filter(|psnr| psnr.is_finite()).collect();
    reach.sort_by(f64::total_cmp);
    Ok(if measure(&bench(arguments, reach)?)?.is_some() { 0 } else { EXIT_CODE })
}

fn bench(arguments: &BenchArguments, reach: Vec<f64>) -> Result<Bench> {
    Ok(Bench {
        variants: variants(arguments)?,
        base: settings::load(&arguments.settings)?.0,
        seeds: arguments.seeds,
        reach,
        out: arguments.out.clone(),
    })
}

/// Does this rank's part of [`run`]; called on ranks other than 0.
///
/// # Errors
/// When a setting is wrong.
pub fn help_run(arguments: &BenchArguments, ranks: &dyn Ranks) -> Result<()> {
    work(&bench(arguments, Vec::new())?, ranks)
}

/// Does this rank's part of [`measure`]; called on ranks other than 0.
///
/// # Errors
/// When rank 0 is gone or has other runs.
pub fn work(bench: &Bench, ranks: &dyn Ranks) -> Result<()> {
    work_on_jobs(ranks, &bench.digest()?, |run| Ok(jobs::job(ranks, bench.training(run))))
}

impl Bench {
    /// Returns the folder of a run.
    fn folder(&self, variant: &Variant, seed: u32) -> PathBuf {
        self.out.join(format!("{}-{seed}", slug(&variant.name)))
    }

    /// Returns a digest that is equal on all ranks with the same runs.
    fn digest(&self) -> Result<String> {
        let settings = |variant| Ok(Config::from_settings(&with(&self.base, variant, 0)?)?.to_toml());
        let variants = self.variants.iter().map(settings).collect::<Result<Vec<_>>>()?;
        Ok(digest(variants.into_iter().chain([format!("{} {:?}", self.seeds, self.out)])))
    }

    /// Returns the variant and the seed of run number `run`.
    fn variant(&self, run: usize) -> (&Variant, u32) {
        (&self.variants[run / self.seeds as usize], (run % self.seeds as usize) as u32)
    }

    /// Returns the settings of the data set of run number `run`.
    fn data(&self, run: usize) -> Result<DataConfig> {
        let (variant, seed) = self.variant(run);
        Config::from_settings(&with(&self.base, variant, seed)?)?.section()
    }

    /// Returns the training of run number `run`.
    fn training(&self, run: usize) -> Result<Training> {
        let (variant, seed) = self.variant(run);
        Ok(Training::new(with(&self.base, variant, seed)?, &self.folder(variant, seed)))
    }
}

/// Trains every variant with every seed, prints the table and writes the benchmark's pages. Returns `None` if the user stopped it. A run
/// that is already finished in its folder is not repeated.
///
/// # Errors
/// When a variant's settings are invalid, or a run fails.
pub fn measure(bench: &Bench) -> Result<Option<Vec<VariantRow>>> {
    let Bench { base, variants, seeds, reach, out } = bench;
    // Check every setting before the first run starts.
    for variant in variants {
        Config::from_settings(&with(base, variant, 0)?)?;
    }
    let most = svg::COLORS.len();
    if variants.len() > most {
        return Err(Error::input(
            "bench",
            format!("{} variants", variants.len()),
            format!("try at most {most} at once"),
        ));
    }
    run_folder::create_writable(out)?;
    let style = if terminal::watched() { ProgressStyle::Bar } else { ProgressStyle::Json };
    if let Some(ranks) = ranks::all() {
        // The loop below then finds these runs finished. A run that failed on another rank is tried once more in the loop.
        let runs: Vec<usize> = (0..variants.len() * *seeds as usize).collect();
        terminal::aside(format!(
            "{} on {} ranks",
            terminal::count(runs.len() as u64, "run"),
            ranks.rank().size
        ));
        if !jobs::spread(&*ranks, &bench.digest()?, &runs, |run| bench.data(run), |run| bench.training(run))?
        {
            return Ok(None);
        }
    }
    let (mut rows, mut lines) = (Vec::new(), Vec::new());
    for (variant, color) in variants.iter().zip(svg::COLORS) {
        let mut outcomes = Vec::new();
        for seed in 0..*seeds {
            terminal::aside(format!("{}, seed {} of {seeds}", variant.name, seed + 1));
            let training = Training::new(with(base, variant, seed)?, &bench.folder(variant, seed));
            let trained = train::train(training, style)?;
            if train::conclude(&trained, style)? != 0 {
                return Ok(None);
            }
            outcomes.push(outcome(&trained)?);
        }
        lines.extend(outcomes.iter().map(|outcome| {
            let mut line = outcome.curve.line(color);
            line.name.clone_from(&variant.name);
            line
        }));
        rows.push(row(variant, &outcomes, reach));
    }
    mark_front(&mut rows);
    terminal::line(aligned(&cells(&rows, reach)));
    page::write(bench, &rows, &lines)?;
    terminal::aside(format!("report: {}", out.join("bench.html").display()));
    Ok(Some(rows))
}

/// Returns the variants that the arguments define; the shared settings come first.
fn variants(arguments: &BenchArguments) -> Result<Vec<Variant>> {
    let mut variants = Vec::new();
    if !arguments.no_base {
        variants.push(Variant { name: "base".into(), assignments: Vec::new() });
    }
    variants.extend(tried(&arguments.variants)?);
    for text in &arguments.vary {
        let (key, values) = text.split_once('=').ok_or_else(|| {
            Error::input(format!("--vary '{text}'"), "has no values", "write 'KEY=VALUE|VALUE'")
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
            Err(Error::input("bench", format!("two variants `{}`", variant.name), "give each its own name"))
        }
        None if variants.is_empty() => {
            Err(Error::input("bench", "no variant", "define some with --try or --vary"))
        }
        None => Ok(variants),
    }
}

/// Returns the variants of `--try`.
pub fn tried(texts: &[String]) -> Result<Vec<Variant>> {
    let variant = |text: &String| {
        let (name, assignments) = text.split_once(':').ok_or_else(|| {
            Error::input(format!("--try '{text}'"), "has no name", "write 'NAME: KEY=VALUE; KEY=VALUE'")
        })?;
        let assignments = assignments.split(';').map(|a| a.trim().to_string()).filter(|a| !a.is_empty());
        Ok(Variant { name: name.trim().into(), assignments: assignments.collect() })
    };
    texts.iter().map(variant).collect()
}

/// Converts a name to a folder name.
fn slug(name: &str) -> String {
    let letters = name.chars().map(|c| if c.is_ascii_alphanumeric() || c == '.' { c } else { '-' });
    letters.collect::<String>().trim_matches('-').to_lowercase()
}

/// Returns the settings of a variant's run; later assignments win. `seed` is added to the configured seed.
fn with(base: &Settings, variant: &Variant, seed: u32) -> Result<Settings> {
    let mut settings = base.clone();
    variant.assignments.iter().try_for_each(|assignment| settings.apply_assignment(assignment))?;
    let configured = Config::from_settings(&settings)?.seed;
    settings.with("seed", (configured + u64::from(seed)).cast_signed())
}

fn outcome(trained: &Trained) -> Result<Outcome> {
    let (folder, history) = (trained.folder.root().to_path_buf(), &trained.history);
    let curve = Curve::of_run(&folder, history)?;
    let scales = history.best_known().map_or(&[][..], |evaluation| &evaluation.scales);
    Ok(Outcome {
        mean: mean_quality(scales),
        totals: history.totals,
        model_bytes: trained.model_bytes(),
        peak_memory_bytes: history.peak_memory_bytes(),
        curve,
        folder,
    })
}

fn row(variant: &Variant, outcomes: &[Outcome], reach: &[f64]) -> VariantRow {
    let mean = |values: &[f64]| values.iter().sum::<f64>() / values.len().max(1) as f64;
    let of = |pick: &dyn Fn(&Outcome) -> Option<f64>| outcomes.iter().filter_map(pick).collect::<Vec<_>>();
    let psnr = of(&|outcome| Some(outcome.mean.psnr));
    let largest = psnr.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let smallest = psnr.iter().copied().fold(f64::INFINITY, f64::min);
    let memory = of(&|outcome| outcome.peak_memory_bytes.map(|bytes| bytes as f64));
    let reaches = reach.iter().map(|&psnr| {
        let times: Option<Vec<Reach>> = outcomes.iter().map(|outcome| outcome.curve.reaches(psnr)).collect();
        times.map(|times| Reach {
            seconds: mean(&times.iter().map(|reach| reach.seconds).collect::<Vec<_>>()),
            at_most: times.iter().any(|reach| reach.at_most),
        })
    });
    VariantRow {
        name: variant.name.clone(),
        settings: variant.assignments.clone(),
        seeds: outcomes.len(),
        seconds: mean(&of(&|outcome| Some(outcome.totals.seconds))),
        psnr: mean(&psnr),
        spread: largest - smallest,
        ssim: mean(&of(&|outcome| Some(outcome.mean.ssim))),
        samples: mean(&of(&|outcome| Some(outcome.totals.samples as f64))),
        model_bytes: mean(&of(&|outcome| outcome.model_bytes.map(|bytes| bytes as f64))),
        peak_memory_bytes: (!memory.is_empty()).then(|| mean(&memory)),
        pareto: false,
        reaches: reaches.collect(),
        runs: outcomes.iter().map(|outcome| outcome.folder.clone()).collect(),
    }
}

/// Marks the variants that no other variant beats in both time and PSNR.
fn mark_front(rows: &mut [VariantRow]) {
    let points: Vec<Measure> =
        rows.iter().map(|row| Measure { seconds: row.seconds, psnr: row.psnr }).collect();
    for (row, own) in rows.iter_mut().zip(&points) {
        let beats = |other: &Measure| other.seconds <= own.seconds && other.psnr >= own.psnr && other != own;
        row.pareto = !points.iter().any(beats);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::args::SettingsArguments;

    fn arguments(variants: &[&str], vary: &[&str]) -> BenchArguments {
        BenchArguments {
            render: None,
            cones: false,
            ways: false,
            views: 4,
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
            assert_eq!(variants(&broken).unwrap_err().kind(), trimip_core::ErrorKind::Input);
        }
    }

    #[test]
    fn seeds_follow_the_configured_one() {
        let variant = Variant { name: String::new(), assignments: vec!["seed=5".into()] };
        let settings = with(&trimip::settings::defaults(), &variant, 2).unwrap();
        assert_eq!(Config::from_settings(&settings).unwrap().seed, 7);
    }

    #[test]
    fn the_front_has_what_nothing_beats_in_both() {
        let mut rows: Vec<VariantRow> =
            [(10.0, 30.0), (20.0, 31.0), (15.0, 29.0), (20.0, 30.5), (10.0, 30.0)]
                .into_iter()
                .map(|(seconds, psnr)| VariantRow {
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
