//! Compares a loss term with its equation: the value with the f64 reference, and the derivatives with central differences of the
//! reference. A crate that adds a term calls these functions in its tests.

use super::{ConeSamples, Definition, PhotometricTerm, PixelTerm, RaySample, RayTerm, Target};
use crate::Pixel;
use crate::config::LossConfig;

/// Half width of a central difference.
const STEP: f64 = 1e-6;

/// Largest error of a value or derivative in f32, relative to the larger of its magnitude and 1.
const TOLERANCE: f64 = 2e-6;

/// Compares a photometric term with its equation at differences of both signs, from 0 to 2.
///
/// # Errors
/// Returns the first value or derivative that differs, in words.
pub fn photometric_term(term: &dyn PhotometricTerm, config: &LossConfig) -> Result<(), String> {
    for difference in [-2.0_f32, -0.3, -0.01, 0.0, 1e-4, 0.02, 0.7, 1.5] {
        let (value, derivative) = term.evaluate(config, difference);
        let at = |by: f64| term.reference(config, f64::from(difference) + by);
        close(term, "value", value, at(0.0))?;
        close(term, "derivative", derivative, slope(at))?;
    }
    Ok(())
}

/// Compares a pixel term with its equation at three pixels, for one target.
///
/// # Errors
/// As [`photometric_term`].
pub fn pixel_term(term: &dyn PixelTerm, config: &LossConfig) -> Result<(), String> {
    let target = Target { rgb: [0.2, 0.7, 0.4], opacity: 0.6, weight: 4.0, ..Target::default() };
    for channels in [[0.1_f32, 0.5, 0.9, 0.3], [0.4, 0.4, 0.2, 0.65], [0.9, 0.0, 0.3, 1.0]] {
        let [r, g, b, opacity] = channels;
        let pixel = Pixel { rgb: [r, g, b], opacity, depth: 1.0 };
        // The derivatives are added to what the gradient already holds.
        let mut gradient = [0.5; 4];
        let value = term.evaluate(config, &pixel, &target, 3.0, &mut gradient);
        let at = |c: usize, by: f64| {
            let mut channels = channels.map(f64::from);
            channels[c] += by;
            term.reference(config, channels, &target)
        };
        close(term, "value", value, at(0, 0.0))?;
        for (c, found) in gradient.into_iter().enumerate() {
            close(term, "gradient", found, 0.5 + 3.0 * slope(|by| at(c, by)))?;
        }
    }
    Ok(())
}

/// Compares a ray term with its equation at rays of 0, 1 and 12 samples, for one target.
///
/// # Errors
/// As [`photometric_term`].
pub fn ray_term(term: &dyn RayTerm, config: &LossConfig) -> Result<(), String> {
    let target = &Target { weight: 4.0, distance: 2.3, deviation: 0.15, ..Target::default() };
    let sample = |i: u32| {
        let x = f64::from(i);
        let depth = (1.7 * x).sin().powi(2) * 0.5;
        RaySample { depth, t: 2.0 + 0.1 * x, length: 0.1, place: 0.2 + 0.03 * x, width: 0.01 + 0.002 * x }
    };
    for count in [0, 1, 12] {
        let wide: Vec<_> = (0..count).map(sample).collect();
        let narrow = |s: &RaySample<f64>| {
            let [depth, t, length, place, width] =
                [s.depth, s.t, s.length, s.place, s.width].map(|x| x as f32);
            RaySample { depth, t, length, place, width }
        };
        let samples: Vec<_> = wide.iter().map(narrow).collect();
        let mut by_depth = vec![0.0; wide.len()];
        let value = term.evaluate(config, &ConeSamples { target, samples: &samples }, &mut by_depth);
        let at = |i: usize, by: f64| {
            let mut samples = wide.clone();
            samples.iter_mut().skip(i).take(1).for_each(|sample| sample.depth += by);
            term.reference(config, &ConeSamples { target, samples: &samples })
        };
        close(term, "value", value, at(0, 0.0))?;
        for (i, found) in by_depth.into_iter().enumerate() {
            close(term, "derivative", found, slope(|by| at(i, by)))?;
        }
    }
    Ok(())
}

/// Returns the derivative of `at` at 0.
fn slope(at: impl Fn(f64) -> f64) -> f64 {
    (at(STEP) - at(-STEP)) / (2.0 * STEP)
}

fn close<T: Definition + ?Sized>(term: &T, what: &str, found: f32, expected: f64) -> Result<(), String> {
    let error = (f64::from(found) - expected).abs();
    if error < TOLERANCE * expected.abs().max(1.0) {
        return Ok(());
    }
    Err(format!("{}: the {what} is {found}; the equation gives {expected}", term.name()))
}
