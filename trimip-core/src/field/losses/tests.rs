//! Checks every registered term against its equation: values, and derivatives by central differences.

use super::*;
use crate::geometry::elements::Target;
use crate::{Config, Pixel};

/// Half width of a central difference.
const STEP: f64 = 1e-6;

/// Tolerated error, in f32, of a value or derivative of order 1.
const TOLERANCE: f64 = 2e-6;

fn example(term: &dyn Definition) -> LossConfig {
    let mut config = Config::default();
    term.example(&mut config);
    config.validate().unwrap();
    config.loss
}

fn slope(at: impl Fn(f64) -> f64) -> f64 {
    (at(STEP) - at(-STEP)) / (2.0 * STEP)
}

#[track_caller]
fn assert_close(found: f32, expected: f64, place: &str) {
    assert!(
        (f64::from(found) - expected).abs() < TOLERANCE * expected.abs().max(1.0),
        "{place}: {found}, not {expected}"
    );
}

#[test]
fn names_are_unique_and_examples_put_their_terms_to_work() {
    let mut names: Vec<_> = all().into_iter().map(|term| term.name()).collect();
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), all().len());
    for term in all() {
        assert!(term.weight(&example(term)) > 0.0, "{}", term.name());
    }
}

#[test]
fn one_photometric_term_is_at_work() {
    for kind in Photometric::ALL {
        let config = LossConfig { photometric: *kind, ..Config::default().loss };
        let weights: Vec<_> = Photometric::ALL.iter().map(|other| other.term().weight(&config)).collect();
        assert_eq!(weights.iter().sum::<f32>(), 1.0);
        assert_eq!(kind.term().weight(&config), 1.0);
    }
}

#[test]
fn photometric_terms_are_their_equations() {
    for term in Photometric::ALL.iter().map(|kind| kind.term()) {
        let config = example(term);
        for difference in [-2.0_f32, -0.3, -0.01, 0.0, 1e-4, 0.02, 0.7, 1.5] {
            let (value, derivative) = term.evaluate(&config, difference);
            let at = |by: f64| term.reference(&config, f64::from(difference) + by);
            let place = format!("{} at {difference}", term.name());
            assert_close(value, at(0.0), &place);
            assert_close(derivative, slope(at), &place);
        }
    }
}

#[test]
fn pixel_terms_are_their_equations() {
    let target = Target { rgb: [0.2, 0.7, 0.4], opacity: 0.6, weight: 4.0, ..Target::default() };
    for term in PIXEL_TERMS {
        let config = example(*term);
        for channels in [[0.1_f32, 0.5, 0.9, 0.3], [0.4, 0.4, 0.2, 0.65], [0.9, 0.0, 0.3, 1.0]] {
            let [r, g, b, opacity] = channels;
            let pixel = Pixel { rgb: [r, g, b], opacity, depth: 1.0 };
            let mut gradient = [0.5; 4];
            let value = term.evaluate(&config, &pixel, &target, 3.0, &mut gradient);
            let at = |c: usize, by: f64| {
                let mut channels = channels.map(f64::from);
                channels[c] += by;
                term.reference(&config, channels, &target)
            };
            assert_close(value, at(0, 0.0), term.name());
            for (c, found) in gradient.into_iter().enumerate() {
                assert_close(found, 0.5 + 3.0 * slope(|by| at(c, by)), term.name());
            }
        }
    }
}

#[test]
fn ray_terms_are_their_equations() {
    let target = &Target { weight: 4.0, distance: 2.3, deviation: 0.15, ..Target::default() };
    let sample = |i: u32| {
        let x = f64::from(i);
        let depth = (1.7 * x).sin().powi(2) * 0.5;
        RaySample { depth, t: 2.0 + 0.1 * x, length: 0.1, place: 0.2 + 0.03 * x, width: 0.01 + 0.002 * x }
    };
    for (term, count) in RAY_TERMS.iter().flat_map(|term| [0, 1, 12].map(|count| (term, count))) {
        let config = example(*term);
        let wide: Vec<_> = (0..count).map(sample).collect();
        let narrow = |s: &RaySample<f64>| {
            let [depth, t, length, place, width] =
                [s.depth, s.t, s.length, s.place, s.width].map(|x| x as f32);
            RaySample { depth, t, length, place, width }
        };
        let samples: Vec<_> = wide.iter().map(narrow).collect();
        let mut by_depth = vec![0.0; wide.len()];
        let value = term.evaluate(&config, &ConeSamples { target, samples: &samples }, &mut by_depth);
        let at = |i: usize, by: f64| {
            let mut samples = wide.clone();
            samples.iter_mut().skip(i).take(1).for_each(|sample| sample.depth += by);
            term.reference(&config, &ConeSamples { target, samples: &samples })
        };
        assert_close(value, at(0, 0.0), term.name());
        for (i, found) in by_depth.into_iter().enumerate() {
            assert_close(found, slope(|by| at(i, by)), term.name());
        }
    }
}
