//! The gradient of the loss by the chain rule. The factors of the layers' products are rounded as in a backend;
//! everything else is f64. A hidden unit that rounding switches off is therefore off in the backend and in this
//! reference, and the two differ only in the order of f32 sums.

use super::sample::Sample;
use super::{Layer, Reference, harmonics};
use trimip_core::engine::batch::{Ray, Target};

/// Rounds to the nearest bf16, ties to even, as processor instructions do; denormal f32 values become zero.
pub fn bf16(value: f64) -> f64 {
    let bits = (value as f32).to_bits();
    if value.abs() < f64::from(f32::MIN_POSITIVE) {
        return 0.0;
    }
    f64::from(f32::from_bits((bits + 0x7fff + (bits >> 16 & 1)) & 0xffff_0000))
}

/// A last layer with at most this many outputs is not rounded.
const FEW: usize = 4;

/// The loss and its gradient.
pub struct Gradient {
    /// Mean loss.
    pub loss: f64,
    /// Gradient with respect to the weights of each layer, density network first.
    pub layers: Vec<Vec<f64>>,
    /// Gradient with respect to the features of every sample.
    pub features: Vec<(Sample, Vec<f64>)>,
}

/// A network with its rounding, for the forward and the backward pass.
struct Network<'a> {
    layers: &'a [Layer],
    round: &'a dyn Fn(f64) -> f64,
}

impl Network<'_> {
    /// Returns the function that rounds a layer's factors.
    fn rounding(&self, layer: usize) -> impl Fn(f64) -> f64 {
        let exact = layer + 1 == self.layers.len() && self.layers[layer].outputs <= FEW;
        move |value| if exact { value } else { (self.round)(value) }
    }

    /// Returns the inputs of every layer, then the output.
    fn forward(&self, input: Vec<f64>) -> Vec<Vec<f64>> {
        let mut values = vec![input];
        for (i, layer) in self.layers.iter().enumerate() {
            let (input, round) = (&values[i], self.rounding(i));
            let mut sums = vec![0.0; layer.outputs];
            for (x, row) in input.iter().zip(layer.weights.chunks_exact(layer.outputs)) {
                sums.iter_mut().zip(row).for_each(|(sum, w)| *sum += round(*x) * round(*w));
            }
            if i + 1 < self.layers.len() {
                sums.iter_mut().for_each(|x| *x = x.max(0.0));
            }
            values.push(sums);
        }
        values
    }

    /// Returns the gradient with respect to the input, then those with respect to the outputs of every layer.
    fn backward(&self, values: &[Vec<f64>], by_output: Vec<f64>) -> Vec<Vec<f64>> {
        let mut gradients = vec![by_output];
        for (i, layer) in self.layers.iter().enumerate().rev() {
            let (by_output, round) = (&gradients[gradients.len() - 1], self.rounding(i));
            let dot =
                |row: &[f64]| row.iter().zip(by_output).map(|(w, d)| round(*w) * round(*d)).sum::<f64>();
            let mut by_input: Vec<f64> = layer.weights.chunks_exact(layer.outputs).map(dot).collect();
            if i > 0 {
                by_input.iter_mut().zip(&values[i]).filter(|(_, x)| **x <= 0.0).for_each(|(d, _)| *d = 0.0);
            }
            gradients.push(by_input);
        }
        gradients.reverse();
        gradients
    }

    /// Adds inputᵀ·gradient to the rows of the weight gradient, starting at row `first`.
    fn add(&self, layer: usize, first: usize, input: &[f64], by_output: &[f64], out: &mut [f64]) {
        let (round, outputs) = (self.rounding(layer), self.layers[layer].outputs);
        for (x, row) in input.iter().zip(out.chunks_exact_mut(outputs).skip(first)) {
            row.iter_mut().zip(by_output).for_each(|(sum, d)| *sum += round(*x) * round(*d));
        }
    }
}

