//! The number of samples that fit into the arrays. It is fixed before the first step, so that memory can be predicted.

use crate::gpu::BLOCK;
use crate::products::padded;
use trimip_core::field::params::{color_layers, density_layers};
use trimip_core::{Config, field::encoders};

/// Capacity for marched samples in a training step, per sample that the step aims to keep.
const MARCHED_PER_AIM: usize = 4;

/// Capacity for kept samples in a training step, per sample that the step aims to keep.
const KEPT_PER_AIM: usize = 2;

/// Capacity for samples in a tile of a view.
pub const VIEW_SAMPLES: usize = 1 << 20;

/// Minimum capacity for samples in a tile: one ray through the whole box.
pub const LEAST_CAPACITY: usize = 4096;

/// Number of samples that fit into the arrays of a tile.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Capacity {
    /// Marched samples.
    pub marched: usize,
    /// Kept samples; at most as many as marched samples.
    pub kept: usize,
}

impl Capacity {
    /// Computes the capacity of a tile on a device whose largest binding has `binding` bytes.
    pub fn new(config: &Config, training: bool, binding: u64) -> Self {
        let widest = (size_of::<f32>() * widest_row(config)) as u64;
        // Rounded down to whole blocks, because arrays are padded to whole blocks.
        let most = usize::try_from(binding / widest).unwrap_or(usize::MAX) / BLOCK * BLOCK;
        if !training {
            let marched = VIEW_SAMPLES.min(most);
            return Self { marched, kept: marched };
        }
        let wanted = config.train.samples_per_step as usize;
        let marched = (MARCHED_PER_AIM * wanted).max(LEAST_CAPACITY).min(most);
        let kept = (KEPT_PER_AIM * wanted).clamp(LEAST_CAPACITY, marched.max(LEAST_CAPACITY));
        Self { marched, kept: kept.min(marched) }
    }
}

/// Returns the number of floats in the widest row of a sample.
fn widest_row(config: &Config) -> usize {
    let layers = [density_layers(config), color_layers(config)].concat();
    let widths = layers.into_iter().flatten().map(padded);
    widths.chain([encoders::stride(config)]).max().unwrap_or(BLOCK)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks that the arrays fit into the device's largest binding together with their padding, which fills whole
    /// blocks of rows.
    #[test]
    fn the_capacity_fits_a_binding() {
        let mut config = Config::default();
        for binding in [128 << 20, (1 << 31) - 4, u64::from(u32::MAX)] {
            for hidden in (16..=512).step_by(16) {
                config.field.hidden = hidden;
                for (samples, training) in [(262_144, true), (1 << 20, true), (1024, false)] {
                    config.train.samples_per_step = samples;
                    let Capacity { marched, kept } = Capacity::new(&config, training, binding);
                    let bytes = marched.next_multiple_of(BLOCK) * widest_row(&config) * 4;
                    assert!(bytes as u64 <= binding && kept <= marched, "{hidden} {samples} {binding}");
                }
            }
        }
    }
}
