//! Stiff training: photographs that contradict each other or carry no information, learning rates and weights of all
//! sizes, empty grids and batches, runs of many steps.

use super::finding::{Finding, Make, Tell, not_finite, worst};
use super::rig::{camera, hash, photographs, small};
use glam::DVec3;
use trimip::machine::peak_memory;
use trimip_core::config::Untouched;
use trimip_core::engine::trainer::Trainer;
use trimip_core::field::tensors::Values;
use trimip_core::{Backend, Camera, Config, Intrinsics, Layout, Result, Session, ViewSet, Viewer};

fn found(case: impl Into<String>, law: &'static str, worst: f64, bound: f64) -> Finding {
    Finding { part: "training", case: case.into(), law, worst, bound }
}

/// Runs the cases of this part.
pub fn cases<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    photographs_of_all_kinds(make, tell)?;
    rates_and_weights(make, tell)?;
    untouched(make, tell)?;
    empty(make, tell)?;
    Ok(())
}

/// Trains `steps` steps. Returns the number of values that are not finite in the parameters, the loss and a picture,
/// and the distance of the picture's colours from the range [0, 1].
fn train<B: Backend>(make: Make<'_, B>, config: &Config, views: ViewSet, steps: u64) -> Result<[f64; 2]> {
    let camera = views.views[0].camera;
    let mut trainer = Trainer::new(make()?, config, views)?;
    let mut strange = 0.0;
    for step in 0..steps {
        let report = trainer.step(step as f64 / config.train.steps as f64)?;
        strange += not_finite(&[report.loss as f32]) + report.totals.non_finite as f64;
    }
    let frame = trainer.render(&camera)?;
    let colors: Vec<f32> = frame.pixels.iter().flat_map(|pixel| pixel.rgb).collect();
    strange += not_finite(&trainer.parameters()) + not_finite(&colors);
    let beyond = worst(colors.iter().map(|&c| f64::from((c - 1.0).max(-c))));
    Ok([strange, beyond])
}

fn told(case: &str, [strange, beyond]: [f64; 2]) -> [Finding; 2] {
    [
        found(case, "loss, parameters and pictures stay finite", strange, 0.0),
        // A pixel is a weighted mean of colours in [0, 1] and a background in [0, 1].
        found(case, "colours stay within 0 and 1", beyond, 2e-6),
    ]
}

fn photographs_of_all_kinds<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    let few: Vec<Camera> = (0..3).map(|i| camera(16, i)).collect();
    let same = vec![camera(16, 0); 3];
    let gray = |x: bool| if x { [255; 4] } else { [0, 0, 0, 255] };
    let cases: Vec<(&str, ViewSet)> = vec![
        ("all white", photographs(&few, 2, |_, _, _| [255; 4])),
        ("all black", photographs(&few, 2, |_, _, _| [0, 0, 0, 255])),
        ("all transparent", photographs(&few, 2, |_, _, _| [0; 4])),
        (
            "an object of one pixel",
            photographs(&few, 2, |_, x, y| if (x, y) == (8, 8) { [200, 30, 30, 255] } else { [0; 4] }),
        ),
        ("identical cameras, identical images", photographs(&same, 2, |_, x, y| hash(0, x, y))),
        ("identical cameras, contradictory images", photographs(&same, 2, |i, _, _| gray(i % 2 == 0))),
        ("one image", photographs(&few[..1], 2, hash)),
        ("one image of one pixel", photographs(&[camera(1, 0)], 1, |_, _, _| [10, 200, 30, 255])),
        ("checkers of 0 and 1 at every pixel", photographs(&few, 2, |_, x, y| gray((x + y) % 2 == 0))),
        ("area weights 1 to 4096", photographs(&[camera(64, 0)], 7, hash)),
    ];
    for (name, views) in cases {
        told(name, train(make, &small(), views, 24)?).into_iter().for_each(&mut *tell);
    }
    Ok(())
}

fn rates_and_weights<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    let views = || photographs(&[camera(16, 0), camera(16, 2)], 2, hash);
    let mut hot = small();
    hot.optimizer.learning_rate *= 100.0;
    told("learning rates x 100", train(make, &hot, views(), 24)?).into_iter().for_each(&mut *tell);
    let mut cold = small();
    cold.optimizer.learning_rate = 1e-12;
    told("learning rates of 1e-12", train(make, &cold, views(), 8)?).into_iter().for_each(&mut *tell);
    // One ray may have more samples than a whole batch: a long box with many steps, and few samples per training step.
    let mut one = small();
    (one.renderer.steps_per_diagonal, one.train.samples_per_step) = (4096, 256);
    told("a ray with more samples than a step", train(make, &one, views(), 12)?)
        .into_iter()
        .for_each(&mut *tell);
    Ok(())
}

