//! Settings of the encoders: the encoders' names, the sections that belong to each of them, and the accepted ranges.

use super::choices::{Decomposition, LevelFormula, PlaneShape};
use super::sections::section;
use crate::{
    Result,
    config::{schedule::Schedule, settings::checker::Checker},
};
use serde::{Deserialize, Serialize};

/// Names of the encoders.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EncoderKind {
    /// Three mip-mapped feature planes (Tri-MipRF), settings in `[encoder]`.
    TriMip,
    /// Multiresolution hash grid (instant-ngp), settings in `[hash_grid]`.
    HashGrid,
    /// Planes of several directions with ripmaps (Rip-NeRF), settings in `[rip_map]`.
    RipMap,
    /// Factored tensors (TensoRF), settings in `[tensor]`.
    Tensor,
    /// Positional encoding (NeRF), plain or integrated (mip-NeRF), settings in `[frequencies]`.
    Frequencies,
    /// Grid of densities and spherical harmonics (Plenoxels), settings in `[voxels]`.
    Voxels,
}

impl EncoderKind {
    /// Returns the name as a configuration writes it, in quotation marks.
    pub fn name(self) -> String {
        toml::Value::try_from(self).map_or_else(|_| format!("{self:?}"), |name| name.to_string())
    }

    /// Returns true if the setting with this dotted path does not belong to another encoder.
    pub fn takes(self, path: &str) -> bool {
        Self::owner(path).is_none_or(|owner| owner == self)
    }

    /// Returns the encoder that owns a setting, given its dotted path; `None` for settings that all encoders share.
    pub(super) fn owner(path: &str) -> Option<Self> {
        match path.split_once('.') {
            Some(("encoder", "kind")) => None,
            Some(("encoder", _) | ("optimizer", "plane_scale")) => Some(Self::TriMip),
            Some(("hash_grid", _)) => Some(Self::HashGrid),
            Some(("rip_map", _)) => Some(Self::RipMap),
            Some(("tensor", _)) => Some(Self::Tensor),
            Some(("frequencies", _)) => Some(Self::Frequencies),
            Some(("voxels", _)) => Some(Self::Voxels),
            _ => None,
        }
    }
}

section!(
    /// The encoder, and the planes of the tri-mip encoder.
    EncoderConfig, "encoder" {
        kind: EncoderKind, plane_size: u32, shape: PlaneShape, levels: u32, mipmap: bool, level: LevelFormula,
        level_bias: f32, level_input: bool, init_range: f32, halvings: Schedule,
    }
);
section!(
    /// The multiresolution hash grid.
    HashGridConfig, "hash_grid" {
        levels: u32, features: u32, log2_entries: u32, coarsest: u32, finest: u32, inactive_levels: Schedule, points: u32, downweight: bool, init_range: f32, rate: f64,
    }
);
section!(
    /// The planes of several directions with ripmaps.
    RipMapConfig, "rip_map" {
        planes: u32, size: u32, levels: u32, level_bias: f32, init_range: f32, rate: f64,
    }
);

section!(
    /// The positional encoding.
    FrequenciesConfig, "frequencies" { count: u32, integrated: bool, identity: bool }
);
section!(
    /// The factors of the tensors.
    TensorConfig, "tensor" {
        decomposition: Decomposition, density_components: u32, color_components: u32, sides: Schedule, init_deviation: f32, rate: f64,
        sparsity: [f32; 2],
    }
);

section!(
    /// The grid of voxels.
    VoxelsConfig, "voxels" { sides: Schedule, harmonics: u32, density_rate: f64, color_rate: f64 }
);

/// Required form of a coarse-to-fine schedule, for error messages.
const FALLING: &str = "[[0.0, n], ... [fraction, 0]] with rising fractions below 1 and falling whole numbers";

impl EncoderConfig {
    pub(super) fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(self.halvings.falls_to_zero(), "encoder.halvings", FALLING)?;
        let unit = self.texel_unit();
        to.together(
            self.plane_size.is_multiple_of(unit),
            &["encoder.plane_size", "encoder.levels", "encoder.halvings"],
            &format!("a multiple of {unit} from 4 to 4096, so that {} levels halve evenly", self.levels),
        )
    }

    /// Returns the unit of `plane_size`: multiples of it halve evenly for every mip level and every halving.
    pub fn texel_unit(&self) -> u32 {
        let halvings = self.halvings.values().fold(0.0, f64::max) as u32;
        1 << self.levels.saturating_sub(1).max(halvings).min(31)
    }
}

impl HashGridConfig {
    pub(super) fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check([1, 2, 4, 8].contains(&self.features), "hash_grid.features", "1, 2, 4 or 8")?;
        to.check([1, 6].contains(&self.points), "hash_grid.points", "1 or 6")?;
        to.check(self.coarsest <= self.finest, "hash_grid.finest", "hash_grid.coarsest to 65536")?;
        to.check(self.inactive_levels.falls_to_zero(), "hash_grid.inactive_levels", FALLING)
    }

    /// Returns the number of levels that are in use at `progress` in [0, 1], counted from the coarsest; at least 1.
    pub fn active_at(&self, progress: f64) -> u32 {
        self.levels.saturating_sub(self.inactive_levels.at(progress) as u32).max(1)
    }
}

impl RipMapConfig {
    pub(super) fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check([3, 4, 6, 10].contains(&self.planes), "rip_map.planes", "3, 4, 6 or 10")
    }
}

impl TensorConfig {
    pub(super) fn check(&self, to: &Checker<'_>) -> Result<()> {
        for (count, path) in [
            (self.density_components, "tensor.density_components"),
            (self.color_components, "tensor.color_components"),
        ] {
            to.check(count.is_multiple_of(16), path, "a multiple of 16 from 16 to 512")?;
        }
        to.check(rising(&self.sides), "tensor.sides", &sides_from_2_to(1024))
    }
}

impl VoxelsConfig {
    pub(super) fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(rising(&self.sides), "voxels.sides", &sides_from_2_to(512))
    }
}

/// Returns true if the pieces cover the run and each has more grid points along a side than the piece before.
fn rising(sides: &Schedule) -> bool {
    let values = || sides.values();
    sides.is_whole() && values().all(|side| side.fract() == 0.0) && values().is_sorted_by(|a, b| a < b)
}

fn sides_from_2_to(most: u32) -> String {
    format!(
        "[[0.0, side], ... [fraction, side]] with rising fractions below 1 and rising whole numbers from 2 to {most}"
    )
}
