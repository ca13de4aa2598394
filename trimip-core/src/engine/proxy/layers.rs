//! The paper's rule (Tri-MipRF Section 3.4): uniform samples around each point where a ray enters a surface. A surface
//! begins where the optical depth that the proxy predicts for a step reaches a threshold; the paper uses a mesh
//! instead.

use super::{Chosen, Pick};

/// Samples around surfaces. Lengths are in world units.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Layers {
    /// Half the length of a layer: its samples lie within this distance of the surface.
    pub delta: f32,
    /// Number of samples per layer.
    pub samples: u32,
    /// Largest number of layers per ray.
    pub layers: u32,
    /// Threshold: a step with at least this predicted optical depth lies in a surface.
    pub surface: f32,
    /// Length of a step through the proxy.
    pub step: f32,
}

/// Places the samples of one ray, whose steps arrive front to back.
#[derive(Clone, Copy, Debug)]
pub struct Layering {
    rule: Layers,
    layers: u32,
    /// End of the last layer.
    end: f32,
    /// Distance of the last step in a surface.
    dense: f32,
}

impl Layering {
    /// Creates the state at the start of a ray.
    #[inline(always)]
    pub fn new(rule: Layers) -> Self {
        Self { rule, layers: 0, end: f32::NEG_INFINITY, dense: f32::NEG_INFINITY }
    }
}

impl Pick for Layering {
    #[inline(always)]
    fn step(&mut self, t: f32, depth: f32, _: f32, choose: &mut impl FnMut(Chosen)) -> bool {
        let Layers { delta, samples, layers, surface, step } = self.rule;
        if depth < surface {
            return false;
        }
        // Steps without a density do not arrive, so a gap since the last dense step means that a new surface begins.
        if t - self.dense > 1.5 * step {
            let first = (t - delta).max(self.end);
            self.end = t + delta;
            let length = (self.end - first) / samples as f32;
            for i in 0..samples {
                choose(Chosen { t: first + (i as f32 + 0.5) * length, own: 1.0, depth: length / step });
            }
            self.layers += 1;
        }
        self.dense = t;
        self.layers == layers
    }

    fn end(self, _: &mut impl FnMut(Chosen)) {}
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_entry_has_a_layer_and_layers_do_not_overlap() {
        let rule = Layers { delta: 2.0, samples: 4, layers: 3, surface: 0.5, step: 1.0 };
        // Surfaces begin at 10, 13 (within reach of the first), 30 and 50.
        let depth = |i: usize| if matches!(i, 10 | 11 | 13 | 30..35 | 50) { 1.0 } else { 0.1 };
        let mut found = Vec::new();
        let mut layering = Layering::new(rule);
        let mut choose = |chosen: Chosen| found.push((chosen.t, chosen.length(1.0)));
        let ended = (0..60).position(|i| layering.step(i as f32, depth(i), 0.5, &mut choose));
        layering.end(&mut choose);
        assert_eq!(ended, Some(30), "the third layer is the last one");
        let expected = [8.5, 9.5, 10.5, 11.5, 12.375, 13.125, 13.875, 14.625, 28.5, 29.5, 30.5, 31.5];
        assert_eq!(found.iter().map(|own| own.0).collect::<Vec<_>>(), expected);
        assert!(found.iter().all(|own| own.1 == if (12.0..15.0).contains(&own.0) { 0.75 } else { 1.0 }));
    }
}
