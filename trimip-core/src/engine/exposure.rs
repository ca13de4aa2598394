//! Exposure of photographs, for `loss.exposure = "gain"`: photograph i has three log-gains e_i (RGB), and the loss
//! compares exp(e_i − mean of e)·rendered with the photograph. Subtracting the mean fixes the scale of the model's
//! colours: a camera without a photograph is rendered at the mean exposure. The log-gains are trained alongside the
//! parameters and are not part of a model.

pub use crate::engine::lagged::LAG;

use crate::{
    Result, ViewSet,
    config::OptimizerConfig,
    engine::{lagged::Lagged, step_result::StepResult},
    field::{losses::exposure::exposed, tensors::TensorFile},
};
use std::collections::BTreeMap;

/// Prefix of the names of the log-gains' tensors in checkpoints.
pub const PREFIX: &str = "exposure.";

/// Bound of the absolute value of a log-gain: four stops, ln 16. It keeps a photograph without any light from shifting
/// the mean.
const MOST: f32 = 2.772_588_7;

/// Returns the number of each view's photograph, counted from 0. Views with the same name at different scales show one
/// photograph. If a scale has several views with the same name, the n-th such view of every scale shows the n-th such
/// photograph.
pub fn photographs(views: &ViewSet) -> Vec<u32> {
    let mut numbers = BTreeMap::new();
    let mut all = vec![0; views.views.len()];
    for scale in &views.scales {
        let mut seen = BTreeMap::<&str, u32>::new();
        for view in scale.views.clone() {
            let name = views.views[view].name.as_str();
            let again = seen.entry(name).or_default();
            let next = numbers.len() as u32;
            all[view] = *numbers.entry((name, *again)).or_insert(next);
            *again += 1;
        }
    }
    all
}

/// Returns a rendered picture adjusted to the exposure of its photograph, because a camera pose does not determine an
/// exposure. Each half (`left` true or false) is multiplied, per channel, by the gain that fits the other half best in
/// the least-squares sense, within four stops. So no pixel contributes to its own gain. All slices have one entry per
/// pixel (RGB); `behind` is as in [`exposed`].
///
/// # Panics
/// If the slices differ in length.
pub fn exposed_by_the_other_half(
    shown: &[[f32; 3]],
    behind: &[[f32; 3]],
    target: &[[f32; 3]],
    left: &[bool],
) -> Vec<[f32; 3]> {
    assert!([behind.len(), target.len(), left.len()] == [shown.len(); 3], "pictures of one size");
    let gain = |half: bool| -> [f32; 3] {
        let pixels = || (0..shown.len()).filter(|&i| left[i] == half);
        std::array::from_fn(|c| {
            let own = |i: usize, picture: &[[f32; 3]]| f64::from(picture[i][c] - behind[i][c]);
            let squares: f64 = pixels().map(|i| own(i, shown).powi(2)).sum();
            let product: f64 = pixels().map(|i| own(i, shown) * own(i, target)).sum();
            let least = f64::from(-MOST).exp();
            if squares == 0.0 { 1.0 } else { (product / squares).clamp(least, least.recip()) as f32 }
        })
    };
    let gains = [gain(true), gain(false)];
    (0..shown.len()).map(|i| exposed(shown[i], behind[i], gains[usize::from(left[i])])).collect()
}

/// Log-gains of all photographs in training, their moments, and the gradients that were not applied yet.
#[derive(Clone, Debug, PartialEq)]
pub struct Exposures(Lagged<3>);

impl Exposures {
    /// Creates log-gains of 0 for `count` photographs.
    pub fn new(count: usize) -> Self {
        Self(Lagged::new(count))
    }

    /// Replaces the log-gains (RGB), one per photograph; surplus values are ignored.
    pub fn set(&mut self, values: &[[f32; 3]]) {
        self.0.values.iter_mut().zip(values).for_each(|(own, value)| *own = *value);
    }

    /// Returns the log-gains (RGB) of each photograph, minus their mean over all photographs.
    pub fn log_gains(&self) -> Vec<[f64; 3]> {
        let mean = mean(self.0.values.iter().map(|value| value.map(f64::from)));
        let centred = |value: &[f32; 3]| std::array::from_fn(|c| f64::from(value[c]) - mean[c]);
        self.0.values.iter().map(centred).collect()
    }

    /// Returns the gains (RGB) of each photograph, by which the loss multiplies rendered colours.
    pub fn gains(&self) -> Vec<[f32; 3]> {
        self.log_gains().into_iter().map(|value| value.map(|value| value.exp() as f32)).collect()
    }

