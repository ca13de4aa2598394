//! The number of samples that arrays have room for. It is fixed before the first step, so that memory can be
//! predicted.

use crate::mlp::padded;
use crate::rows::BLOCK;
use trimip_core::params::{color_layers, density_layers};
use trimip_core::{Config, encoders};

/// Room for marched samples in a training step, per sample that the step aims to keep.
const MARCHED_PER_AIM: usize = 4;

/// Room for kept samples in a training step, per sample that the step aims to keep.
const KEPT_PER_AIM: usize = 2;

/// Room for samples in a span of a view.
pub const VIEW_SAMPLES: usize = 1 << 20;

/// Minimum room for samples in a span: one ray through the whole box.
pub const LEAST_ROOM: usize = 4096;

/// Room for marched samples in a span, and for kept ones, on a device whose largest binding has `binding` bytes.
pub fn rooms(config: &Config, training: bool, binding: u64) -> (usize, usize) {
    let widest = (size_of::<f32>() * widest_row(config)) as u64;
    // Whole blocks, because arrays are padded to them.
    let most = usize::try_from(binding / widest).unwrap_or(usize::MAX) / BLOCK * BLOCK;
    let wanted = config.train.samples_per_step as usize;
    let marched = if training { (MARCHED_PER_AIM * wanted).max(LEAST_ROOM) } else { VIEW_SAMPLES }.min(most);
    let kept =
        if training { (KEPT_PER_AIM * wanted).clamp(LEAST_ROOM, marched.max(LEAST_ROOM)) } else { marched };
    (marched, kept.min(marched))
}

/// Floats in the widest row of a sample.
fn widest_row(config: &Config) -> usize {
    let layers = [density_layers(config), color_layers(config)].concat();
    let widths = layers.into_iter().flatten().map(padded);
    widths.chain([encoders::stride(config)]).max().unwrap_or(BLOCK)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Arrays are padded to whole blocks of rows; the padding too has to fit into the device's largest binding.
    #[test]
    fn rooms_fit_a_binding() {
        let mut config = Config::default();
        for binding in [128 << 20, (1 << 31) - 4, u64::from(u32::MAX)] {
            for hidden in (16..=512).step_by(16) {
                config.field.hidden = hidden;
                for (samples, training) in [(262_144, true), (1 << 20, true), (1024, false)] {
                    config.train.samples_per_step = samples;
                    let (marched, kept) = rooms(&config, training, binding);
                    let bytes = marched.next_multiple_of(BLOCK) * widest_row(&config) * 4;
                    assert!(bytes as u64 <= binding && kept <= marched, "{hidden} {samples} {binding}");
                }
            }
        }
    }
}
