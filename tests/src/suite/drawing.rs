//! Tests of steps that draw samples by the size of their gradients: which samples are drawn, how their gradients are scaled, the
//! expectation of a whole step's gradient, and runs that draw samples.

use super::{Bench, training};
use crate::fixtures::{TestRandom, every_encoder, lively, nerf_networks, noise, small};
use trimip_core::config::schedule::Schedule;
use trimip_core::{
    Backend, Config, Encoder, Field, Layout, Renderer, Result, Session,
    config::{Contraction, DensityFunction, EncoderKind},
    engine::{
        batch::{FieldDraw, Interval, PartialGradients, Radiance, Ray, SampleDraw, Sphere, Tile, Workspace},
        policy::FieldPolicy,
        trainer::Trainer,
    },
    math::rng::{Random, Sequence},
};

/// Number of rays of a step.
const RAYS: u32 = 96;

/// Returns the largest accepted deviation of a mean of `values` values from its expectation, in standard deviations estimated from these
/// values: the bound of Student's t that one of 10⁶ means exceeds.
fn largest_deviation(values: u64) -> f64 {
    if values < 100 { 8.0 } else { 5.3 }
}

/// Error of sums in f32, relative to the sum of the gradient's absolute values.
const ROUNDING: f64 = 2e-6;

fn configurations() -> Vec<Config> {
    let change = |change: &dyn Fn(&mut Config)| {
        let mut config = small();
        change(&mut config);
        config
    };
    let mut all = every_encoder();
    let mut nerf = nerf_networks();
    // With NeRF's own density function most of these samples would have no density, and no gradient.
    nerf.field.density = DensityFunction::Softplus;
    all.push(nerf);
    all.push(change(&|config| config.renderer.color_weight = Schedule::new(vec![[0.0, 0.02]])));
    all.push(change(&|config| config.field.geometry_frequencies = 2));
    all.push(change(&|config| config.renderer.cones = 2));
    all.push(change(&|config| {
        config.scene.contraction = Contraction::Ball;
        config.loss.distortion = 0.1;
    }));
    all
}

