//! A model's proxy in the form that a renderer uses.

use super::{Layers, Proxy, Rule};
use crate::{
    Result,
    config::{HybridConfig, HybridRule, RendererKind},
    field::model::Assets,
};

/// A proxy, and the rules that choose samples from its densities.
#[derive(Clone, Debug)]
pub struct Guide {
    /// The densities.
    pub proxy: Proxy,
    /// The rule by which samples are chosen and share colours.
    pub rule: Rule,
    /// The paper's rule, if that rule places the samples.
    pub layers: Option<Layers>,
    /// Length of a step through the proxy, in world units.
    pub step: f32,
    /// Largest radius of a sphere for which the proxy is used, in world units.
    pub widest: f32,
    /// Optical depth and opacity of a step, indexed by the code of the cell in which it lies.
    pub steps: Vec<[f32; 2]>,
}

impl Guide {
    /// Creates the guide of a model with these assets. Returns `None` for volume rendering, or if the assets have no
    /// proxy or an empty one.
    ///
    /// # Errors
    /// When the proxy is broken.
    pub fn of(kind: RendererKind, config: &HybridConfig, assets: &Assets) -> Result<Option<Self>> {
        if kind == RendererKind::Volume {
            return Ok(None);
        }
        let Some(proxy) = Proxy::from_assets(assets)?.filter(|proxy| !proxy.codes().is_empty()) else {
            return Ok(None);
        };
        let step = config.step * proxy.width();
        let rule = Rule {
            shared_weight: config.shared_weight,
            least: config.least,
            reach: config.reach * proxy.width(),
            opaque: config.opaque,
        };
        let steps =
            proxy.densities().iter().map(|density| density * step).map(|depth| [depth, -(-depth).exp_m1()]);
        let layers = (config.rule == HybridRule::Layers).then(|| Layers {
            delta: config.delta * proxy.width(),
            samples: config.samples,
            layers: config.layers,
            surface: config.surface * config.step,
            step,
        });
        let widest = config.widest * proxy.radius();
        Ok(Some(Self { rule, layers, step, widest, steps: steps.collect(), proxy }))
    }
}
