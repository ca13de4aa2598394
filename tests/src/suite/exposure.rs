//! Exposure of photographs: the loss of given pixels against its literal equation, and its slopes by log-gains.

use super::Bench;
use super::training::{configuration, steps};
use crate::fixtures::{Draw, lively, noise};
use trimip_core::{
    Backend, Config, Encoder, Field, Layout, Pixel, Result, Session, ViewSet,
    backend::Loss,
    batch::{Deposit, Segment, Target},
    config::Exposure,
    trainer::Trainer,
};

/// Number of photographs.
const PHOTOGRAPHS: usize = 3;

/// Number of pixels: more than one workgroup of a device.
const PIXELS: usize = 150;

/// A configuration whose photographs have gains.
pub fn exposed() -> Config {
    let mut config = configuration();
    config.loss.exposure = Exposure::Gain;
    config.optimizer.exposure_rate = 1e-2;
    config
}

/// A pixel, what it is compared with, and its photograph.
struct Case {
    pixel: [f64; 4],
    target: Target,
    photograph: usize,
}

fn cases() -> Vec<Case> {
    let mut draw = Draw::new(31);
    let case = |_| {
        let mut some = || draw.between(0.05, 0.95) as f32;
        let (pixel, rgb, background) =
            ([0; 4].map(|_| some()), [0; 3].map(|_| some()), [0; 3].map(|_| some()));
        let (opacity, exponent) = (some(), [0.0, 0.4][draw.below(2)]);
        let weight = [0.0, 1.0, 4.0][draw.below(3)];
        Case {
            pixel: pixel.map(f64::from),
            target: Target { rgb, weight, background, opacity, exponent },
            photograph: draw.below(PHOTOGRAPHS),
        }
    };
    (0..PIXELS).map(case).collect()
}

/// The sum over pixels, as written: weight times the mean over channels of smooth-L1, of g·(C − (1 − α)·b) + (1 − α)·b
/// against the photograph, where C = P·A^γ + (1 − A)·b is the colour rendered.
fn literal(config: &Config, cases: &[Case], log_gains: &[[f64; 3]]) -> f64 {
    let beta = f64::from(config.loss.beta);
    let of = |case: &Case| {
        let [rgb @ .., opacity] = case.pixel;
        let (target, exponent) = (&case.target, f64::from(case.target.exponent));
        let channel = |c: usize| {
            let background = f64::from(target.background[c]);
            let premultiplied = rgb[c] - (1.0 - opacity) * background;
            let shown = premultiplied * opacity.powf(exponent) + (1.0 - opacity) * background;
            let behind = (1.0 - f64::from(target.opacity)) * background;
            let gain = log_gains[case.photograph][c].exp();
            let d = (gain * (shown - behind) + behind - f64::from(target.rgb[c])).abs();
            if d < beta { 0.5 * d * d / beta } else { d - 0.5 * beta }
        };
        f64::from(target.weight) * (0..3).map(channel).sum::<f64>() / 3.0
    };
    cases.iter().map(of).sum()
}

/// Loss, gradients of pixels and derivatives by log-gains are those of the literal equation.
///
/// # Errors
/// When the backend refuses the configuration.
pub fn finite_differences<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    for beta in [1.0, 0.1] {
        let mut config = exposed();
        config.loss.beta = beta;
        let parameters = lively(&Layout::new(&config), 1);
        let views = noise(PHOTOGRAPHS, 16, 1, 2);
        let mut bench = Bench::new(make(), &config, Some(views), &parameters)?;
        let cases = cases();
        let gains = [[1.3_f32, 0.7, 1.0], [0.4, 2.5, 1.1], [0.9, 1.6, 0.6]];
        let log_gains = gains.map(|gain| gain.map(|gain| f64::from(gain).ln()));
        let Bench { backend, stages, space, .. } = &mut bench;
        let segments: Vec<_> = (0..PIXELS as u32).map(|start| Segment { start, count: 1 }).collect();
        let pixel = |case: &Case| {
            let [r, g, b, opacity] = case.pixel.map(|value| value as f32);
            Pixel { rgb: [r, g, b], opacity, ..Pixel::default() }
        };
        backend.write(&mut space.rays.targets, &cases.iter().map(|case| case.target).collect::<Vec<_>>());
        backend.write(&mut space.rays.groups, &segments);
        backend.write(&mut space.samples.segments, &segments);
        let photographs: Vec<_> = cases.iter().map(|case| case.photograph as u32).collect();
        backend.write(&mut space.rays.photographs, &photographs);
        backend.write(&mut space.pixels, &cases.iter().map(pixel).collect::<Vec<_>>());
        let (field, encoder) = (stages.field.gradient(), stages.encoder.gradient());
        let mut deposit = Deposit { field, encoder, sums: B::Sums::default() };
        stages.loss.expose(&gains);
        // What an earlier step left must not count again.
        for _ in 0..2 {
            deposit.sums = B::Sums::default();
            stages.loss.evaluate(
                &mut space.lane,
                &space.rays,
                &space.samples,
                &space.pixels,
                &mut space.pixel_gradients,
                &mut deposit.sums,
            );
        }
        let result = backend.redeem(backend.post(&[deposit]))?;
        let loss = literal(&config, &cases, &log_gains);
        assert!((result.sums.loss - loss).abs() < 1e-5 * loss, "loss {}, not {loss}", result.sums.loss);
        let h = 1e-5;
        assert_eq!(result.exposures.len(), PHOTOGRAPHS);
        for photograph in 0..PHOTOGRAPHS {
            for c in 0..3 {
                let at = |by: f64| {
                    let mut moved = log_gains;
                    moved[photograph][c] += by;
                    literal(&config, &cases, &moved)
                };
                let (found, slope) = (result.exposures[photograph][c], (at(h) - at(-h)) / (2.0 * h));
                assert!((found - slope).abs() < 1e-5 * loss, "{photograph}, {c}: {found}, not {slope}");
            }
        }
        let found = backend.read(&space.pixel_gradients);
        for (i, found) in found.iter().enumerate() {
            for c in 0..4 {
                let at = |by: f64| {
                    let Case { mut pixel, target, photograph } = cases[i];
                    pixel[c] += by;
                    literal(&config, &[Case { pixel, target, photograph }], &log_gains)
                };
                let slope = (at(h) - at(-h)) / (2.0 * h);
                assert!((f64::from(found[c]) - slope).abs() < 2e-5, "{i}, {c}: {}, not {slope}", found[c]);
            }
        }
    }
    Ok(())
}