/// In every slot, the mean gradient over `draws` draws (at least 20) is the gradient of all samples. The two are compared along random
/// directions, in units of the standard deviation of the mean. With a threshold below the gradient norm of every sample, drawing changes
/// no bit.
///
/// # Errors
/// When a step fails.
pub fn unbiased<B: Backend>(make: impl Fn() -> B, draws: u64) -> Result<()> {
    for config in configurations() {
        let layout = Layout::new(&config);
        let mut trainer = Trainer::new(make(), &config, noise(3, 16, 2, 2))?;
        trainer.set_parameters(&lively(&layout, 5));
        trainer.occupy_all();
        let (sums, whole) = trainer.loss_and_gradient(3, RAYS)?;
        let (all, same) = trainer.loss_and_drawn_gradient(3, RAYS, 1e-30, 0)?;
        // Colours and densities of voxels are clamped, and a clamped sample without any gradient is not drawn.
        assert!(all.drawn == sums.kept || config.encoder.kind == EncoderKind::Voxels, "{all:?}");
        let size: f64 = whole.iter().map(|g| f64::from(g.abs())).sum();
        for (found, expected) in same.iter().zip(&whole) {
            let close = f64::from((found - expected).abs()) <= ROUNDING * size;
            assert!(if all.drawn == sums.kept { found.to_bits() == expected.to_bits() } else { close });
        }
        // Finds a threshold at which about a third of the samples is drawn, by bisection of its exponent.
        let [mut low, mut high] = [-9.0_f64, 3.0];
        let threshold = loop {
            let threshold = 10_f64.powf((low + high) / 2.0);
            match trainer.loss_and_drawn_gradient(3, RAYS, threshold, 0)?.0.drawn {
                drawn if drawn * 20 > all.drawn * 8 => low = (low + high) / 2.0,
                drawn if drawn * 4 < all.drawn => high = (low + high) / 2.0,
                _ => break threshold,
            }
        };
        let mut random = TestRandom::new(9);
        let directions: Vec<Vec<f64>> = (0..4)
            .map(|_| whole.iter().map(|_| if random.below(2) == 0 { 1.0 } else { -1.0 }).collect())
            .collect();
        let along = |gradient: &[f32]| -> Vec<f64> {
            let dot = |direction: &Vec<f64>, range: &std::ops::Range<usize>| -> f64 {
                range.clone().map(|i| direction[i] * f64::from(gradient[i])).sum()
            };
            let slots = layout.slots.iter().map(|slot| &slot.range);
            slots.flat_map(|range| directions.iter().map(move |direction| dot(direction, range))).collect()
        };
        let expected = along(&whole);
        let (mut mean, mut squares) = (vec![0.0; expected.len()], vec![0.0; expected.len()]);
        for draw in 0..draws {
            let (found, gradient) = trainer.loss_and_drawn_gradient(3, RAYS, threshold, draw)?;
            assert!(found.drawn < all.drawn / 2 && found.drawn > all.drawn / 5, "{found:?}");
            assert_eq!((found.loss, found.kept), (sums.loss, sums.kept), "the loss is of all samples");
            for ((mean, squares), value) in mean.iter_mut().zip(&mut squares).zip(along(&gradient)) {
                *mean += value / draws as f64;
                *squares += value * value / draws as f64;
            }
        }
        for ((mean, squares), expected) in mean.iter().zip(&squares).zip(&expected) {
            let deviation = ((squares - mean * mean).max(0.0) / draws as f64).sqrt();
            assert!(
                (mean - expected).abs() <= largest_deviation(draws) * deviation + ROUNDING * size,
                "{:?}: the mean of {draws} draws is {mean} ± {deviation}, not {expected}",
                config.encoder.kind
            );
        }
        assert!(squares.iter().zip(&mean).any(|(squares, mean)| squares - mean * mean > 1e-6 * squares));
    }
    Ok(())
}

