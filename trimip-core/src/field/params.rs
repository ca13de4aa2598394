//! The parameters: one flat array of named slots. Encoders and networks declare their slots. Optimiser, checkpoints,
//! model files and memory prediction use only these declarations.

pub use crate::field::slot::{ALIGNMENT, ActiveRange, Slot};

use crate::{
    Config, Result,
    field::{
        encoders,
        networks::{color_network, density_network, direction_weights},
        slot::in_sequence,
        tensors::{Tensor, TensorFile},
    },
    math::rng::{Random, Sequence, unit},
};
use std::ops::Range;

/// All slots in order: encoder, density network, colour network.
#[derive(Clone, Debug, PartialEq)]
pub struct Layout {
    /// The slots.
    pub slots: Vec<Slot>,
    /// Number of slots of the encoder, which come first.
    encoder: usize,
}

/// Returns [inputs, outputs] of each layer of the density network.
pub fn density_layers(config: &Config) -> Vec<[usize; 2]> {
    density_network(config).layers
}

/// Returns [inputs, outputs] of each layer of the colour network.
pub fn color_layers(config: &Config) -> Vec<[usize; 2]> {
    color_network(config).layers
}

/// Returns a number of the standard normal distribution (Box and Muller 1958): one of the four numbers that `bits`
/// determine.
fn normal(bits: [u32; 4], i: usize) -> f32 {
    let pair = i % 4 / 2 * 2;
    // Keeps the argument above 0, so that the logarithm is finite.
    let radius = (-2.0 * (1.0 - unit(bits[pair])).max(f32::MIN_POSITIVE).ln()).sqrt();
    let angle = std::f32::consts::TAU * unit(bits[pair + 1]);
    radius * if i.is_multiple_of(2) { angle.cos() } else { angle.sin() }
}

impl Layout {
    /// Creates the layout of a configuration.
    pub fn new(config: &Config) -> Self {
        let mut slots = encoders::of(config).slots(config);
        let encoder = slots.len();
        for network in [density_network(config), color_network(config)] {
            for i in 0..network.layers.len() {
                let [inputs, outputs] = network.weights(i);
                // Glorot's uniform rule, as in the paper.
                let bound = (6.0 / (inputs + outputs) as f32).sqrt();
                slots.push(Slot::new(format!("{}.{i}.weight", network.name), vec![inputs, outputs], bound));
                if network.biases {
                    slots.push(Slot::new(format!("{}.{i}.bias", network.name), vec![outputs], 0.0));
                }
            }
        }
        Self { slots: in_sequence(slots), encoder }
    }

    /// Creates the layout of these slots, one after the other.
    pub fn of(slots: impl IntoIterator<Item = Slot>) -> Self {
        Self { slots: in_sequence(slots), encoder: 0 }
    }

    /// Returns the number of floats, including the padding.
    pub fn len(&self) -> usize {
        self.slots.last().map_or(0, |slot| slot.padded().end)
    }

    /// Returns the encoder's slots, in the order of the flat array.
    pub fn encoder(&self) -> &[Slot] {
        &self.slots[..self.encoder]
    }

    /// Returns the slots of both networks, in the order of the flat array: density, then colour.
    pub fn networks(&self) -> &[Slot] {
        &self.slots[self.encoder..]
    }

    /// Returns true if there are no slots.
    pub fn is_empty(&self) -> bool {
        self.slots.is_empty()
    }

    /// Returns the slots of one network (`density` or `color`), layer by layer: the weights of a layer, then its biases
    /// if it has any.
    pub fn network(&self, name: &str) -> impl Iterator<Item = &Slot> {
        let prefix = format!("{name}.");
        self.slots.iter().filter(move |slot| slot.name.starts_with(&prefix))
    }

    /// Returns the initial values of the flat array, uniform within each slot's bound, or normal; the padding is zero.
    /// With `field.direction_delay` the weights of the view direction are 0.
    pub fn initial(&self, config: &Config) -> Vec<f32> {
        let random = Random::new(config.seed);
        let mut values = vec![0.0; self.len()];
        for slot in &self.slots {
            for (value, i) in values[slot.range.clone()].iter_mut().zip(slot.range.clone()) {
                let bits = random.bits(Sequence::Initial, 0, (i / 4) as u32);
                *value =
                    slot.bound * if slot.normal { normal(bits, i) } else { 2.0 * unit(bits[i % 4]) - 1.0 };
            }
        }
        if config.field.direction_delay > 0.0
            && let Some(weights) = self.direction_weights(config)
        {
            values[weights].fill(0.0);
        }
        values
    }

