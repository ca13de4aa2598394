//! Gradients of the whole step against central differences of the literal loss: every slot, through every level.

use super::{Bench, wide};
use crate::{
    fixtures::{Draw, lively, noise, small},
    reference::{Reference, Sample, kept},
};
use trimip_core::schedule::Schedule;
use trimip_core::{
    Backend, Config, Layout, Renderer, Result,
    backend::Sampler,
    batch::{Ray, Target},
    config::{LevelFormula, LossRays, Precision, TrainBackground},
    params::Kind,
    trainer::Trainer,
};

/// Error of an entry, relative to the root mean square of its slot's checked entries (and to itself where it is larger).
/// Each of some 600 samples' terms is rounded to about 1e-6 and the roundings cancel in part; the rest is room for
/// another device's exp and log. A wrong factor anywhere is far above.
const GRADIENT_TOLERANCE: f64 = 5e-5;

/// Half width of a central difference: its own error is h² of the third derivative and 1e-16/h of rounding.
const STEP: f64 = 1e-5;

/// Rays of the step.
const RAYS: u32 = 48;

/// The step whose rays and jitter are used.
const TRAINING_STEP: u64 = 7;

fn configurations() -> Vec<(&'static str, Config)> {
    let change = |name, change: &dyn Fn(&mut Config)| {
        let mut config = small();
        change(&mut config);
        (name, config)
    };
    vec![
        change("paper", &|_| {}),
        change("code", &|c| {
            c.encoder.level = LevelFormula::Code;
            (c.field.density_layers, c.field.color_layers) = (2, 4);
        }),
        change("no mipmap", &|c| c.encoder.mipmap = false),
        change("linear loss over all rays", &|c| {
            (c.loss.beta, c.loss.rays) = (0.05, LossRays::All);
        }),
        change("random backgrounds, long steps, steps of 40 radii", &|c| {
            c.train.background = TrainBackground::Random;
            c.renderer.step_scale = Schedule::new(vec![[0.0, 1.5]]);
            c.renderer.step_per_radius = 40.0;
        }),
        change("opacity beside colour", &|c| c.loss.opacity = 0.7),
        change("pruned", &|c| c.renderer.min_transmittance = 0.3),
    ]
}

/// Rays of the step with the samples that are kept at the reference's densities.
struct Batch {
    rays: Vec<(Ray, Target, Vec<Sample>)>,
    marched: usize,
    kept: usize,
    /// Rays where rounding may decide otherwise about a sample.
    doubtful: usize,
}

fn batch<B: Backend>(bench: &mut Bench<B>, config: &Config, reference: &Reference) -> Batch {
    let Bench { backend, stages, space, .. } = bench;
    stages.sampler.training_rays(&mut space.lane, TRAINING_STEP, RAYS, 0..RAYS, &mut space.rays);
    let (lane, jitter) = (&mut space.lane, Some(TRAINING_STEP));
    stages.renderer.march(lane, &space.rays, &stages.occupancy, jitter, &mut space.samples);
    let (rays, targets) = (backend.read(&space.rays.rays), backend.read(&space.rays.targets));
    let segments = backend.read(&space.samples.segments);
    let (intervals, spheres) = (backend.read(&space.samples.intervals), backend.read(&space.samples.spheres));
    let mut result = Batch { rays: vec![], marched: 0, kept: 0, doubtful: 0 };
    for (i, segment) in segments.iter().enumerate() {
        let mut samples: Vec<Sample> = (segment.start as usize..(segment.start + segment.count) as usize)
            .map(|i| Sample {
                t: intervals[i].t.into(),
                length: intervals[i].length.into(),
                position: spheres[i].position.map(f64::from),
                radius: spheres[i].radius.into(),
            })
            .collect();
        result.marched += samples.len();
        let (count, margin) = kept(config, &samples, &reference.densities(&samples));
        samples.truncate(count);
        result.kept += count;
        result.doubtful += usize::from(margin < 1e-4);
        result.rays.push((rays[i], targets[i], samples));
    }
    result
}

/// Entries of a slot to differentiate: texels that have a gradient, and for layers any; a few that may have none.
fn entries(gradient: &[f32], kind: Kind, draw: &mut Draw) -> Vec<usize> {
    let mut chosen: Vec<usize> = (0..4).map(|_| draw.below(gradient.len())).collect();
    let live: Vec<usize> = (0..gradient.len()).filter(|&i| gradient[i] != 0.0).collect();
    assert!(!live.is_empty(), "a slot without any gradient");
    let more = if kind == Kind::Planes { 24 } else { 8 };
    chosen.extend((0..more).map(|_| live[draw.below(live.len())]));
    chosen
}

