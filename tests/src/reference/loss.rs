//! The loss in f64, from the equations of its registered terms. The equation of a term is part of its definition in core.

use super::contraction;
use super::sample::Sample;
use std::cell::RefCell;
use std::rc::Rc;
use trimip_core::{
    Config,
    config::Contraction,
    engine::batch::{Ray, Target},
    field::losses::{ADJUSTMENTS, ConeSamples, Definition, Held, RaySample, RayTerm, Terms},
};

/// Returns the midpoint and the width of a sample along the ray, in units of the longest side of the box: distance and length in
/// bounded space, ray parameters in contracted space.
pub fn along(config: &Config, ray: &Ray, sample: &Sample) -> [f64; 2] {
    if config.scene.contraction == Contraction::Ball {
        return contraction::along(config, ray, sample);
    }
    let (low, high) = (config.scene.aabb_min.map(f64::from), config.scene.aabb_max.map(f64::from));
    let longest = (0..3).map(|axis| high[axis] - low[axis]).fold(0.0, f64::max);
    [sample.t / longest, sample.length / longest]
}

/// Returns a sample of optical depth `depth` in the form that the ray terms of the loss read.
pub fn ray_sample(config: &Config, ray: &Ray, sample: &Sample, depth: f64) -> RaySample<f64> {
    let [place, width] = along(config, ray, sample);
    RaySample { depth, t: sample.t, length: sample.length, place, width }
}

/// Returns the colour of a pixel [r, g, b, opacity] with the photograph's edge exponent: P·A^γ + (1 − A)·background.
pub fn shown(pixel: [f64; 4], target: &Target) -> [f64; 3] {
    let [rgb @ .., opacity] = pixel;
    let factor = opacity.max(1e-4).powf(target.exponent.into());
    [0, 1, 2].map(|c| {
        let behind = (1.0 - opacity) * f64::from(target.background[c]);
        (rgb[c] - behind) * factor + behind
    })
}

/// Returns the loss of a pixel [r, g, b, opacity] of a photograph with the exposure `gains`, without the weight of the pixel's
/// area.
pub fn of_pixel(config: &Config, pixel: [f64; 4], target: &Target, gains: [f64; 3]) -> f64 {
    let loss = &config.loss;
    let behind = target.background.map(|b| (1.0 - f64::from(target.opacity)) * f64::from(b));
    let mut compared = shown(pixel, target);
    for adjustment in ADJUSTMENTS.iter().filter(|adjustment| adjustment.weight(loss) > 0.0) {
        compared = adjustment.reference(compared, behind, gains);
    }
    let term = loss.photometric.term();
    let channel = |c: usize| term.reference(loss, compared[c] - f64::from(target.rgb[c]));
    let terms = terms(config);
    let others = terms.pixel.iter().map(|term| weight(&**term, config) * term.reference(loss, pixel, target));
    (0..3).map(channel).sum::<f64>() / 3.0 + others.sum::<f64>()
}

/// Returns the ray terms of a pixel: their mean over the pixel's cones, without the weight of the pixel's area. A cone without
/// samples counts as zero.
pub fn of_cones(config: &Config, target: &Target, cones: &[Vec<RaySample<f64>>]) -> f64 {
    let terms = terms(config);
    let at_work = terms.ray.iter().filter(|term| weight(&***term, config) > 0.0);
    let of = |term: &Held<dyn RayTerm>| {
        let cone = |samples: &Vec<_>| term.reference(&config.loss, &ConeSamples { target, samples });
        let seen = cones.iter().filter(|samples| !samples.is_empty());
        weight(&**term, config) * seen.map(cone).sum::<f64>() / cones.len() as f64
    };
    at_work.map(of).sum()
}

/// Returns true if a ray term is enabled.
pub fn has_ray_terms(config: &Config) -> bool {
    terms(config).ray.iter().any(|term| weight(&**term, config) > 0.0)
}

thread_local! {
    /// The last configuration and its terms: reading the sections of other crates takes longer than a pixel.
    static LAST: RefCell<Option<(Config, Rc<Terms>)>> = const { RefCell::new(None) };
}

/// Returns the terms of a configuration.
fn terms(config: &Config) -> Rc<Terms> {
    LAST.with_borrow_mut(|last| match last {
        Some((own, terms)) if own == config => Rc::clone(terms),
        _ => {
            let terms = Rc::new(Terms::of(config).unwrap());
            *last = Some((config.clone(), Rc::clone(&terms)));
            terms
        }
    })
}

fn weight<T: Definition + ?Sized>(term: &T, config: &Config) -> f64 {
    term.weight(&config.loss).into()
}
