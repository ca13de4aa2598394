//! The tri-mip planes as an encoder: their declaration and their f64 reference.

use super::{CHANNELS, FEATURES, PLANE_AXES, Pyramid, grow, level_input, sides, taps};
use crate::field::encoders::definition::{Definition, Reference, SamplePosition};
use crate::{Aabb, Config, Slot};

/// Three mip-mapped feature planes (Tri-MipRF). Each stage of growth halves the planes' sides once more.
pub struct Planes;

fn pyramid(config: &Config) -> Pyramid {
    Pyramid::new(&config.encoder, &Aabb::new(&config.scene))
}

impl Definition for Planes {
    fn describe(&self, config: &Config) -> String {
        let encoder = &config.encoder;
        let mut sides = pyramid(config).sides;
        sides.sort();
        let sizes = match sides {
            [x, _, z] if x == z => format!("3 planes of {x}×{x}×{CHANNELS}"),
            [_, y, z] => format!("3 planes of up to {y}×{z}×{CHANNELS}"),
        };
        match (encoder.mipmap, encoder.levels) {
            (false, _) => format!("{sizes} with no mipmap"),
            (true, 1) => format!("{sizes} with 1 mip level"),
            (true, levels) => format!("{sizes} with {levels} mip levels"),
        }
    }

    fn width(&self, config: &Config) -> usize {
        FEATURES + usize::from(config.encoder.level_input)
    }

    fn slots(&self, config: &Config) -> Vec<Slot> {
        let shape = match sides(&config.encoder, &Aabb::new(&config.scene)) {
            [x, y, z] if x == y && y == z => vec![3, x, x, CHANNELS],
            // Planes YZ, XZ and XY, one after the other, each row by row.
            [x, y, z] => vec![y * z + x * z + x * y, CHANNELS],
        };
        vec![Slot {
            rate: config.optimizer.plane_scale,
            group: Some(CHANNELS),
            precision: config.file.planes,
            grows: true,
            ..Slot::new("planes", shape, config.encoder.init_range)
        }]
    }

    fn derived_bytes(&self, config: &Config) -> u64 {
        (2 * pyramid(config).derived_len() * size_of::<f32>()) as u64
    }

    fn stage(&self, config: &Config, progress: f64) -> u32 {
        config.encoder.halvings.at(progress) as u32
    }

    fn length(&self, _: &Config, slot: &Slot, stage: u32) -> usize {
        slot.range.len() >> (2 * stage)
    }

    fn grow(&self, config: &Config, _: &Slot, values: &mut [f32], from: u32, to: u32) {
        grow(values, &pyramid(config), from, to);
    }

    fn lowered_by(&self) -> &'static str {
        "lower encoder.plane_size"
    }

    fn reference(&self, config: &Config, mut values: Vec<Vec<f64>>) -> Box<dyn Reference> {
        let (pyramid, base) = (pyramid(config), values.swap_remove(0));
        let level_input = config.encoder.level_input;
        Box::new(PlanesTwin { derived: averages(&pyramid, &base), base, pyramid, level_input })
    }
}

/// The planes in f64.
struct PlanesTwin {
    pyramid: Pyramid,
    /// Level 0; `derived` holds the levels above it in one array.
    base: Vec<f64>,
    derived: Vec<f64>,
    /// True if the level of a sample is its last feature.
    level_input: bool,
}

/// Computes the levels above the base: means of 2×2 texels.
fn averages(pyramid: &Pyramid, base: &[f64]) -> Vec<f64> {
    let mut derived = vec![0.0; pyramid.derived_len()];
    for level in 1..pyramid.levels {
        for plane in 0..3 {
            let (shape, to) = (pyramid.shape(level, plane), pyramid.offset(level, plane));
            let from = pyramid.offset(level - 1, plane);
            for i in 0..shape.texels() * CHANNELS {
                let (texel, channel) = (i / CHANNELS, i % CHANNELS);
                let (row, column) = (texel / shape.columns, texel % shape.columns);
                let child = |j: usize, k: usize| {
                    let at = (2 * row + j) * 2 * shape.columns + 2 * column + k;
                    let finer = if level == 1 { base } else { &derived };
                    finer[from + at * CHANNELS + channel]
                };
                derived[to + i] = 0.25 * (child(0, 0) + child(0, 1) + child(1, 0) + child(1, 1));
            }
        }
    }
    derived
}

impl Reference for PlanesTwin {
    fn features(&self, at: &SamplePosition) -> Vec<f64> {
        let mut features = vec![0.0; FEATURES];
        for (plane, [a, b]) in PLANE_AXES.into_iter().enumerate() {
            let blend = self.pyramid.blend(plane, at.radius.log2());
            for (level, level_weight) in
                [(blend.lower, 1.0 - blend.fraction), (blend.lower + 1, blend.fraction)]
            {
                if level_weight == 0.0 {
                    continue;
                }
                let shape = self.pyramid.shape(level, plane);
                let levels = if level == 0 { &self.base } else { &self.derived };
                let texels = &levels[self.pyramid.range(level, plane)];
                let taps = taps(shape, at.position[a], at.position[b]);
                for (row, weights) in taps.rows.into_iter().zip(taps.weights) {
                    for (column, weight) in taps.columns.into_iter().zip(weights) {
                        let texel = &texels[(row * shape.columns + column) * CHANNELS..][..CHANNELS];
                        let out = &mut features[plane * CHANNELS..][..CHANNELS];
                        out.iter_mut()
                            .zip(texel)
                            .for_each(|(sum, value)| *sum += level_weight * weight * value);
                    }
                }
            }
        }
        if self.level_input {
            features.push(level_input(at.radius.log2(), self.pyramid.reference()));
        }
        features
    }
}
