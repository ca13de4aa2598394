//! `plan`: what the scene does not need and why; with `--measure`, what leaving it out costs in dB and saves in seconds and
//! bytes, each decision on top of those before it, at equal samples, on training views kept back.

use crate::args::{BenchArguments, PlanArguments, SettingsArguments};
use crate::curves::aligned;
use crate::progress::open;
use crate::verbs::bench;
use crate::{backends, settings, terminal};
use serde_json::{Value, json};
use trimip_core::config::PlanChoice;
use trimip_core::scene_plan::{self, Facts, Finding};
use trimip_core::{Config, Error, Result, ViewSet, tensors::write_atomically};

/// Training views kept back to measure on.
const KEPT_BACK: usize = 4;

/// The decision that only a training can take: the colour network without directions.
const BLIND: &str = "directions";

/// Change of PSNR that says nothing of directions even where seeds agree, dB.
const CHANCE: f64 = 0.05;

/// Prints a line for every decision, and measures where asked to.
pub fn run(arguments: &PlanArguments) -> Result<u8> {
    let (mut settings, configured) = settings::load_scene(&arguments.scene, &arguments.settings)?;
    let scene = open(&configured.data)?;
    let compute = backends::compute(&configured)?;
    let test = scene.test.cameras();
    let facts = Facts { train: &scene.train, test: &test, stated: scene.stated.as_ref(), compute: &compute };
    let findings = scene_plan::make(&mut settings, &facts)?;
    terminal::line(format!("scene plan of {}", scene.name));
    for finding in &findings {
        terminal::prose(finding);
        for change in &finding.changes {
            terminal::prose(format!("    {} = {} (was {})", change.path, change.to, change.from));
        }
    }
    let planned = Config::from_settings(&settings)?;
    for warning in scene_plan::warnings(&planned, &facts) {
        terminal::line(format!("warning: {warning}"));
    }
    let mut report = json!({ "scene": scene.name, "findings": findings, "config": planned.to_toml() });
    if arguments.measure {
        let shared = shared(arguments, &planned, &scene.train)?;
        drop(scene);
        let code = bench::training::run(&bench_arguments(arguments, shared, &findings))?;
        if code != 0 {
            return Ok(code);
        }
        let rows = effects(arguments)?;
        terminal::line(table(&rows));
        report["effects"] = json!(rows);
        if let Some(verdict) = verdict(&rows) {
            terminal::prose(&verdict.text);
            report["directions_needed"] = json!(verdict.needed);
        }
    }
    if let Some(path) = &arguments.json {
        let text = serde_json::to_string_pretty(&report).map_err(Error::run)?;
        write_atomically(path, text.as_bytes())?;
    }
    Ok(0)
}

/// The settings of all trainings: brief ones of equal samples, measured at their end on training views kept back.
fn shared(arguments: &PlanArguments, planned: &Config, train: &ViewSet) -> Result<SettingsArguments> {
    if !(arguments.samples.is_finite() && arguments.samples > 0.0) {
        return Err(Error::input(
            "--samples",
            "is no amount of samples",
            "give a number above 0, in millions",
        ));
    }
    let steps = (arguments.samples * 1e6 / f64::from(planned.train.samples_per_step)).ceil();
    let frames = train.views.len() / train.scales.len().max(1);
    let mut settings = arguments.settings.clone();
    settings.set.extend([
        format!("train.steps={steps:.0}"),
        format!("data.root={}", toml::Value::String(planned.data.root.clone())),
        format!("train.samples_per_step={}", planned.train.samples_per_step),
        "eval.share=0".into(),
        "eval.min_gain=0".into(),
        "train.checkpoint_seconds=0".into(),
        format!("data.holdout={}", (frames / KEPT_BACK).max(2)),
        "eval.points=0".into(),
        "eval.final=1".into(),
        "eval.images=0".into(),
        "eval.min_psnr=0".into(),
    ]);
    Ok(settings)
}

