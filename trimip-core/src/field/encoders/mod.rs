//! The encoders by name. An encoder consists of a folder or file here (its declaration, its mathematics, its f64
//! reference), a file in each backend, and a line in `ALL`.

mod definition;
pub mod frequencies;
pub mod hash_grid;
pub mod rip_map;
pub mod tensor;
pub mod tri_mip;
pub mod voxels;

pub use definition::{Definition, Reference, SamplePosition};

use crate::{
    Config, Result,
    config::{EncoderKind, settings::checker::Checker},
    field::slot::ALIGNMENT,
};

/// All encoders.
const ALL: &[(EncoderKind, &dyn Definition)] = &[
    (EncoderKind::TriMip, &tri_mip::Planes),
    (EncoderKind::HashGrid, &hash_grid::HashGrid),
    (EncoderKind::RipMap, &rip_map::RipMap),
    (EncoderKind::Tensor, &tensor::Tensors),
    (EncoderKind::Frequencies, &frequencies::Frequencies),
    (EncoderKind::Voxels, &voxels::Voxels),
];

/// Returns the encoder of a configuration.
pub fn of(config: &Config) -> &'static dyn Definition {
    let own = ALL.iter().find(|(kind, _)| *kind == config.encoder.kind);
    own.map_or(ALL[0].1, |(_, definition)| *definition)
}

impl Config {
    /// Checks that the density network suits the encoder.
    pub(crate) fn check_density_of_encoder(&self, to: &Checker<'_>) -> Result<()> {
        to.together(
            self.field.density_layers == 0 || of(self).summed(self) == 0,
            &["field.density_layers", "encoder.kind"],
            "field.density_layers = 0 for an encoder whose features sum up to the density",
        )
    }
}

/// Returns the number of floats in a row of features: the encoder's width, padded to whole registers and tiles.
pub fn stride(config: &Config) -> usize {
    of(config).width(config).next_multiple_of(ALIGNMENT)
}
