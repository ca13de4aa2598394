//! Lines printed before a run starts: what the run will do and how much memory it needs.

use crate::formatting;
use std::path::Path;
use trimip_core::{
    Config, Frames, Layout, Slot, ViewSet, config::Contraction, engine::events::Event, field::encoders,
    scene_plan::Finding,
};

/// Overview of a run, including the scene plan.
#[derive(Clone, Debug)]
pub struct Overview {
    /// One line each, in the form "subject: action".
    pub lines: Vec<String>,
    /// One line each for data, space, model, time, memory, plan and folder.
    pub summary: Vec<String>,
    /// Predicted peak memory, bytes.
    pub memory_bytes: u64,
}

/// Properties of the scene that are known before training.
pub struct Subject<'a> {
    /// Name of the scene.
    pub name: &'a str,
    /// The reader's description of the data.
    pub description: &'a [String],
    /// Training views.
    pub train: &'a ViewSet,
    /// Test frames.
    pub test: &'a dyn Frames,
}

impl Overview {
    /// Returns the overview of a run that starts at `step` and writes to `folder`; `findings` are the scene plan's, and
    /// `memory` has the name and bytes of each part.
    pub fn new(
        config: &Config,
        subject: &Subject<'_>,
        findings: &[Finding],
        memory: &[(String, u64)],
        folder: &Path,
        step: u64,
    ) -> Self {
        let memory_bytes = memory.iter().map(|(_, bytes)| bytes).sum();
        let mut lines = vec![format!("scene: {}", subject.name)];
        lines.extend(subject.description.iter().map(|line| format!("data: {line}")));
        let finest = config.train.finest_scale.at(0.0) as usize;
        lines.extend(subject.train.scales.iter().enumerate().map(|(index, scale)| {
            // At a balance of b, a pixel is drawn weight^b times as often, and its ray has the weight weight^(1 - b) in the loss.
            let drawn = scale.weight.powf(config.train.scale_weighting.at(0.0) as f32);
            let first = if index < finest { ", left out at first" } else { "" };
            format!(
                "scale 1/{}: {}, {}, drawn {drawn:.3} times as often at loss weight {:.3}{first}",
                scale.factor,
                formatting::count(scale.views.len() as u64, "training view"),
                formatting::many(scale.pixels.len() as u64, "pixel"),
                scale.weight / drawn
            )
        }));
        lines.extend(findings.iter().map(ToString::to_string));
        lines.push(model_line(config));
        lines.push(train_line(config, step));
        lines.push(evaluation_line(config, subject.test.len()));
        let parts: Vec<_> =
            memory.iter().map(|(part, bytes)| format!("{part} {}", formatting::bytes(*bytes))).collect();
        lines.push(format!("memory: {} ({})", formatting::bytes(memory_bytes), parts.join(", ")));
        lines.push(format!("folder: {}", folder.display()));
        let mut summary = vec![data_summary(subject), space_summary(config), model_summary(config)];
        summary.push(time_summary(config, step));
        summary.push(format!("memory: {}", formatting::bytes(memory_bytes)));
        summary.extend(plan_summary(findings));
        summary.push(format!("folder: {}", folder.display()));
        Self { lines, summary, memory_bytes }
    }

    /// Returns the event that begins a run.
    pub fn event(self) -> Event {
        Event::Plan { lines: self.lines, summary: self.summary, memory_bytes: self.memory_bytes }
    }
}

fn data_summary(subject: &Subject<'_>) -> String {
    let finest = subject.train.scales.first().map_or(0..0, |scale| scale.views.clone());
    let of = |view: &trimip_core::View| [view.camera.intrinsics.width, view.camera.intrinsics.height];
    let views = &subject.train.views[finest];
    let size = views.first().map_or([0, 0], of);
    let size = match views.iter().all(|view| of(view) == size) {
        true => format!("{}×{}", size[0], size[1]),
        false => "several sizes".into(),
    };
    format!(
        "data: {}, {} training and {} of {size}",
        subject.name,
        views.len(),
        formatting::count(subject.test.len() as u64, "test photograph")
    )
}

fn space_summary(config: &Config) -> String {
    let scene = &config.scene;
    let sides: Vec<f64> = scene
        .aabb_min
        .iter()
        .zip(scene.aabb_max)
        .map(|(low, high)| f64::from(high) - f64::from(*low))
        .collect();
    match scene.contraction {
        Contraction::None => {
            format!(
                "space: a box of {} units",
                sides.iter().map(|side| format!("{side:.3}")).collect::<Vec<_>>().join("×")
            )
        }
        // The diameter of the uncontracted ball is half the side of the box.
        Contraction::Ball => {
            format!("space: unbounded, contracted beyond {:.3} units from the centre", sides[0] / 4.0)
        }
    }
}

fn model_summary(config: &Config) -> String {
    let (layout, kind) = (Layout::new(config), config.encoder.kind.name());
    let values: u64 = layout.slots.iter().map(|slot| slot.range.len() as u64).sum();
    format!("model: {}, {}", kind.trim_matches('"'), formatting::many(values, "parameter"))
}

fn time_summary(config: &Config, step: u64) -> String {
    let length = match config.train.steps {
        0 => formatting::duration(config.train.seconds),
        steps => formatting::count(steps, "step"),
    };
    let from = if step > 0 { format!(" from step {step} on") } else { String::new() };
    format!("time: {length} of training{from}, backend {}", config.backend)
}

