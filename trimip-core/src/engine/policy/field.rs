//! The policy of the field: the shapes of its networks, the inputs of the colour network, and the activation functions
//! of their outputs.

use crate::{
    Config,
    config::FieldConfig,
    field::{
        activation::{Color, Density},
        networks::{Network, color_network, density_network, geometry, geometry_width, view_width},
    },
};

/// Settings of a field and the shapes of its networks.
#[derive(Clone, Debug, PartialEq)]
pub struct FieldPolicy {
    /// The settings.
    pub settings: FieldConfig,
    /// The network from features to a logit and the geometry features.
    pub density: Network,
    /// The network from the view and the geometry features to colour.
    pub color: Network,
    /// Number of inputs that the colour network gets from a direction; 0 if it takes no direction.
    pub view: usize,
    /// Number of geometry features.
    pub geometry: usize,
    /// Number of inputs that the colour network gets from the geometry features, including their sines and cosines.
    pub geometry_width: usize,
    /// Maps a logit to a density.
    pub density_activation: Density,
    /// Maps logits to a colour.
    pub color_activation: Color,
}

impl FieldPolicy {
    /// Creates the policy of a configuration.
    pub fn new(config: &Config) -> Self {
        Self {
            settings: config.field.clone(),
            density: density_network(config),
            color: color_network(config),
            view: view_width(config),
            geometry: geometry(config),
            geometry_width: geometry_width(config),
            density_activation: Density::new(&config.field),
            color_activation: Color::new(config),
        }
    }

    /// Returns true if there are no networks; the features are then the logits, density before colour.
    pub fn is_direct(&self) -> bool {
        self.density.layers.is_empty() && self.color.layers.is_empty()
    }

    /// Returns the number of frequencies of the sines and cosines of geometry features; 0 without networks.
    pub fn geometry_frequencies(&self) -> u32 {
        if self.is_direct() { 0 } else { self.settings.geometry_frequencies }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::EncoderKind;

    #[test]
    fn a_field_of_logits_has_no_networks() {
        let mut config = Config::default();
        config.field.geometry_frequencies = 2;
        let policy = FieldPolicy::new(&config);
        let width = policy.geometry * (1 + 2 * 2);
        assert_eq!((policy.is_direct(), policy.geometry_width), (false, width));
        assert_eq!((policy.geometry_frequencies(), policy.color.inputs()), (2, policy.view + width));
        config.encoder.kind = EncoderKind::Voxels;
        let policy = FieldPolicy::new(&config);
        assert_eq!((policy.is_direct(), policy.geometry, policy.view), (true, 3, 0));
        assert_eq!(policy.geometry_frequencies(), 0);
    }
}