impl Reference {
    /// Returns the loss and the gradient of rays with given kept samples. `features` holds the features of all samples
    /// in order; they come from a backend, because their last bits decide how some of them round. `round` rounds the
    /// factors of products. As on the CPU, the harmonics of a ray are multiplied by the sum of its samples' gradients.
    /// `loss.opacity` is taken as 0, and every ray with a sample contributes.
    pub fn gradient(
        &self,
        rays: &[(Ray, Target, Vec<Sample>)],
        features: &[Vec<f64>],
        round: &dyn Fn(f64) -> f64,
    ) -> Gradient {
        let (density, color) =
            (Network { layers: &self.density, round }, Network { layers: &self.color, round });
        let zeros = |layers: &[Layer]| -> Vec<Vec<f64>> {
            layers.iter().map(|layer| vec![0.0; layer.weights.len()]).collect()
        };
        let (mut by_density, mut by_color) = (zeros(&self.density), zeros(&self.color));
        let live = || rays.iter().filter(|ray| !ray.2.is_empty());
        let weights: f64 = live().map(|ray| f64::from(ray.1.weight)).sum();
        let beta = f64::from(self.config.loss.beta);
        let (mut loss, mut by_features) = (0.0, Vec::new());
        let mut rows = features.iter();
        for (ray, target, samples) in live() {
            let view = harmonics(ray.direction.map(f64::from));
            let seen: Vec<_> = samples
                .iter()
                .zip(rows.by_ref())
                .map(|(sample, row)| {
                    let geometry = density.forward(row.clone());
                    let output = &geometry[geometry.len() - 1];
                    let shade = color.forward([&view[..], &output[1..]].concat());
                    let logits = &shade[shade.len() - 1];
                    let rgb = [0, 1, 2].map(|c| 1.0 / (1.0 + (-logits[c]).exp()));
                    ((output[0] - 1.0).exp() * sample.length, rgb, geometry, shade)
                })
                .collect();
            // Transmittance before each sample and after the last.
            let mut transmittance = vec![1.0];
            seen.iter().for_each(|(depth, ..)| {
                transmittance.push(transmittance[transmittance.len() - 1] * (-depth).exp());
            });
            let background = target.background.map(f64::from);
            let end = transmittance[seen.len()];
            let mut by_pixel = [0.0; 3];
            for (c, by_pixel) in by_pixel.iter_mut().enumerate() {
                let parts = seen.iter().enumerate();
                let pixel: f64 = parts
                    .map(|(i, (_, rgb, ..))| (transmittance[i] - transmittance[i + 1]) * rgb[c])
                    .sum::<f64>()
                    + end * background[c];
                let difference = pixel - f64::from(target.rgb[c]);
                let fraction = f64::from(target.weight) / 3.0;
                let size = difference.abs();
                loss += fraction * if size < beta { size * size / (2.0 * beta) } else { size - beta / 2.0 };
                *by_pixel = fraction * (difference / beta).clamp(-1.0, 1.0);
            }
            let shine = |rgb: &[f64; 3]| (0..3).map(|c| by_pixel[c] * rgb[c]).sum::<f64>();
            let mut by_view = vec![0.0; self.color[0].outputs];
            for (i, (_, rgb, geometry, shade)) in seen.iter().enumerate() {
                let weight = |k: usize| transmittance[k] - transmittance[k + 1];
                let behind: f64 = (i + 1..seen.len()).map(|k| weight(k) * shine(&seen[k].1)).sum();
                let by_depth = transmittance[i + 1] * shine(rgb) - behind - end * shine(&background);
                let by_logits = (0..3).map(|c| by_pixel[c] * weight(i) * rgb[c] * (1.0 - rgb[c])).collect();
                let back = color.backward(shade, by_logits);
                color.add(0, view.len(), &shade[0][view.len()..], &back[1], &mut by_color[0]);
                by_view.iter_mut().zip(&back[1]).for_each(|(sum, d)| *sum += d);
                for layer in 1..self.color.len() {
                    color.add(layer, 0, &shade[layer], &back[layer + 1], &mut by_color[layer]);
                }
                let logit = geometry[geometry.len() - 1][0];
                let by_logit = by_depth * samples[i].length * (logit - 1.0).clamp(-15.0, 15.0).exp();
                let back = density.backward(geometry, [&[by_logit][..], &back[0][view.len()..]].concat());
                for layer in 0..self.density.len() {
                    density.add(layer, 0, &geometry[layer], &back[layer + 1], &mut by_density[layer]);
                }
                by_features.push((samples[i], back[0].clone()));
            }
            color.add(0, 0, &view, &by_view, &mut by_color[0]);
        }
        // The gradients are divided by the sum of weights last, after all rounding.
        let layers = [by_density, by_color].concat();
        let mut result = Gradient { loss: loss / weights, layers, features: by_features };
        let features = result.features.iter_mut().map(|(_, gradient)| gradient);
        result.layers.iter_mut().chain(features).flatten().for_each(|g| *g /= weights);
        result
    }
}
