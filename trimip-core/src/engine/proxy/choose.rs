//! Chooses the positions along a ray at which the model is evaluated, from the densities that the proxy predicts along
//! the ray, and then the samples that share a colour. Symbols are those of [`compositing`](crate::math::compositing).
//!
//! The ray is divided into steps. A step whose predicted weight is less than [`Rule::least`] is left out; its optical
//! depth is added to the next sample, or to the last sample of the ray. If the weights of left-out steps add up to
//! [`Rule::least`], the heaviest of these steps becomes a sample, so that a ray loses less than this weight. The model
//! evaluates the samples. Neighbouring samples whose total weight is at most [`Rule::shared_weight`] share one colour,
//! that of the weighted mean of their geometry features.

use crate::math::compositing::weight;
use std::ops::Range;

/// Optical depth of everything behind the end of an opaque ray. It is added to the ray's last sample.
pub const BEHIND: f32 = 6.0;

/// The rule by which samples are chosen.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Rule {
    /// Least predicted weight of a sample.
    pub least: f32,
    /// Predicted transmittance at which a ray ends.
    pub opaque: f32,
    /// Largest total weight of samples that share a colour.
    pub shared_weight: f32,
    /// Largest distance between samples that share a colour, in world units.
    pub reach: f32,
}

/// A sample that was chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Chosen {
    /// Distance along the ray, whose direction is a unit vector.
    pub t: f32,
    /// Predicted optical depth of the sample's own step. `depth` is the predicted optical depth of all steps that the
    /// sample represents.
    pub(super) own: f32,
    pub(super) depth: f32,
}

impl Chosen {
    /// Returns the length of the sample, for steps of length `step`. It is at most the total length of the steps that
    /// the sample represents, because its own step is the thickest of them; the last sample of an opaque ray may be
    /// longer.
    #[inline(always)]
    pub fn length(&self, step: f32) -> f32 {
        step * (self.depth / self.own)
    }
}

/// Chooses the samples of one ray, whose steps arrive front to back.
#[derive(Clone, Copy, Debug)]
pub struct Chooser {
    rule: Rule,
    transmittance: f32,
    /// Total weight of the steps that were left out since the last sample.
    light: f32,
    /// The thickest of these steps, with the optical depth of all of them.
    lent: Chosen,
    /// The last sample; it is emitted when the next one is known.
    held: Option<Chosen>,
}

/// Picks the samples of one ray. The steps that have a density arrive front to back.
pub trait Pick {
    /// Adds a step around `t`, with the predicted optical depth `depth` and opacity `alpha`. Returns true if the ray
    /// ends there.
    fn step(&mut self, t: f32, depth: f32, alpha: f32, choose: &mut impl FnMut(Chosen)) -> bool;

    /// Ends the ray.
    fn end(self, choose: &mut impl FnMut(Chosen));
}

impl Chooser {
    /// Creates the state at the start of a ray.
    #[inline(always)]
    pub fn new(rule: Rule) -> Self {
        Self { rule, transmittance: 1.0, light: 0.0, lent: Chosen::default(), held: None }
    }
}

impl Pick for Chooser {
    #[inline(always)]
    fn step(&mut self, t: f32, depth: f32, alpha: f32, choose: &mut impl FnMut(Chosen)) -> bool {
        let weight = self.transmittance * alpha;
        self.transmittance -= weight;
        self.light += weight;
        let all = self.lent.depth + depth;
        // In fog, transmittance hardly changes, so the thickest step is also the heaviest.
        let best = if depth > self.lent.own {
            Chosen { t, own: depth, depth: all }
        } else {
            Chosen { depth: all, ..self.lent }
        };
        if self.light < self.rule.least {
            self.lent = best;
        } else {
            if let Some(held) = self.held {
                choose(held);
            }
            self.held = Some(best);
            (self.light, self.lent) = (0.0, Chosen::default());
        }
        self.transmittance < self.rule.opaque
    }

    #[inline(always)]
    fn end(self, choose: &mut impl FnMut(Chosen)) {
        let behind = if self.transmittance < self.rule.opaque { BEHIND } else { 0.0 };
        if let Some(held) = self.held {
            choose(Chosen { depth: held.depth + self.lent.depth + behind, ..held });
        }
    }
}

/// An evaluated sample of a ray.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shaded {
    /// Distance along the ray, whose direction is a unit vector.
    pub t: f32,
    /// Optical depth.
    pub depth: f32,
    /// Weight T·α.
    pub weight: f32,
}