/// Checks texels without a gradient. With "skip" they stay bit-identical. With "decay" they shrink by the documented
/// factor, even with an epsilon of 1e-15 and moments of zero.
fn untouched<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    for (name, way) in [("skip", Untouched::Skip), ("decay", Untouched::Decay)] {
        let mut config = small();
        // One corner of the planes is outside every view.
        (config.encoder.plane_size, config.encoder.levels) = (64, 2);
        (config.optimizer.untouched, config.optimizer.weight_decay) = (way, 0.1);
        let narrow = Intrinsics::from_angle(4, 4, 0.05);
        let camera = Camera::look_at(narrow, DVec3::new(4.0, 0.0, 0.0), DVec3::ZERO, DVec3::Z);
        let mut trainer = Trainer::new(make()?, &config, photographs(&[camera], 1, hash))?;
        let before = trainer.parameters();
        let layout = Layout::new(&config);
        let planes = layout.slots.iter().find(|slot| slot.name == "planes").map_or(0..0, |s| s.range.clone());
        let steps = 5;
        for _ in 0..steps {
            trainer.step(0.0)?;
        }
        let checkpoint = trainer.checkpoint()?;
        let after = trainer.parameters();
        let first = layout.from_tensors(&checkpoint.file, "checkpoint", ".m")?;
        let rate = config.optimizer.learning_rate * config.optimizer.plane_scale;
        let factor = match way {
            Untouched::Skip => 1.0,
            Untouched::Decay => (1.0 - rate * config.optimizer.weight_decay).powi(steps),
        };
        let still: Vec<usize> = planes.filter(|&i| first[i] == 0.0).collect();
        let moved = still.iter().map(|&i| {
            (f64::from(after[i]) - factor * f64::from(before[i])).abs()
                / f64::from(before[i]).abs().max(1e-30)
        });
        let bound = if way == Untouched::Skip { 0.0 } else { 1e-6 };
        tell(found(
            format!("texels without a gradient, \"{name}\""),
            "change only by the configured rule",
            worst(moved),
            bound,
        ));
        let fraction = still.len() as f64 / after.len() as f64;
        tell(found(
            format!("texels without a gradient, \"{name}\""),
            "make up more than 10 % of the parameters",
            if fraction > 0.1 { 0.0 } else { 1.0 },
            0.0,
        ));
    }
    Ok(())
}

/// Checks that a batch without samples changes no parameter and is counted, and that an empty grid is filled by its next refresh.
fn empty<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    let config = small();
    let away = Camera::look_at(
        Intrinsics::from_angle(8, 8, 0.7),
        DVec3::new(5.0, 0.0, 0.0),
        DVec3::new(9.0, 0.0, 0.0),
        DVec3::Z,
    );
    let mut trainer = Trainer::new(make()?, &config, photographs(&[away], 1, hash))?;
    let before = trainer.parameters();
    for _ in 0..6 {
        trainer.step(0.0)?;
    }
    let moved = before.iter().zip(trainer.parameters()).filter(|(a, b)| a.to_bits() != b.to_bits()).count();
    let counted = trainer.checkpoint()?.state.totals.empty_batches;
    [
        found("batches without a sample", "no parameter changes", moved as f64, 0.0),
        found("batches without a sample", "are counted", if counted >= 1 { 0.0 } else { 1.0 }, 0.0),
    ]
    .into_iter()
    .for_each(&mut *tell);

    let views = photographs(&[camera(16, 0), camera(16, 1)], 1, hash);
    let mut trainer = Trainer::new(make()?, &config, views)?;
    for step in 0..9 {
        trainer.step(f64::from(step) / 40.0)?;
    }
    let mut checkpoint = trainer.checkpoint()?;
    for (name, tensor) in &mut checkpoint.file.tensors {
        match &mut tensor.values {
            Values::U8(bits) if name == "occupancy" => bits.fill(0),
            Values::F32(densities) if name == "occupancy.density" => densities.fill(0.0),
            _ => {}
        }
    }
    trainer.restore(&checkpoint)?;
    let kept = trainer.checkpoint()?.state.totals.samples;
    for step in 9..20 {
        trainer.step(f64::from(step) / 40.0)?;
    }
    let after = trainer.checkpoint()?.state.totals;
    let recovers = after.samples > kept && after.empty_batches >= 1;
    tell(found(
        "an emptied occupancy grid",
        "recovers, and the empty batches are counted",
        if recovers { 0.0 } else { 1.0 },
        0.0,
    ));
    Ok(())
}

/// Number of steps of a long run.
const LONG: u64 = 100_000;

/// Checks a run of a hundred thousand steps on a small scene: it learns and does not regress, all numbers stay in
/// range, the schedule ends at its configured values, and memory does not grow.
pub fn long<B: Backend>(make: Make<'_, B>, tell: Tell<'_>) -> Result<()> {
    let mut config = small();
    config.train.steps = LONG;
    config.train.samples_per_step = 256;
    let views = photographs(&[camera(8, 0), camera(8, 1), camera(8, 2)], 2, |i, x, y| hash(i, x / 4, y / 4));
    let mut trainer = Trainer::new(make()?, &config, views)?;
    let (mut strange, mut early, mut late, mut memory, mut rate) = (0.0, 0.0, 0.0, None, 0.0);
    for step in 0..LONG {
        let report = trainer.step(step as f64 / LONG as f64)?;
        strange += not_finite(&[report.loss as f32]);
        match step {
            9_000..10_000 => early += report.loss / 1000.0,
            99_000.. => late += report.loss / 1000.0,
            10_000 => memory = peak_memory(),
            _ => {}
        }
        rate = report.learning_rate;
    }
    strange += not_finite(&trainer.parameters()) + trainer.checkpoint()?.state.totals.non_finite as f64;
    let optimizer = &config.optimizer;
    let written = optimizer.learning_rate * optimizer.decay_factor.powi(optimizer.milestones.len() as i32);
    let case = "100,000 steps on a small scene";
    [
        found(case, "losses and parameters stay finite", strange, 0.0),
        found(case, "the last loss, relative to that after a tenth of the steps", late / early, 1.0),
        found(case, "the learning rate ends as configured", (rate - written).abs() / written, 1e-12),
    ]
    .into_iter()
    .for_each(&mut *tell);
    if let Some((before, after)) = memory.zip(peak_memory()) {
        let growth = (after - before) as f64 / before as f64;
        tell(found(case, "relative growth of memory after a tenth of the steps", growth, 0.02));
    }
    Ok(())
}