/// The gradient of a whole step by the log-gains is the slope of its loss, also where views of several scales belong to one
/// photograph, and through the mean that is subtracted.
///
/// # Errors
/// When a step fails.
pub fn whole_step<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let config = exposed();
    let mut trainer = Trainer::new(make(), &config, noise(PHOTOGRAPHS, 16, 2, 3))?;
    trainer.set_parameters(&lively(&Layout::new(&config), 13));
    trainer.occupy_all();
    let values = [[0.25_f32, -0.5, 0.0], [0.75, 0.125, -0.25], [-0.25, 0.5, 1.0]];
    trainer.set_log_gains(&values);
    let (_, gradient) = trainer.loss_and_exposure_gradient(0, PIXELS as u32)?;
    assert_eq!(gradient.len(), PHOTOGRAPHS);
    let most = gradient.as_flattened().iter().fold(0.0_f32, |most, g| most.max(g.abs()));
    assert!(most > 1e-3, "{gradient:?}");
    // A difference of fourth order: a device adds its losses in f32, so steps are long.
    let h = 1.0 / 16.0;
    for (photograph, c) in (0..PHOTOGRAPHS).flat_map(|photograph| [0, 1, 2].map(|c| (photograph, c))) {
        let mut at = |by: f32| -> Result<f64> {
            let mut moved = values;
            moved[photograph][c] += by;
            trainer.set_log_gains(&moved);
            let (sums, _) = trainer.loss_and_gradient(0, PIXELS as u32)?;
            Ok(sums.loss / sums.weight)
        };
        let (near, far) = (at(h)? - at(-h)?, at(2.0 * h)? - at(-2.0 * h)?);
        let (found, slope) = (f64::from(gradient[photograph][c]), (8.0 * near - far) / f64::from(12.0 * h));
        assert!((found - slope).abs() < 1e-3 * f64::from(most), "{photograph}, {c}: {found}, not {slope}");
    }
    Ok(())
}

/// Opaque photographs: what they show has no background of its own.
fn opaque() -> ViewSet {
    let mut views = noise(3, 16, 2, 2);
    views.pixels.iter_mut().for_each(|pixel| pixel[3] = 255);
    views
}

/// Gains that stay 1 change no bit of a run, gains that move do, and no model holds them.
///
/// # Errors
/// When a step fails.
pub fn beside_the_model<B: Backend>(make: impl Fn() -> B) -> Result<()> {
    let run = |exposure: Exposure, rate: f64| {
        let mut config = exposed();
        (config.loss.exposure, config.optimizer.exposure_rate) = (exposure, rate);
        let mut trainer = Trainer::new(make(), &config, opaque())?;
        steps(&mut trainer, &config, 12)?;
        let parameters: Vec<u32> = trainer.parameters().into_iter().map(f32::to_bits).collect();
        Ok((parameters, trainer.checkpoint()?, trainer.log_gains()))
    };
    let (plain, without, none) = run(Exposure::None, 1e-2)?;
    let (still, with, zero) = run(Exposure::Gain, 0.0)?;
    let (moved, _, gains) = run(Exposure::Gain, 1e-2)?;
    assert!(plain == still, "gains of 1 change bits");
    assert!(plain != moved, "gains that move change nothing");
    assert!(none.is_empty() && zero == [[0.0; 3]; 3] && gains.as_flattened().iter().any(|e| e.abs() > 1e-3));
    assert!(without.file.tensors.keys().all(|name| !name.starts_with("exposure")));
    assert!(with.file.tensors.keys().any(|name| name.starts_with("exposure")));
    let names = |file: trimip_core::tensors::TensorFile| file.tensors.into_keys().collect::<Vec<_>>();
    assert_eq!(names(with.into_model().file), names(without.into_model().file));
    Ok(())
}