/// Returns how many of the plan's decisions changed settings, in words; `None` without a plan.
fn plan_summary(findings: &[Finding]) -> Option<String> {
    let changing = findings.iter().filter(|finding| !finding.changes.is_empty()).count();
    (!findings.is_empty()).then(|| {
        format!(
            "plan: {} from the photographs; -v lists them all",
            formatting::count(changing as u64, "decision")
        )
    })
}

fn model_line(config: &Config) -> String {
    let (layout, field) = (Layout::new(config), &config.field);
    let [hidden, density, color] = [field.hidden, field.density_layers, field.color_layers].map(u64::from);
    let values = |slots: &[Slot]| slots.iter().map(|slot| slot.range.len() as u64).sum::<u64>();
    let blind = if field.directions { "" } else { ", without view directions" };
    format!(
        "model: {}, {}; hidden layers {hidden}×{density} for density and {hidden}×{color} for colour{blind}, {}",
        encoders::of(config).describe(config),
        formatting::many(values(layout.encoder()), "value"),
        formatting::many(values(layout.networks()), "weight"),
    )
}

fn train_line(config: &Config, step: u64) -> String {
    let train = &config.train;
    let per_step = formatting::many(train.samples_per_step.into(), "sample");
    let length = if train.steps > 0 {
        let total = train.steps.saturating_mul(train.samples_per_step.into());
        let steps = formatting::count(train.steps, "step");
        format!("{steps} of {per_step}, {} in all", formatting::many(total, "sample"))
    } else {
        format!("{} at {per_step} a step", formatting::duration(train.seconds))
    };
    let from = if step > 0 { format!(", resumed from step {step}") } else { String::new() };
    format!("training: {length}{from}; backend {}, seed {}", config.backend, config.seed)
}

fn evaluation_line(config: &Config, views: usize) -> String {
    let eval = &config.eval;
    let all = formatting::count(views as u64, "test view");
    let on = |stride: usize| match (views.div_ceil(stride.max(1)), eval.time_fraction > 0.0) {
        (count, false) => format!("{count} of {all}"),
        (count, true) => format!("up to {count} of {all}"),
    };
    let way = match eval.points {
        0 => "none during training".to_string(),
        points => {
            let times = formatting::count(points, "time");
            format!("{times} during training on {}", on(eval.stride_of(views)))
        }
    };
    let end = eval
        .final_stride(views)
        .map_or("none at the end".into(), |stride| format!("at the end on {}", on(stride)));
    let floor = if eval.min_psnr > 0.0 {
        format!("; fails below a mean PSNR of {} dB", eval.min_psnr)
    } else {
        String::new()
    };
    let bound = match eval.time_fraction {
        0.0 => String::new(),
        fraction => format!("; at most {:.0} % of the training time and 20 s", 100.0 * fraction),
    };
    format!("evaluation: {way}, {end}{bound}{floor}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_model_is_counted() {
        let line = model_line(&Config::default());
        assert!(line.contains("512×512×16") && line.contains("12.6 M values"), "{line}");
        // 48·128 + 128·16 + 31·128 + 128·128 + 128·3
        assert!(line.contains("128×1 for density and 128×2") && line.contains("28.9 k weights"), "{line}");
    }

    #[test]
    fn one_of_a_thing_has_no_s() {
        let mut config = Config::default();
        (config.train.steps, config.train.samples_per_step, config.encoder.levels) = (1, 1, 1);
        (config.eval.points, config.eval.stride) = (1, 1);
        assert!(train_line(&config, 0).contains("1 step of 1 sample, 1 sample in all"));
        assert!(model_line(&config).contains("1 mip level,"));
        let line = evaluation_line(&config, 1);
        assert!(line.contains("1 time during training on up to 1 of 1 test view,"), "{line}");
    }

    #[test]
    fn a_budget_of_time_replaces_steps() {
        let mut config = Config::default();
        (config.train.steps, config.train.samples_per_step) = (25_000, 262_144);
        assert!(
            train_line(&config, 5).contains("25000 steps") && train_line(&config, 5).contains("from step 5")
        );
        config.train.steps = 0;
        assert!(
            train_line(&config, 0).starts_with("training: 5 min 00 s at 262 k samples"),
            "{}",
            train_line(&config, 0)
        );
    }

    #[test]
    fn a_summary_has_lines_that_fit_a_terminal() {
        let mut config = Config::default();
        config.train.seconds = 5400.0;
        let lines = [space_summary(&config), model_summary(&config), time_summary(&config, 123_456)];
        assert!(lines.iter().all(|line| line.chars().count() <= 80), "{lines:#?}");
        assert_eq!(lines[0], "space: a box of 3.000×3.000×3.000 units");
        assert_eq!(lines[1], "model: tri-mip, 12.6 M parameters");
        assert_eq!(lines[2], "time: 1 h 30 min of training from step 123456 on, backend cpu");
        config.scene.contraction = Contraction::Ball;
        assert_eq!(space_summary(&config), "space: unbounded, contracted beyond 0.750 units from the centre");
        assert_eq!(plan_summary(&[]), None);
    }
}
