//! `plan`: lists the parts that a scene does not need, with reasons. With `--measure`, it also measures what leaving them out costs in dB
//! and saves in seconds and bytes. Each run adds one decision to those of the previous run, trains on equally many samples, and is measured
//! on held-out training views.

use crate::args::PlanArguments;
use crate::curves::aligned;
use crate::interrupt::EXIT_CODE;
use crate::progress::open;
use crate::verbs::bench::training::{self, Bench, Variant, VariantRow};
use crate::{settings, terminal};
use serde::Serialize;
use serde_json::json;
use trimip::{backends, data::Scene, inspect};
use trimip_core::config::PlanChoice;
use trimip_core::engine::exchange::{Rank, Ranks};
use trimip_core::scene_plan::{self, Facts, Finding};
use trimip_core::{Config, Error, Result, ViewSet, atomic::write_atomically};

/// Number of held-out training views that are measured.
const KEPT_BACK: usize = 4;

/// The decision that needs a training run: whether the colour network needs directions.
const BLIND: &str = "directions";

/// For directions, a change of PSNR up to this, in dB, is inconclusive even if the seeds agree.
const CHANCE: f64 = 0.05;

/// Prints a line per decision and, with `--measure`, measures them.
pub fn run(arguments: &PlanArguments) -> Result<u8> {
    let Planned { scene, findings, config: planned, warnings } = Planned::of(arguments, Rank::ONLY)?;
    terminal::line(format!("scene plan of {}", scene.name));
    scene.unpacked.iter().for_each(terminal::prose);
    for finding in &findings {
        terminal::prose(finding);
        for change in &finding.changes {
            terminal::prose(format!("    {} = {} (was {})", change.path, change.to, change.from));
        }
    }
    for warning in warnings {
        terminal::line(format!("warning: {warning}"));
    }
    let mut report = json!({ "scene": scene.name, "findings": findings, "config": planned.to_toml() });
    if arguments.measure {
        let bench = bench(arguments, &planned, &scene.train, &findings)?;
        drop(scene);
        let Some(rows) = training::measure(&bench)? else { return Ok(EXIT_CODE) };
        let rows = effects(&rows);
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

/// Does this rank's part of the runs of [`run`]; called on ranks other than 0.
///
/// # Errors
/// When the scene cannot be opened on this machine.
pub fn work(arguments: &PlanArguments, ranks: &dyn Ranks) -> Result<()> {
    let Planned { scene, findings, config, .. } = Planned::of(arguments, ranks.on_machine())?;
    let bench = bench(arguments, &config, &scene.train, &findings)?;
    drop(scene);
    training::work(&bench, ranks)
}

/// The plan of a scene.
struct Planned {
    scene: Scene,
    findings: Vec<Finding>,
    config: Config,
    warnings: Vec<String>,
}

impl Planned {
    fn of(arguments: &PlanArguments, near: Rank) -> Result<Self> {
        let (mut settings, configured) = settings::load_scene(&arguments.scene, &arguments.settings)?;
        let scene = open(&configured.section()?)?;
        let compute = backends::compute(&configured, near)?;
        let test = scene.test.cameras();
        let facts = Facts {
            train: &scene.train,
            test: &test,
            stated: scene.stated.as_ref(),
            origin: scene.origin,
            compute: &compute,
        };
        let findings = scene_plan::make(&mut settings, &facts)?;
        let config = Config::from_settings(&settings)?;
        let warnings = inspect::warnings(&scene, &config, &facts);
        Ok(Self { scene, findings, config, warnings })
    }
}

/// Returns the runs to compare: brief, with equally many samples, evaluated at their end on held-out training views. The first run leaves
/// nothing out; each further run leaves out one more part.
fn bench(
    arguments: &PlanArguments,
    planned: &Config,
    train: &ViewSet,
    findings: &[Finding],
) -> Result<Bench> {
    if !(arguments.samples.is_finite() && arguments.samples > 0.0) {
        return Err(Error::input(
            "--samples",
            "is not a number of samples",
            "give a number above 0, in millions",
        ));
    }
    let steps = (arguments.samples * 1e6 / f64::from(planned.train.samples_per_step)).ceil();
    let frames = train.views.len() / train.scales.len().max(1);
    let base = settings::load(&arguments.settings)?
        .0
        .with("train.steps", steps as i64)?
        .with("data.root", planned.data.root.as_str())?
        .with("train.samples_per_step", i64::from(planned.train.samples_per_step))?
        .with("eval.time_fraction", 0)?
        .with("eval.min_gain", 0)?
        .with("train.checkpoint_seconds", 0)?
        .with("data.test_list", "")?
        .with("data.holdout_by", "stride")?
        .with("data.holdout", (frames / KEPT_BACK).max(2) as i64)?
        .with("eval.points", 0)?
        .with("eval.final", 1)?
        .with("eval.images", 0)?
        .with("eval.min_psnr", 0)?;
    let mut taken: Vec<&str> =
        findings.iter().filter(|f| f.left_out && f.decision != BLIND).map(|f| f.decision.as_str()).collect();
    // The data cannot show whether directions are needed; a training run can.
    taken.extend(findings.iter().find(|f| f.decision == BLIND && f.choice != PlanChoice::Off).map(|_| BLIND));
    let forced = |key: &str| findings.iter().any(|f| f.decision == key && f.choice == PlanChoice::On);
    let variant = |count: usize| {
        let name = if count == 0 { "nothing left out".into() } else { format!("and {}", taken[count - 1]) };
        let choices = scene_plan::keys().map(|key| match taken[..count].contains(&key) {
            true if key == BLIND => format!("plan.{BLIND}=on"),
            true => format!("plan.{key}={}", if forced(key) { "on" } else { "auto" }),
            false => format!("plan.{key}=off"),
        });
        Variant { name, assignments: choices.collect() }
    };
    Ok(Bench {
        base,
        variants: (0..=taken.len()).map(variant).collect(),
        seeds: arguments.seeds,
        reach: Vec::new(),
        out: arguments.out.clone(),
    })
}

/// Cost and savings of one more decision.
#[derive(Debug, Serialize)]
struct Effect {
    plan: String,
    psnr: f64,
    /// Change of PSNR from the previous run, dB.
    psnr_change: f64,
    /// Spread of PSNR between seeds in dB, the larger one of the two compared runs.
    psnr_spread: f64,
    seconds: f64,
    /// Time divided by the first run's time.
    seconds_share: f64,
    model_bytes: f64,
}

/// Returns the effects of the runs, in order.
fn effects(rows: &[VariantRow]) -> Vec<Effect> {
    rows.iter()
        .enumerate()
        .map(|(i, row)| {
            let before = &rows[i.saturating_sub(1)];
            Effect {
                plan: row.name.clone(),
                psnr: row.psnr,
                psnr_change: row.psnr - before.psnr,
                psnr_spread: row.spread.max(before.spread),
                seconds: row.seconds,
                seconds_share: row.seconds / rows[0].seconds,
                model_bytes: row.model_bytes,
            }
        })
        .collect()
}

/// Conclusion about the directions.
struct Verdict {
    /// Whether directions are needed; `None` if the change is not larger than the spread between seeds.
    needed: Option<bool>,
    text: String,
}

fn verdict(effects: &[Effect]) -> Option<Verdict> {
    let name = format!("and {BLIND}");
    let effect = effects.iter().find(|effect| effect.plan == name && effect.psnr_change.is_finite())?;
    let (change, spread) = (effect.psnr_change, effect.psnr_spread);
    let needed = (change.abs() > spread.max(CHANCE)).then_some(change < 0.0);
    let verdict = match needed {
        Some(true) => "needed",
        Some(false) => "not needed, plan.directions = \"on\" leaves them out",
        None => "not distinguishable from chance, more --samples or --seeds may decide it",
    };
    let text = format!("plan.{BLIND}: {verdict}: without them {change:+.2} dB, seeds {spread:.2} dB apart");
    Some(Verdict { needed, text })
}

fn table(effects: &[Effect]) -> String {
    let mut cells =
        vec![["plan", "PSNR / dB", "change", "seconds", "of all", "model"].map(String::from).to_vec()];
    for effect in effects {
        cells.push(vec![
            effect.plan.clone(),
            format!("{:.2}", effect.psnr),
            format!("{:+.2}", effect.psnr_change),
            format!("{:.1}", effect.seconds),
            format!("{:.0} %", 100.0 * effect.seconds_share),
            terminal::bytes(effect.model_bytes as u64),
        ]);
    }
    aligned(&cells)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn effect(plan: &str, psnr_change: f64) -> Effect {
        let (psnr, seconds, seconds_share, model_bytes) = (25.0, 1.0, 1.0, 1e6);
        Effect { plan: plan.into(), psnr, psnr_change, psnr_spread: 0.1, seconds, seconds_share, model_bytes }
    }

    #[test]
    fn directions_are_needed_where_leaving_them_out_costs() {
        let verdict = |change: f64| {
            verdict(&[effect("nothing left out", 0.0), effect("and directions", change)])
                .map(|verdict| verdict.needed)
        };
        assert_eq!([-0.41, -0.09, 0.2].map(verdict), [Some(Some(true)), Some(None), Some(Some(false))]);
        assert_eq!(verdict(f64::NAN), None, "nothing was measured");
        assert!(super::verdict(&[effect("nothing left out", 0.0)]).is_none());
    }
}
