//! The parameters: one flat array with named slots, so that the optimiser makes one pass, a checkpoint one read, and two
//! backends are compared by name.

use crate::{
    Aabb, Config, Result,
    rng::{Random, Stream, unit},
    sh,
    tensors::{Tensor, TensorFile},
    tri_mip::{CHANNELS, FEATURES, sides},
};
use std::ops::Range;

/// Geometry features that the density network hands to the colour network, beside its density logit.
pub const GEOMETRY: usize = 15;

/// What a slot holds; decides its learning rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Base level of the feature planes.
    Planes,
    /// Weights of a network layer, [inputs, outputs].
    Network,
}

/// A named part of the flat array.
#[derive(Clone, Debug, PartialEq)]
pub struct Slot {
    /// Name in files: `planes`, `density.0.weight`, `color.2.weight`, ...
    pub name: String,
    /// Shape; the last axis is contiguous.
    pub shape: Vec<usize>,
    /// Place in the flat array.
    pub range: Range<usize>,
    /// What it holds.
    pub kind: Kind,
}

/// All slots, in order: planes, density network, colour network. Layers have no biases.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// The slots.
    pub slots: Vec<Slot>,
}

/// Inputs and outputs of each layer of the density network: 48 → hidden … → 1 logit + 15 geometry features.
pub fn density_layers(config: &Config) -> Vec<[usize; 2]> {
    layers(FEATURES, config.field.hidden as usize, config.field.density_layers, 1 + GEOMETRY)
}

/// Inputs and outputs of each layer of the colour network: 16 spherical harmonics (none without directions) + 15 geometry
/// features → hidden … → 3.
pub fn color_layers(config: &Config) -> Vec<[usize; 2]> {
    let harmonics = if config.field.directions { sh::COUNT } else { 0 };
    layers(harmonics + GEOMETRY, config.field.hidden as usize, config.field.color_layers, 3)
}

fn layers(inputs: usize, hidden: usize, count: u32, outputs: usize) -> Vec<[usize; 2]> {
    let mut widths = vec![inputs];
    widths.extend((0..count).map(|_| hidden));
    widths.push(outputs);
    widths.windows(2).map(|pair| [pair[0], pair[1]]).collect()
}

impl Layout {
    /// The slots of a configuration.
    pub fn new(config: &Config) -> Self {
        let mut layout = Self { slots: Vec::new() };
        let sides = sides(&config.encoder, &Aabb::new(&config.scene));
        let shape = match sides {
            [x, y, z] if x == y && y == z => vec![3, x, x, CHANNELS],
            // Planes YZ, XZ and XY, one after the other, each row by row.
            [x, y, z] => vec![y * z + x * z + x * y, CHANNELS],
        };
        layout.push("planes".into(), shape, Kind::Planes);
        for (network, layers) in [("density", density_layers(config)), ("color", color_layers(config))] {
            for (i, shape) in layers.into_iter().enumerate() {
                layout.push(format!("{network}.{i}.weight"), shape.to_vec(), Kind::Network);
            }
        }
        layout
    }

    fn push(&mut self, name: String, shape: Vec<usize>, kind: Kind) {
        let start = self.len();
        let range = start..start + shape.iter().product::<usize>();
        self.slots.push(Slot { name, shape, range, kind });
    }

    /// Floats in all.
    pub fn len(&self) -> usize {
        self.slots.last().map_or(0, |slot| slot.range.end)
    }

    /// True when there is no slot.
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// Slots of one network (`density` or `color`), first layer first.
    pub fn network(&self, name: &str) -> impl Iterator<Item = &Slot> {
        let prefix = format!("{name}.");
        self.slots.iter().filter(move |slot| slot.name.starts_with(&prefix))
    }

    /// Initial values: planes U(−r, r), layers by Glorot's uniform rule ±sqrt(6/(inputs + outputs)) (paper).
    pub fn initial(&self, config: &Config) -> Vec<f32> {
        let random = Random::new(config.seed);
        let mut values = Vec::with_capacity(self.len());
        for slot in &self.slots {
            let bound = match slot.kind {
                Kind::Planes => config.encoder.init_range,
                Kind::Network => (6.0 / (slot.shape[0] + slot.shape[1]) as f32).sqrt(),
            };
            values.extend(slot.range.clone().map(|i| {
                let bits = random.bits(Stream::Initial, 0, (i / 4) as u32)[i % 4];
                (2.0 * unit(bits) - 1.0) * bound
            }));
        }
        values
    }

    /// Cuts flat values into named tensors; each name gets `suffix`.
    pub fn to_tensors(&self, values: &[f32], suffix: &str, file: &mut TensorFile) {
        for slot in &self.slots {
            let tensor = Tensor::f32(&slot.shape, values[slot.range.clone()].to_vec());
            file.tensors.insert(format!("{}{suffix}", slot.name), tensor);
        }
    }

    /// Collects named tensors into flat values; a missing tensor or another shape is an error that names it.
    pub fn from_tensors(&self, file: &TensorFile, name: &str, suffix: &str) -> Result<Vec<f32>> {
        let mut values = Vec::with_capacity(self.len());
        for slot in &self.slots {
            values.extend_from_slice(file.f32(name, &format!("{}{suffix}", slot.name), &slot.shape)?);
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_has_29_thousand_weights_and_12_million_texel_values() {
        let layout = Layout::new(&Config::default());
        let network: usize =
            layout.slots.iter().filter(|s| s.kind == Kind::Network).map(|s| s.range.len()).sum();
        assert_eq!(network, 48 * 128 + 128 * 16 + 31 * 128 + 128 * 128 + 128 * 3);
        assert_eq!(layout.slots[0].range.len(), 3 * 512 * 512 * 16);
        assert_eq!(layout.network("color").count(), 3);
    }

    #[test]
    fn tensors_carry_every_value_there_and_back() {
        let mut config = Config::default();
        config.encoder.plane_size = 8;
        let layout = Layout::new(&config);
        let values = layout.initial(&config);
        let mut file = TensorFile::default();
        layout.to_tensors(&values, ".m", &mut file);
        assert_eq!(layout.from_tensors(&file, "x", ".m").unwrap(), values);
        assert!(layout.from_tensors(&file, "x", "").unwrap_err().message.contains("planes"));
    }

    #[test]
    fn initial_values_fill_their_ranges() {
        let mut config = Config::default();
        config.encoder.plane_size = 64;
        let layout = Layout::new(&config);
        let values = layout.initial(&config);
        for slot in &layout.slots {
            let bound = match slot.kind {
                Kind::Planes => 0.01,
                Kind::Network => (6.0 / (slot.shape[0] + slot.shape[1]) as f64).sqrt(),
            };
            let part = &values[slot.range.clone()];
            let mean = part.iter().map(|&x| f64::from(x)).sum::<f64>() / part.len() as f64;
            let variance = part.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() / part.len() as f64;
            assert!(part.iter().all(|x| f64::from(x.abs()) <= bound * 1.000_001));
            // Uniform: variance bound²/3; four standard errors.
            let n = (part.len() as f64).sqrt();
            assert!(mean.abs() < 4.0 * bound / n, "{}", slot.name);
            assert!((variance / (bound * bound / 3.0) - 1.0).abs() < 4.0 / n, "{}", slot.name);
        }
    }
}