    /// Returns the gradient of a step's mean loss with respect to the log-gains (RGB) of each photograph. The loss
    /// depends on log-gains minus their mean, so the mean of the derivatives is subtracted from each derivative.
    pub fn gradient(&self, step: &StepResult) -> Vec<[f32; 3]> {
        let divided = |sum: &[f64; 3]| match step.sums.weight > 0.0 {
            true => sum.map(|sum| sum / step.sums.weight),
            false => [0.0; 3],
        };
        let mut own: Vec<[f64; 3]> = step.exposures.iter().map(divided).collect();
        own.resize(self.0.values.len(), [0.0; 3]);
        let mean = mean(own.iter().copied());
        own.iter().map(|own| std::array::from_fn(|c| (own[c] - mean[c]) as f32)).collect()
    }

    /// Queues the gradient of `step`, the result of the next step in order.
    pub(crate) fn take(&mut self, step: &StepResult) {
        self.0.take(self.gradient(step));
    }

    /// Applies the gradients that are due ([`Lagged::due`]). Returns whether any log-gain may have changed.
    pub(crate) fn advance(
        &mut self,
        config: &OptimizerConfig,
        rate: f64,
        steps: u64,
        in_transit: usize,
    ) -> bool {
        let mut moved = false;
        while let Some((step, gradient)) = self.0.due(steps, in_transit) {
            self.0.apply(config, rate, step, &gradient);
            self.0.values.as_flattened_mut().iter_mut().for_each(|value| *value = value.clamp(-MOST, MOST));
            moved = true;
        }
        moved
    }

    /// Adds the tensors from which training resumes, of shape [photographs, 3].
    pub(crate) fn to_tensors(&self, file: &mut TensorFile) {
        self.0.to_tensors(PREFIX, file);
    }

    /// Reads the state from a checkpoint of a run on the same number of photographs; `name` names the checkpoint in
    /// errors.
    pub(crate) fn restored(&self, file: &TensorFile, name: &str) -> Result<Self> {
        Ok(Self(self.0.restored(PREFIX, file, name)?))
    }
}