/// One training with nothing left out, then one more for each decision that leaves something out.
fn bench_arguments(
    arguments: &PlanArguments,
    settings: SettingsArguments,
    findings: &[Finding],
) -> BenchArguments {
    let mut taken: Vec<&str> =
        findings.iter().filter(|f| f.left_out && f.decision != BLIND).map(|f| f.decision.as_str()).collect();
    // Whether directions are needed the data do not tell; a training does.
    taken.extend(findings.iter().find(|f| f.decision == BLIND && f.choice != PlanChoice::Off).map(|_| BLIND));
    let forced = |key: &str| findings.iter().any(|f| f.decision == key && f.choice == PlanChoice::On);
    let variant = |count: usize| {
        let name = if count == 0 { "nothing left out".into() } else { format!("and {}", taken[count - 1]) };
        let choices = scene_plan::keys().map(|key| match taken[..count].contains(&key) {
            true if key == BLIND => format!("plan.{BLIND}=on"),
            true => format!("plan.{key}={}", if forced(key) { "on" } else { "auto" }),
            false => format!("plan.{key}=off"),
        });
        format!("{name}: {}", choices.collect::<Vec<_>>().join("; "))
    };
    BenchArguments {
        render: None,
        width: 48,
        settings,
        variants: (0..=taken.len()).map(variant).collect(),
        vary: Vec::new(),
        no_base: true,
        seeds: arguments.seeds,
        reach: Vec::new(),
        out: arguments.out.clone(),
    }
}

/// What the bench wrote: its variants in their order.
fn effects(arguments: &PlanArguments) -> Result<Vec<Value>> {
    let path = arguments.out.join("bench.json");
    let broken = |error: &dyn std::fmt::Display| Error::run(format!("{}: {error}", path.display()));
    let text = std::fs::read(&path).map_err(|error| broken(&error))?;
    let report: Value = serde_json::from_slice(&text).map_err(|error| broken(&error))?;
    let rows = report["variants"].as_array().cloned().unwrap_or_default();
    let number = |row: &Value, key: &str| row[key].as_f64().unwrap_or(f64::NAN);
    let first = rows.first().cloned().unwrap_or_default();
    let mut before = first.clone();
    let mut effects = Vec::new();
    for row in &rows {
        effects.push(json!({
            "plan": row["name"],
            "psnr": number(row, "psnr"),
            "psnr_change": number(row, "psnr") - number(&before, "psnr"),
            // The larger of both that are compared.
            "psnr_spread": number(row, "spread").max(number(&before, "spread")),
            "seconds": number(row, "seconds"),
            "seconds_share": number(row, "seconds") / number(&first, "seconds"),
            "model_bytes": number(row, "model_bytes"),
        }));
        before = row.clone();
    }
    Ok(effects)
}

/// What the trainings say of directions.
struct Verdict {
    /// `None` where the change is no larger than that between seeds.
    needed: Option<bool>,
    text: String,
}

fn verdict(rows: &[Value]) -> Option<Verdict> {
    let row = rows.iter().find(|row| row["plan"] == format!("and {BLIND}"))?;
    let (change, spread) = (row["psnr_change"].as_f64()?, row["psnr_spread"].as_f64()?);
    let needed = (change.abs() > spread.max(CHANCE)).then_some(change < 0.0);
    let verdict = match needed {
        Some(true) => "needed",
        Some(false) => "not needed, plan.directions = \"on\" leaves them out",
        None => "not to be told apart from chance, more --samples or --seeds may",
    };
    let text = format!("plan.{BLIND}: {verdict}: without them {change:+.2} dB, seeds {spread:.2} dB apart");
    Some(Verdict { needed, text })
}

fn table(rows: &[Value]) -> String {
    let mut cells =
        vec![["plan", "PSNR / dB", "change", "seconds", "of all", "model"].map(String::from).to_vec()];
    let number = |row: &Value, key: &str| row[key].as_f64().unwrap_or(f64::NAN);
    for row in rows {
        cells.push(vec![
            row["plan"].as_str().unwrap_or_default().into(),
            format!("{:.2}", number(row, "psnr")),
            format!("{:+.2}", number(row, "psnr_change")),
            format!("{:.1}", number(row, "seconds")),
            format!("{:.0} %", 100.0 * number(row, "seconds_share")),
            terminal::bytes(number(row, "model_bytes") as u64),
        ]);
    }
    aligned(&cells)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn directions_are_needed_where_leaving_them_out_costs() {
        let verdict = |change: f64| {
            let rows = [
                json!({ "plan": "nothing left out", "psnr_change": 0.0, "psnr_spread": 0.1 }),
                json!({ "plan": "and directions", "psnr_change": change, "psnr_spread": 0.1 }),
            ];
            verdict(&rows).map(|verdict| verdict.needed)
        };
        assert_eq!([-0.41, -0.09, 0.2].map(verdict), [Some(Some(true)), Some(None), Some(Some(false))]);
        assert_eq!(verdict(f64::NAN), None, "JSON has no such number");
        assert!(super::verdict(&[json!({ "plan": "nothing left out" })]).is_none());
    }
}
