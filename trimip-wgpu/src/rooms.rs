//! How many samples arrays have room for: fixed before the first step, so that memory can be predicted.

use crate::field::padded;
use crate::rows::BLOCK;
use trimip_core::params::{color_layers, density_layers};
use trimip_core::{Config, encoders};

/// Marched samples that a training step has room for, for each sample it aims to keep.
const MARCHED_PER_AIM: usize = 4;

/// Kept samples that a training step has room for, for each that it aims to keep.
const KEPT_PER_AIM: usize = 2;

/// Samples of a span of a view.
pub const VIEW_SAMPLES: usize = 1 << 20;

/// Samples that a span must have room for: one ray through the whole box.
pub const LEAST_ROOM: usize = 4096;

/// Samples that a span has room for, and those of them that it has room to keep, on a device that binds at most `binding`
/// bytes at once.
pub fn rooms(config: &Config, training: bool, binding: u64) -> (usize, usize) {
    let widest = (size_of::<f32>() * widest_row(config)) as u64;
    // Whole blocks, as arrays have them.
    let most = usize::try_from(binding / widest).unwrap_or(usize::MAX) / BLOCK * BLOCK;
    let wanted = config.train.samples_per_step as usize;
    let marched = if training { (MARCHED_PER_AIM * wanted).max(LEAST_ROOM) } else { VIEW_SAMPLES }.min(most);
    let kept =
        if training { (KEPT_PER_AIM * wanted).clamp(LEAST_ROOM, marched.max(LEAST_ROOM)) } else { marched };
    (marched, kept.min(marched))
}

/// Floats of the widest row that a sample has.
fn widest_row(config: &Config) -> usize {
    let layers = [density_layers(config), color_layers(config)].concat();
    let widths = layers.into_iter().flatten().map(padded);
    widths.chain([encoders::stride(config)]).max().unwrap_or(BLOCK)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Arrays end with whole blocks of rows, and these too have to lie within what the device binds.
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
