//! Shapes of the two networks of a field, and their inputs in addition to features: the viewing direction, and sines
//! and cosines.
//!
//! The density network maps an encoder's features to a logit and geometry features; the colour network maps the view
//! and the geometry features to colour. The fields of Tri-MipRF and instant-ngp, of NeRF and mip-NeRF, and of TensoRF
//! differ only in their settings. A field without networks (Plenoxels) has networks without layers, whose output is
//! their input.

use crate::{
    Config,
    config::{FieldConfig, ViewEncoding},
    field::encoders,
    math::{
        scalar::Real,
        sh::{self, spherical_harmonics},
        voronoi::{self, soft_voronoi},
    },
};

/// The layers of a network.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Network {
    /// Name of the network's slots: `density` or `color`.
    pub name: &'static str,
    /// [inputs, outputs] of each layer. There is a ReLU between layers. Without layers the output is the input.
    pub layers: Vec<[usize; 2]>,
    /// True if layers have biases.
    pub biases: bool,
    /// Layer with a skip connection: it reads the network's input after the outputs of the previous layer.
    pub joined: Option<usize>,
    /// Number of leading inputs whose sum is the first output. Nothing else reads these inputs, so they have no
    /// weights.
    pub summed: usize,
}

impl Network {
    /// Creates a network without layers.
    fn none(name: &'static str) -> Self {
        Self { name, layers: Vec::new(), biases: false, joined: None, summed: 0 }
    }

    /// Returns the number of inputs; 0 without layers.
    pub fn inputs(&self) -> usize {
        self.layers.first().map_or(0, |[inputs, _]| *inputs)
    }

    /// Returns the shape of the weights of a layer, [inputs, outputs].
    pub fn weights(&self, layer: usize) -> [usize; 2] {
        let [inputs, outputs] = self.layers[layer];
        if self.summed > 0 { [inputs - self.summed, outputs - 1] } else { [inputs, outputs] }
    }

    /// Computes the outputs for one input, in f64. `parameters` returns the weights [inputs, outputs] and the biases of
    /// a layer.
    pub fn run<'a>(&self, input: &[f64], parameters: impl Fn(usize) -> (&'a [f64], &'a [f64])) -> Vec<f64> {
        let mut values = input.to_vec();
        for layer in 0..self.layers.len() {
            if self.joined == Some(layer) {
                values.extend_from_slice(input);
            }
            let (weights, biases) = parameters(layer);
            let [_, outputs] = self.weights(layer);
            let mut sums = if biases.is_empty() { vec![0.0; outputs] } else { biases.to_vec() };
            for (value, weights) in values[self.summed..].iter().zip(weights.chunks_exact(outputs)) {
                sums.iter_mut().zip(weights).for_each(|(sum, weight)| *sum += value * weight);
            }
            if self.summed > 0 {
                sums.insert(0, values[..self.summed].iter().sum());
            }
            if layer + 1 < self.layers.len() {
                sums.iter_mut().for_each(|sum| *sum = sum.max(0.0));
            }
            values = sums;
        }
        values
    }
}

/// Returns the density network: the encoder's features → hidden … → 1 logit and the geometry features.
pub fn density_network(config: &Config) -> Network {
    let (encoder, field) = (encoders::of(config), &config.field);
    if encoder.direct() {
        return Network::none("density");
    }
    let width = encoder.width(config);
    let mut layers = layers(width, field.hidden as usize, field.density_layers, 1 + field.geometry as usize);
    let joined = (field.joined > 0 && field.joined < field.density_layers).then_some(field.joined as usize);
    if let Some(joined) = joined {
        layers[joined][0] += width;
    }
    let biases = field.biases && field.density_layers > 0;
    Network { name: "density", layers, biases, joined, summed: encoder.summed(config) }
}

/// Returns the colour network: the view and the geometry features, with their sines and cosines → hidden … → 3.
pub fn color_network(config: &Config) -> Network {
    let field = &config.field;
    if encoders::of(config).direct() {
        return Network::none("color");
    }
    let inputs = view_width(config) + geometry_width(config);
    let hidden = if field.color_hidden > 0 { field.color_hidden } else { field.hidden };
    let layers = layers(inputs, hidden as usize, field.color_layers, 3);
    Network { name: "color", layers, biases: field.biases, joined: None, summed: 0 }
}