/// Returns the mean of `values`; 0 if there are none.
fn mean(values: impl ExactSizeIterator<Item = [f64; 3]>) -> [f64; 3] {
    let count = values.len().max(1) as f64;
    values.fold([0.0; 3], |sum, value| std::array::from_fn(|c| sum[c] + value[c])).map(|sum| sum / count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Camera, Config, Intrinsics, Scale, View, engine::batch::StepSums, field::adamw::Rule};

    #[test]
    fn views_of_one_name_are_one_photograph() {
        let camera = Camera {
            intrinsics: Intrinsics::from_angle(1, 1, 0.7),
            rotation: glam::DMat3::IDENTITY,
            origin: glam::DVec3::ZERO,
        };
        let views: Vec<View> = ["a", "b", "b", "c", "b", "c", "b", "d"]
            .map(|name| View { name: name.into(), camera, offset: 0 })
            .into();
        let scale = |factor, views| Scale { factor, weight: (factor * factor) as f32, views, pixels: 0..0 };
        let set = ViewSet {
            views,
            pixels: Vec::new().into(),
            alpha: crate::Alpha::Straight,
            depths: Vec::new(),
            scales: vec![scale(1, 0..4), scale(2, 4..8)],
        };
        assert_eq!(photographs(&set), [0, 1, 2, 3, 1, 3, 2, 4]);
    }

    #[test]
    fn the_gradient_is_the_slope_by_each_log_gain() {
        // The loss is Σ w_i·gain_i²; a gain also depends on the mean that is subtracted. With the mean held fixed, the
        // derivative with respect to a photograph's log-gain is 2·w·gain².
        let weights = [0.3, -1.2, 0.7, 2.0];
        let at = |values: [f32; 4]| {
            let mut exposures = Exposures::new(4);
            exposures.set(&values.map(|value| [value, 0.0, -value]));
            exposures
        };
        let loss = |values: [f32; 4]| {
            let gains = at(values).log_gains();
            weights.iter().zip(gains).map(|(w, e)| w * (2.0 * e[0]).exp()).sum::<f64>()
        };
        let values = [0.5, -0.25, 0.125, 0.0];
        let own = at(values).log_gains().into_iter().zip(weights);
        let exposures = own.map(|(e, w)| [4.0 * 2.0 * w * (2.0 * e[0]).exp(), 0.0, 0.0]).collect();
        let sums = StepSums { weight: 4.0, ..StepSums::default() };
        let step = StepResult { sums, exposures, ..StepResult::default() };
        let found = at(values).gradient(&step);
        let h = 1.0 / 1024.0;
        for i in 0..4 {
            let moved = |by: f32| {
                let mut values = values;
                values[i] += by;
                loss(values)
            };
            let slope = (moved(h) - moved(-h)) / f64::from(2.0 * h);
            assert!((f64::from(found[i][0]) - slope).abs() < 1e-5, "{i}: {found:?}, not {slope}");
            assert_eq!(found[i][1], 0.0);
        }
    }

    #[test]
    fn the_exposure_of_a_half_is_that_of_the_other() {
        let shown: Vec<[f32; 3]> = (1..9).map(|i| [0.1, 0.05, 0.02].map(|c| c * i as f32)).collect();
        let behind: Vec<[f32; 3]> = (0..8).map(|i| [0.01 * i as f32; 3]).collect();
        let left: Vec<bool> = (0..8).map(|i| i % 4 < 2).collect();
        let by_hand = |i: usize, gain: [f32; 3]| exposed(shown[i], behind[i], gain);
        // A photograph of another exposure is matched.
        let gains = [1.5, 0.5, 2.0];
        let target: Vec<_> = (0..8).map(|i| by_hand(i, gains)).collect();
        let found = exposed_by_the_other_half(&shown, &behind, &target, &left);
        for (found, target) in found.as_flattened().iter().zip(target.as_flattened()) {
            assert!((found - target).abs() < 1e-6, "{found} is not {target}");
        }
        // A change in the left half changes only the right half.
        let mut moved = target.clone();
        moved[0] = [1.0; 3];
        let other = exposed_by_the_other_half(&shown, &behind, &moved, &left);
        assert!((0..8).all(|i| (other[i] == found[i]) == left[i]), "{other:?}");
        // The gain is 1 if nothing was rendered, and at most four stops.
        let dark = exposed_by_the_other_half(&behind, &behind, &target, &left);
        assert_eq!(dark, behind);
        let bright = exposed_by_the_other_half(&shown[4..5], &[[0.0; 3]], &[[1.0; 3]], &[true]);
        assert_eq!(bright, shown[4..5], "the other half has no pixel");
        let two = [[0.01_f32; 3]; 2];
        let most = exposed_by_the_other_half(&two, &[[0.0; 3]; 2], &[[1.0; 3]; 2], &[true, false]);
        assert!(most.as_flattened().iter().all(|c| (c - 0.16).abs() < 1e-6), "{most:?}");
    }

    #[test]
    fn a_common_factor_of_all_photographs_is_none() {
        let mut exposures = Exposures::new(3);
        exposures.set(&[[0.5, 1.0, -0.25]; 3]);
        assert_eq!(exposures.gains(), [[1.0; 3]; 3]);
        assert_eq!(Exposures::new(0).gains(), [] as [[f32; 3]; 0]);
    }

    #[test]
    fn gradients_wait_for_their_turn_and_move_by_the_rule() {
        let config = Config::default().optimizer;
        let step = |g: f64| StepResult {
            sums: StepSums { weight: 2.0, ..StepSums::default() },
            exposures: vec![[2.0 * g, 0.0, f64::NAN], [-2.0 * g, 0.0, 0.0]],
            ..StepResult::default()
        };
        let mut exposures = Exposures::new(2);
        for (steps, gradient) in [0.5, -0.25, 0.125, 1.0].into_iter().enumerate() {
            exposures.take(&step(gradient));
            let moved = exposures.advance(&config, 1e-2, steps as u64 + 1, 0);
            assert_eq!(moved, steps >= LAG);
        }
        // The two gradients that are due, applied by the optimiser's rule for network parameters, without weight decay.
        let (mut value, mut m, mut v) = (0.0_f32, 0.0, 0.0);
        for (step, gradient) in [(1, 0.5), (2, -0.25)] {
            let rule = Rule { shrink: 1.0, ..Rule::new(&config, 1e-2, step) };
            rule.apply(&mut value, &mut m, &mut v, gradient);
        }
        assert!(value != 0.0);
        assert_eq!(exposures.0.values, [[value, 0.0, 0.0], [-value, 0.0, 0.0]]);
        // Queued gradients survive a checkpoint.
        let mut file = TensorFile::default();
        exposures.to_tensors(&mut file);
        assert!(file.tensors.contains_key(&format!("{PREFIX}pending.{}", LAG - 1)));
        // One gradient is NaN, so the states are compared as text.
        let restored = Exposures::new(2).restored(&file, "checkpoint").unwrap();
        assert_eq!(format!("{restored:?}"), format!("{exposures:?}"));
        assert_eq!(
            Exposures::new(3).restored(&file, "checkpoint").unwrap_err().kind(),
            crate::ErrorKind::Input
        );
    }
}