/// Central difference of a loss around 0. Where the slopes to the left and to the right differ, a ReLU switches in
/// between: a smaller step leaves the switch outside.
fn difference(at: &mut dyn FnMut(f64) -> f64) -> f64 {
    let here = at(0.0);
    let mut central = 0.0;
    for step in [STEP, STEP / 16.0, STEP / 256.0] {
        let (left, right) = ((here - at(-step)) / step, (at(step) - here) / step);
        central = 0.5 * (left + right);
        if (right - left).abs() <= GRADIENT_TOLERANCE * central.abs() {
            break;
        }
    }
    central
}

/// Every slot's gradient, and the loss itself.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn finite_differences<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for (name, config) in configurations() {
        let views = noise(3, 24, 3, 21);
        let layout = Layout::new(&config);
        let parameters = lively(&layout, 13);
        let mut bench = Bench::new(make(), &config, Some(views.clone()), &parameters)?;
        let mut values = wide(&parameters);
        let reference = Reference::new(&config, &layout, &values);
        let batch = batch(&mut bench, &config, &reference);
        assert!(batch.rays.iter().any(|ray| ray.2.is_empty()), "{name}: some rays miss the box");
        assert_eq!(batch.kept < batch.marched, name == "pruned", "{name}");

        let mut trainer = Trainer::new(make(), &config, views)?;
        trainer.set_parameters(&parameters);
        trainer.occupy_all();
        let (sums, gradient) = trainer.loss_and_gradient(TRAINING_STEP, RAYS)?;
        assert_eq!(sums.rays, u64::from(RAYS), "{name}");
        // A backend that sees front to back asks fewer samples, never fewer than it keeps.
        assert!((sums.kept..=batch.marched as u64).contains(&sums.marched), "{name}: samples marched");
        assert!(sums.kept.abs_diff(batch.kept as u64) <= batch.doubtful as u64, "{name}: samples kept");
        let loss = reference.loss(&batch.rays);
        assert!((sums.loss / sums.weight - loss).abs() < 1e-4 * loss, "{name}: loss, not {loss}");

        let mut draw = Draw::new(17);
        for slot in &layout.slots {
            let part = &gradient[slot.range.clone()];
            let chosen = entries(part, slot.kind, &mut draw);
            let differences: Vec<f64> = chosen
                .iter()
                .map(|&i| {
                    let i = slot.range.start + i;
                    let mut at = |shift: f64| {
                        let before = values[i];
                        values[i] = before + shift;
                        let loss = Reference::new(&config, &layout, &values).loss(&batch.rays);
                        values[i] = before;
                        loss
                    };
                    difference(&mut at)
                })
                .collect();
            let size = (differences.iter().map(|d| d * d).sum::<f64>() / differences.len() as f64).sqrt();
            for (&i, &expected) in chosen.iter().zip(&differences) {
                let found = f64::from(part[i]);
                assert!(
                    (found - expected).abs() <= GRADIENT_TOLERANCE * size.max(expected.abs()),
                    "{name}: {}[{i}] is {found}, not {expected} (the slot's size is {size})",
                    slot.name
                );
            }
        }
    }
    Ok(())
}

/// Rounding the factors of the layers' products to `bits` bits moves loss and gradients a little, and does move them. The
/// last layer's gradient is off by roundings alone. Behind a ReLU a unit near zero may switch, and then its whole part of
/// the gradient comes or goes: as many units as a rounding is wide, and an error of the square root of that.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn rounded<B: Backend>(make: impl Fn() -> B, precision: Precision, bits: i32) -> Result<()> {
    let rounding = 2_f64.powi(-bits);
    let views = noise(3, 24, 3, 21);
    let mut config = small();
    let layout = Layout::new(&config);
    let mut at = |precision| {
        config.field.precision = precision;
        let mut trainer = Trainer::new(make(), &config, views.clone())?;
        trainer.set_parameters(&lively(&layout, 13));
        trainer.occupy_all();
        trainer.loss_and_gradient(TRAINING_STEP, RAYS)
    };
    let ((expected, exact), (found, rounded)) = (at(Precision::F32)?, at(precision)?);
    let (expected, found) = (expected.loss / expected.weight, found.loss / found.weight);
    assert!((found - expected).abs() < rounding * expected, "loss {found}, not {expected}");
    for slot in &layout.slots {
        let pairs = || exact[slot.range.clone()].iter().zip(&rounded[slot.range.clone()]);
        let square = |x: f64| x * x;
        let distance: f64 = pairs().map(|(a, b)| square(f64::from(a - b))).sum();
        let size: f64 = pairs().map(|(a, _)| square(f64::from(*a))).sum();
        let error = (distance / size).sqrt();
        println!("{}: off by {error}", slot.name);
        let last = slot.name == format!("color.{}.weight", config.field.color_layers);
        let tolerance = if last { 4.0 * rounding } else { 2.0 * rounding.sqrt() };
        assert!((0.1 * rounding..tolerance).contains(&error), "{}: off by {error}", slot.name);
    }
    Ok(())
}