fn layers(inputs: usize, hidden: usize, count: u32, outputs: usize) -> Vec<[usize; 2]> {
    let mut widths = vec![inputs];
    widths.extend((0..count).map(|_| hidden));
    widths.push(outputs);
    widths.windows(2).map(|pair| [pair[0], pair[1]]).collect()
}

/// Returns the number of geometry features: the outputs of the density network other than the logit. Without networks
/// the geometry features are the logits of red, green and blue.
pub fn geometry(config: &Config) -> usize {
    if encoders::of(config).direct() { 3 } else { config.field.geometry as usize }
}

/// Returns the number of inputs that the colour network gets from a direction; 0 if it takes no direction.
pub fn view_width(config: &Config) -> usize {
    let field = &config.field;
    if encoders::of(config).direct() {
        return 0;
    }
    match (field.directions, field.view) {
        (false, _) => 0,
        (true, ViewEncoding::Harmonics) => (field.harmonics as usize).pow(2),
        (true, ViewEncoding::Frequencies) => with_frequencies(3, field.view_frequencies),
        (true, ViewEncoding::Voronoi) => voronoi::COUNT,
    }
}

/// Returns the name of the slot with the weights from the direction to the first hidden layer of colour, and the number
/// of these weights, which come first in the slot; `None` if the colour network takes no direction.
pub fn direction_weights(config: &Config) -> Option<(String, usize)> {
    let network = color_network(config);
    let (width, [_, outputs]) = (view_width(config), *network.layers.first()?);
    (width > 0).then(|| (format!("{}.0.weight", network.name), width * outputs))
}

/// Returns the number of inputs that the colour network gets from the geometry features.
pub fn geometry_width(config: &Config) -> usize {
    match encoders::of(config).direct() {
        true => 0,
        false => with_frequencies(config.field.geometry as usize, config.field.geometry_frequencies),
    }
}

/// Returns the length of a row of `values` numbers with their sines and cosines at `frequencies` frequencies.
pub fn with_frequencies(values: usize, frequencies: u32) -> usize {
    values * (1 + 2 * frequencies as usize)
}

/// Appends sin(2^k x) of all values, then cos(2^k x) of all values, for each k below `frequencies` (NeRF, Eq. 4,
/// without π). `row` begins with the values and has room for the rest. Each angle is twice the previous one, so its
/// sine and cosine are computed from the previous sine and cosine; errors double with the angle.
#[inline]
pub fn append_frequencies<R: Real>(row: &mut [R], values: usize, frequencies: u32) {
    for k in 0..frequencies as usize {
        let first = values * (1 + 2 * k);
        for i in 0..values {
            let (sine, cosine) = match k {
                0 => row[i].sin_cos(),
                _ => {
                    let (sine, cosine) = (row[first + i - 2 * values], row[first + i - values]);
                    ((sine + sine) * cosine, (cosine - sine) * (cosine + sine))
                }
            };
            (row[first + i], row[first + values + i]) = (sine, cosine);
        }
    }
}

/// Adds the gradient that flows through the sines and cosines to the gradient of the values, at the front of
/// `gradient`. `row` is the output of [`append_frequencies`], and `gradient` is the gradient with respect to `row`.
#[inline]
pub fn pull_frequencies<R: Real>(row: &[R], gradient: &mut [R], values: usize, frequencies: u32) {
    let mut factor = R::one();
    for k in 0..frequencies as usize {
        let first = values * (1 + 2 * k);
        for i in 0..values {
            let (sine, cosine) = (row[first + i], row[first + values + i]);
            let (by_sine, by_cosine) = (gradient[first + i], gradient[first + values + i]);
            gradient[i] += factor * (by_sine * cosine - by_cosine * sine);
        }
        factor = factor + factor;
    }
}

