//! Checks every registered term against its equation: values, and derivatives by central differences.

use super::*;
use crate::{Config, Pixel};

fn example(term: &dyn Definition) -> LossConfig {
    let mut config = Config::default();
    term.example(&mut config);
    config.validate().unwrap();
    config.loss
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
fn terms_are_their_equations() {
    for term in Photometric::ALL.iter().map(|kind| kind.term()) {
        verify::photometric_term(term, &example(term)).unwrap();
    }
    for term in PIXEL_TERMS {
        verify::pixel_term(*term, &example(*term)).unwrap();
    }
    for term in RAY_TERMS {
        verify::ray_term(*term, &example(*term)).unwrap();
    }
}

/// The opacity term with a wrong value or a wrong gradient.
struct Wrong {
    value: f32,
    gradient: f32,
}

impl Definition for Wrong {
    fn name(&self) -> &'static str {
        "wrong"
    }

    fn weight(&self, _: &LossConfig) -> f32 {
        1.0
    }
}

impl PixelTerm for Wrong {
    fn evaluate(
        &self,
        config: &LossConfig,
        pixel: &Pixel,
        target: &Target,
        factor: f32,
        gradient: &mut [f32; 4],
    ) -> f32 {
        let value = opacity::Opacity.evaluate(config, pixel, target, factor, gradient);
        gradient[3] *= self.gradient;
        value * self.value
    }

    fn reference(&self, config: &LossConfig, pixel: [f64; 4], target: &Target) -> f64 {
        opacity::Opacity.reference(config, pixel, target)
    }
}

#[test]
fn a_wrong_value_and_a_wrong_gradient_are_found() {
    let config = Config::default().loss;
    verify::pixel_term(&Wrong { value: 1.0, gradient: 1.0 }, &config).unwrap();
    let value = verify::pixel_term(&Wrong { value: 1.1, gradient: 1.0 }, &config).unwrap_err();
    assert!(value.starts_with("wrong: the value is "), "{value}");
    let gradient = verify::pixel_term(&Wrong { value: 1.0, gradient: 1.001 }, &config).unwrap_err();
    assert!(gradient.starts_with("wrong: the gradient is "), "{gradient}");
}