/// The drawn samples and their gradients follow the equations, and the kept rows are those of the drawn samples.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn as_written<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = small();
    let parameters = lively(&Layout::new(&config), 8);
    let mut bench = Bench::new(make(), &config, None, &parameters)?;
    let mut random = TestRandom::new(4);
    let (rays, each) = (70, 5);
    let ray = Ray { direction: [0.0, 0.0, 1.0], cosine: 1.0, ..Ray::default() };
    let spheres: Vec<Sphere> = (0..rays * each)
        .map(|_| Sphere { position: std::array::from_fn(|_| random.between(0.1, 0.9) as f32), radius: 0.01 })
        .collect();
    bench.place_on(&vec![ray; rays], &vec![Interval { t: 1.0, length: 0.1 }; spheres.len()], &spheres);
    bench.workspace.rays.first = 1000;
    let Bench { backend, stages, workspace, parameters } = &mut bench;
    backend.install(|| stages.density(parameters, workspace));
    let draw = SampleDraw { draws: Random::new(config.seed).at(Sequence::Sample, 6), threshold: 0.3 };
    let policy = FieldPolicy::new(&config);
    let densities = backend.read(&workspace.radiance);
    let radiance: Vec<Radiance> = densities
        .iter()
        .map(|own| Radiance { rgb: std::array::from_fn(|_| random.between(0.05, 0.95) as f32), ..*own })
        .collect();
    let gradients: Vec<Radiance> = radiance
        .iter()
        .map(|_| Radiance {
            rgb: std::array::from_fn(|_| random.between(-1.0, 1.0) as f32),
            density: random.between(-0.5, 0.5) as f32,
        })
        .collect();
    let mut partial = PartialGradients::<B> {
        field: stages.field.gradient(),
        encoder: stages.encoder.gradient(),
        sums: B::Sums::default(),
    };
    let (mut marks, mut drawn) = (backend.zeros(0), backend.zeros(0));
    let (mut values, mut by_values) = (backend.zeros(0), backend.zeros(0));
    backend.write(&mut values, &radiance);
    backend.write(&mut by_values, &gradients);
    backend.install(|| {
        let Workspace { stream, rays, samples, field_context, .. } = workspace;
        let tile = &mut Tile { stream, parameters, rays, samples };
        let arrays = FieldDraw { radiance: &values, radiance_gradients: &mut by_values, marks: &mut marks };
        stages.field.draw(tile, &draw, field_context, arrays);
        stages.renderer.keep_drawn(stream, &marks, samples, &mut drawn, &mut partial.sums);
    });
    // The rule for drawing, written literally in f64.
    let mut expected = Vec::new();
    let mut doubtful = 0;
    for ray in 0..rays {
        let mut sum = f64::from(draw.first(1000 + ray as u32));
        for row in ray * each..(ray + 1) * each {
            let (value, by) = (&radiance[row], &gradients[row]);
            // The density is exp(logit − shift), so its derivative with respect to the logit is the density itself.
            let by_logit = f64::from(by.density) * f64::from(value.density);
            let by_colors = [0, 1, 2].map(|c| {
                let value = f64::from(value.rgb[c]);
                f64::from(by.rgb[c]) * value * (1.0 - value)
            });
            let norm = (by_logit * by_logit + by_colors.iter().map(|by| by * by).sum::<f64>()).sqrt();
            let probability = (norm / f64::from(draw.threshold)).min(1.0);
            sum += probability;
            doubtful += usize::from((sum - 1.0).abs() < 1e-4);
            if sum >= 1.0 {
                sum -= 1.0;
                expected.push((row as u32, probability));
            }
        }
    }
    assert_eq!(doubtful, 0, "choose another seed: rounding decides");
    assert!(expected.len() > rays && expected.len() < rays * each * 9 / 10, "{} drawn", expected.len());
    assert!(policy.density.layers.len() > 1, "there are networks");
    let rows: Vec<u32> = expected.iter().map(|(row, _)| *row).collect();
    assert_eq!(backend.read(&drawn), rows);
    let by_values = backend.read(&by_values);
    for (row, probability) in &expected {
        let (found, given) = (&by_values[*row as usize], &gradients[*row as usize]);
        let pairs = found.rgb.iter().zip(given.rgb).chain([(&found.density, given.density)]);
        for (found, given) in pairs {
            let scaled = f64::from(given) / probability;
            assert!((f64::from(*found) - scaled).abs() <= 1e-5 * scaled.abs(), "{found}, not {scaled}");
        }
    }
    let segments = backend.read(&workspace.samples.segments);
    let mut start = 0;
    for (ray, segment) in segments.iter().enumerate() {
        let count = rows.iter().filter(|row| **row as usize / each == ray).count() as u32;
        assert_eq!((segment.start, segment.count), (start, count), "ray {ray}");
        start += count;
    }
    let kept = backend.read(&workspace.samples.spheres);
    assert!(rows.iter().map(|row| spheres[*row as usize]).eq(kept.iter().copied()));
    Ok(())
}

/// A run draws all samples until its schedule begins, and then the scheduled fraction of them, to within 10 %.
///
/// # Errors
/// When a step fails.
pub fn fraction<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let mut config = training::configuration();
    config.train.steps = 400;
    config.train.backward_fraction = Schedule::new(vec![[0.0, 1.0], [0.25, 0.4]]);
    let mut trainer = Trainer::new(make(), &config, noise(3, 16, 2, 2))?;
    training::steps(&mut trainer, &config, 100)?;
    assert_eq!(trainer.checkpoint()?.state.draw_threshold, 0.0, "all samples count at first");
    training::steps(&mut trainer, &config, 200)?;
    let threshold = trainer.checkpoint()?.state.draw_threshold;
    let (sums, _) = trainer.loss_and_drawn_gradient(300, 600, threshold, 300)?;
    let found = sums.drawn as f64 / sums.kept as f64;
    assert!((found - 0.4).abs() < 0.04, "{found} of the samples");
    Ok(())
}