/// Writes the encoding of a unit direction to `row`, which has room for [`view_width`] values of the settings `field`.
#[inline]
pub fn encode_view<R: Real>(field: &FieldConfig, direction: [R; 3], row: &mut [R]) {
    match field.view {
        ViewEncoding::Harmonics => {
            let width = row.len().min(sh::COUNT);
            row[..width].copy_from_slice(&spherical_harmonics(direction)[..width]);
        }
        ViewEncoding::Frequencies => {
            row[..3].copy_from_slice(&direction);
            append_frequencies(row, 3, field.view_frequencies);
        }
        ViewEncoding::Voronoi => {
            let sharpness = R::from_f64(field.view_sharpness.into());
            row[..voronoi::COUNT].copy_from_slice(&soft_voronoi(direction, sharpness));
        }
    }
}

/// Returns the colour network's inputs from a unit direction: [`view_width`] values.
pub fn view<R: Real>(config: &Config, direction: [R; 3]) -> Vec<R> {
    let mut row = vec![R::zero(); view_width(config)];
    if !row.is_empty() {
        encode_view(&config.field, direction, &mut row);
    }
    row
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::EncoderKind;

    #[test]
    fn frequencies_are_those_of_the_equation_and_their_gradient_a_finite_difference() {
        let (values, frequencies) = ([0.3, -1.1, 0.7_f64], 3);
        let row = |values: [f64; 3]| {
            let mut row = vec![0.0; with_frequencies(3, frequencies)];
            row[..3].copy_from_slice(&values);
            append_frequencies(&mut row, 3, frequencies);
            row
        };
        let found = row(values);
        assert_eq!(found.len(), 21);
        for k in 0..3 {
            for i in 0..3 {
                let x = 2_f64.powi(k as i32) * values[i];
                let close = |found: f64, expected: f64| (found - expected).abs() < 1e-14;
                assert!(close(found[3 + 6 * k + i], x.sin()) && close(found[6 + 6 * k + i], x.cos()));
            }
        }
        let weights: Vec<f64> = (0..21).map(|i| (f64::from(i) * 0.37).sin()).collect();
        let sum = |values| row(values).iter().zip(&weights).map(|(x, w)| x * w).sum::<f64>();
        let mut gradient = weights.clone();
        pull_frequencies(&found, &mut gradient, 3, frequencies);
        for i in 0..3 {
            let moved = |by: f64| sum(std::array::from_fn(|j| values[j] + if i == j { by } else { 0.0 }));
            assert!((gradient[i] - (moved(1e-6) - moved(-1e-6)) / 2e-6).abs() < 1e-8);
        }
    }

    #[test]
    fn the_fields_of_the_papers_have_their_sizes() {
        let parameters = |network: &Network| -> usize {
            let layers = 0..network.layers.len();
            let biases = |outputs: usize| if network.biases { outputs } else { 0 };
            layers.map(|i| network.weights(i)).map(|[k, n]| k * n + biases(n)).sum()
        };
        // NeRF has two such networks, mip-NeRF has one: 8 layers of 256 outputs, then one of 128 for colour.
        let mut nerf = Config::default();
        nerf.encoder.kind = EncoderKind::Frequencies;
        let field = &mut nerf.field;
        (field.hidden, field.density_layers, field.joined, field.geometry) = (256, 8, 5, 256);
        (field.color_layers, field.color_hidden, field.biases) = (1, 128, true);
        (field.view, field.view_frequencies) = (ViewEncoding::Frequencies, 4);
        let all = |config: &Config| parameters(&density_network(config)) + parameters(&color_network(config));
        assert_eq!(2 * all(&nerf), 1_191_688);
        (nerf.frequencies.count, nerf.frequencies.identity) = (16, false);
        assert_eq!(all(&nerf), 612_740);
        // TensoRF: 150 → 128 → 128 → 3 with biases.
        let mut config = Config::default();
        let field = &mut config.field;
        (field.view, field.view_frequencies, field.geometry, field.geometry_frequencies) =
            (ViewEncoding::Frequencies, 2, 27, 2);
        (field.hidden, field.color_layers, field.biases) = (128, 2, true);
        let network = color_network(&config);
        assert_eq!(network.layers, [[150, 128], [128, 128], [128, 3]]);
        assert_eq!(parameters(&network), 150 * 128 + 128 + 128 * 128 + 128 + 128 * 3 + 3);
    }
}