    /// Returns the range of the weights from the viewing direction to the first hidden layer of colour; `None` if there
    /// are none.
    pub fn direction_weights(&self, config: &Config) -> Option<Range<usize>> {
        let (name, count) = direction_weights(config)?;
        let slot = self.slots.iter().find(|slot| slot.name == name)?;
        Some(slot.range.start..slot.range.start + count)
    }

    /// Splits the flat array `values` into one tensor per slot; `suffix` is appended to each name.
    pub fn to_tensors(&self, values: &[f32], suffix: &str, file: &mut TensorFile) {
        for slot in &self.slots {
            let tensor = Tensor::f32(&slot.shape, values[slot.range.clone()].to_vec());
            file.tensors.insert(format!("{}{suffix}", slot.name), tensor);
        }
    }

    /// Joins the tensors of all slots into one flat array, with zeros in the padding: the inverse of
    /// [`to_tensors`](Self::to_tensors). `name` names the file in errors.
    ///
    /// # Errors
    /// When a tensor is missing, or has another type or shape; the error names it.
    pub fn from_tensors(&self, file: &TensorFile, name: &str, suffix: &str) -> Result<Vec<f32>> {
        self.expect(file, name, suffix)?;
        let mut values = vec![0.0; self.len()];
        for slot in &self.slots {
            let tensor = file.f32(name, &format!("{}{suffix}", slot.name), &slot.shape)?;
            values[slot.range.clone()].copy_from_slice(tensor);
        }
        Ok(values)
    }

    /// Rejects a file in which a slot's tensor is missing or has the wrong shape, before memory is allocated for the
    /// values.
    ///
    /// # Errors
    /// As [`from_tensors`](Self::from_tensors).
    pub fn expect(&self, file: &TensorFile, name: &str, suffix: &str) -> Result<()> {
        self.slots
            .iter()
            .try_for_each(|slot| file.f32(name, &format!("{}{suffix}", slot.name), &slot.shape).map(|_| ()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_paper_has_29_thousand_weights_and_12_million_texel_values() {
        let layout = Layout::new(&Config::default());
        let network: usize = layout.networks().iter().map(|slot| slot.range.len()).sum();
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
        assert!(layout.from_tensors(&file, "x", "").unwrap_err().message().contains("planes"));
    }

    #[test]
    fn slots_of_any_length_begin_on_a_line_and_leave_zeros_between_them() {
        let slots = [("a", vec![3, 5]), ("b", vec![1]), ("c", vec![2, 16])];
        let layout = Layout::of(slots.map(|(name, shape)| Slot::new(name, shape, 1.0)));
        let ranges: Vec<_> = layout.slots.iter().map(|slot| slot.range.clone()).collect();
        assert_eq!((ranges, layout.len()), (vec![0..15, 16..17, 32..64], 64));
        let values = layout.initial(&Config::default());
        let zeros = |range: Range<usize>| values[range].iter().all(|&value| value == 0.0);
        assert!(zeros(15..16) && zeros(17..32) && values[16] != 0.0);
        let mut file = TensorFile::default();
        layout.to_tensors(&values, "", &mut file);
        assert_eq!(layout.from_tensors(&file, "x", "").unwrap(), values);
    }

    #[test]
    fn initial_values_fill_their_ranges() {
        let mut config = Config::default();
        config.encoder.plane_size = 64;
        let layout = Layout::new(&config);
        let values = layout.initial(&config);
        for slot in &layout.slots {
            let bound = match slot.name.as_str() {
                "planes" => 0.01,
                _ => (6.0 / (slot.shape[0] + slot.shape[1]) as f64).sqrt(),
            };
            let part = &values[slot.range.clone()];
            let mean = part.iter().map(|&x| f64::from(x)).sum::<f64>() / part.len() as f64;
            let variance = part.iter().map(|&x| f64::from(x).powi(2)).sum::<f64>() / part.len() as f64;
            assert!(part.iter().all(|x| f64::from(x.abs()) <= bound * 1.000_001));
            // A uniform distribution has variance bound²/3; the tolerance is four standard errors.
            let n = (part.len() as f64).sqrt();
            assert!(mean.abs() < 4.0 * bound / n, "{}", slot.name);
            assert!((variance / (bound * bound / 3.0) - 1.0).abs() < 4.0 / n, "{}", slot.name);
        }
    }
}