/// Groups the samples of a ray that share a colour, given their distances and optical depths front to back. Sets the
/// weights of all samples; `group` receives the range and the samples of each group.
pub fn share_colors(rule: &Rule, samples: &mut [Shaded], mut group: impl FnMut(Range<usize>, &[Shaded])) {
    let mut before = 0.0_f32;
    for sample in samples.iter_mut() {
        sample.weight = weight((-before).exp(), sample.depth).0;
        before += sample.depth;
    }
    let mut start = 0;
    while let Some(first) = samples.get(start) {
        let mut sum = first.weight;
        let mut end = start + 1;
        while let Some(next) = samples.get(end) {
            // The comparison is false for NaN, so a sample with NaN forms a group of its own.
            if !(sum + next.weight <= rule.shared_weight && next.t - first.t <= rule.reach) {
                break;
            }
            sum += next.weight;
            end += 1;
        }
        group(start..end, &samples[start..end]);
        start = end;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const RULE: Rule = Rule { least: 0.02, opaque: 0.01, shared_weight: 0.3, reach: 5.0 };

    /// Returns the samples (t, optical depth) of a ray with these optical depths, one per step of length 1, if the
    /// model's densities are the predicted ones.
    fn chosen(depths: &[f32]) -> Vec<(f32, f32)> {
        let mut samples = Vec::new();
        let mut chooser = Chooser::new(RULE);
        let mut choose = |chosen: Chosen| samples.push((chosen.t, chosen.own * chosen.length(1.0)));
        for (i, &depth) in depths.iter().enumerate() {
            if chooser.step(i as f32, depth, -(-depth).exp_m1(), &mut choose) {
                break;
            }
        }
        chooser.end(&mut choose);
        samples
    }

    #[test]
    fn thin_steps_lend_their_depth_to_the_next_sample_or_the_last() {
        assert_eq!(chosen(&[]), []);
        assert_eq!(chosen(&[0.005, 0.0125]), [], "nothing is heavy enough");
        let found = chosen(&[0.005, 0.1, 0.005, 0.01, 0.2, 0.004]);
        let expected = [(1.0, 0.105), (4.0, 0.2 + 0.015 + 0.004)];
        assert_eq!(found.len(), expected.len());
        for (found, expected) in found.iter().zip(expected) {
            assert_eq!(found.0, expected.0);
            assert!((found.1 - expected.1).abs() < 1e-6, "{found:?}");
        }
    }

    /// Checks that steps too thin for samples of their own share a sample at the thickest of them, and that the ray
    /// loses less opacity than the least weight, however thin the fog is.
    #[test]
    fn fog_is_seen() {
        for thin in [1e-4_f32, 1e-3, 5e-3, 0.03] {
            let depths: Vec<f32> = (0..3000).map(|i| thin * if i % 7 == 3 { 1.5 } else { 1.0 }).collect();
            let found = chosen(&depths);
            let (all, kept): (f32, f32) = (depths.iter().sum(), found.iter().map(|own| own.1).sum());
            let lost = ((-kept).exp() - (-all).exp()).abs();
            assert!(lost < RULE.least, "{thin}: {lost}");
            assert!(found.len() < depths.len() / 2, "{thin}: {}", found.len());
            if thin < 5e-3 && 7.0 * thin * 1.08 < RULE.least {
                assert!(found.iter().all(|own| own.0 as usize % 7 == 3), "{found:?}");
            }
        }
    }

    /// Checks that the optical depths of the samples add up to those of all steps.
    #[test]
    fn a_translucent_ray_keeps_its_transmittance() {
        let depths: Vec<f32> = (0..12).map(|i| 0.06 * (0.7 * i as f32).sin().powi(2)).collect();
        let (all, kept): (f32, f32) = (depths.iter().sum(), chosen(&depths).iter().map(|own| own.1).sum());
        assert!(chosen(&depths).len() < depths.len() && (all - kept).abs() < 1e-5, "{all} {kept}");
    }

    #[test]
    fn an_opaque_ray_ends_and_shows_nothing_behind_it() {
        let found = chosen(&[0.5, 3.0, 2.0, 9.0, 9.0]);
        assert_eq!(found.iter().map(|own| own.0).collect::<Vec<_>>(), [0.0, 1.0, 2.0]);
        let depth: f32 = found.iter().map(|own| own.1).sum();
        assert!((-depth).exp() < 1e-4, "{depth}");
    }

    #[test]
    fn colours_are_shared_by_neighbours_of_little_weight() {
        let depths = [0.1, 0.1, 0.1, 0.1, 3.0, 0.2];
        let mut samples: Vec<Shaded> =
            (0..6).map(|i| Shaded { t: i as f32, depth: depths[i], weight: 0.0 }).collect();
        let mut found = Vec::new();
        share_colors(&RULE, &mut samples, |range, own| {
            assert_eq!(range.len(), own.len());
            found.push(range);
        });
        // The weights are 0.095, 0.086, 0.078, 0.070, 0.637, 0.006.
        assert_eq!(found, [0..3, 3..4, 4..5, 5..6]);
        let transmittance = (-depths.iter().sum::<f32>()).exp();
        let sum: f32 = samples.iter().map(|own| own.weight).sum();
        assert!((1.0 - transmittance - sum).abs() < 1e-6);
        // Samples that are far apart do not share a colour.
        samples.iter_mut().for_each(|own| own.t *= 10.0);
        let mut count = 0;
        share_colors(&RULE, &mut samples, |_, _| count += 1);
        assert_eq!(count, 6);
    }
}
