//! Settings of the encoders: their names, the sections that belong to each, and the accepted ranges.

use super::checks::{Checker, finite_from_zero, positive};
use super::choices::{LevelFormula, PlaneShape};
use super::sections::section;
use crate::{Result, encoders::rip_map::MOST_LEVELS, schedule::Schedule};
use serde::{Deserialize, Serialize};

/// The encoders by name.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum EncoderKind {
    /// Three mip-mapped feature planes (Tri-MipRF), settings in `[encoder]`.
    TriMip,
    /// Multiresolution hash grid (instant-ngp), settings in `[hash_grid]`.
    HashGrid,
    /// Planes of several directions with ripmaps (Rip-NeRF), settings in `[rip_map]`.
    RipMap,
}

impl EncoderKind {
    /// Its name as in a configuration, in quotation marks.
    pub fn name(self) -> String {
        toml::Value::try_from(self).map_or_else(|_| format!("{self:?}"), |name| name.to_string())
    }

    /// True for settings, by dotted path, that do not belong to another encoder.
    pub fn takes(self, path: &str) -> bool {
        Self::owner(path).is_none_or(|owner| owner == self)
    }

    /// The encoder that a setting belongs to, by dotted path; `None` for the settings of all.
    pub(super) fn owner(path: &str) -> Option<Self> {
        match path.split_once('.') {
            Some(("encoder", "kind")) => None,
            Some(("encoder", _)) | Some(("optimizer", "plane_scale")) => Some(Self::TriMip),
            Some(("hash_grid", _)) => Some(Self::HashGrid),
            Some(("rip_map", _)) => Some(Self::RipMap),
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
        levels: u32, features: u32, log2_entries: u32, coarsest: u32, finest: u32, init_range: f32, rate: f64,
    }
);
section!(
    /// The planes of several directions with ripmaps.
    RipMapConfig, "rip_map" {
        planes: u32, size: u32, levels: u32, level_bias: f32, init_range: f32, rate: f64,
    }
);

impl EncoderConfig {
    pub(super) fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check(finite_from_zero(self.init_range.into()), "encoder.init_range", "0 or more")?;
        to.check(
            self.level_bias.is_finite() && self.level_bias.abs() <= 8.0,
            "encoder.level_bias",
            "-8 (sharper) to 8 (blurrier)",
        )?;
        let halvings = || self.halvings.values();
        to.check(
            self.halvings.is_whole()
                && halvings().all(|h| h.fract() == 0.0 && (0.0..=10.0).contains(&h))
                && halvings().is_sorted_by(|a, b| a > b)
                && halvings().last() == Some(0.0),
            "encoder.halvings",
            "[[0.0, n], ... [fraction, 0]] with rising fractions below 1 and falling whole numbers",
        )?;
        to.check((1..=13).contains(&self.levels), "encoder.levels", "1 to 13")?;
        let unit = self.texel_unit();
        to.check(
            (4..=4096).contains(&self.plane_size) && self.plane_size.is_multiple_of(unit),
            "encoder.plane_size",
            &format!("a multiple of {unit} from 4 to 4096, so that {} levels halve evenly", self.levels),
        )
    }

    /// The number that `plane_size` must be a multiple of, so that every mip level and every halving is even.
    pub fn texel_unit(&self) -> u32 {
        let halvings = self.halvings.values().fold(0.0, f64::max) as u32;
        1 << self.levels.saturating_sub(1).max(halvings).min(31)
    }
}

impl HashGridConfig {
    pub(super) fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check((1..=32).contains(&self.levels), "hash_grid.levels", "1 to 32")?;
        to.check([1, 2, 4, 8].contains(&self.features), "hash_grid.features", "1, 2, 4 or 8")?;
        to.check((8..=24).contains(&self.log2_entries), "hash_grid.log2_entries", "8 to 24")?;
        to.check((2..=4096).contains(&self.coarsest), "hash_grid.coarsest", "2 to 4096")?;
        to.check(
            (self.coarsest..=65_536).contains(&self.finest),
            "hash_grid.finest",
            "hash_grid.coarsest to 65536",
        )?;
        to.check(finite_from_zero(self.init_range.into()), "hash_grid.init_range", "0 or more")?;
        to.check(positive(self.rate), "hash_grid.rate", "a number above 0")
    }
}

impl RipMapConfig {
    pub(super) fn check(&self, to: &Checker<'_>) -> Result<()> {
        to.check([3, 4, 6, 10].contains(&self.planes), "rip_map.planes", "3, 4, 6 or 10")?;
        to.check((1..=MOST_LEVELS).contains(&self.levels), "rip_map.levels", &format!("1 to {MOST_LEVELS}"))?;
        to.check((4..=4096).contains(&self.size), "rip_map.size", "4 to 4096")?;
        to.check(
            self.level_bias.is_finite() && self.level_bias.abs() <= 8.0,
            "rip_map.level_bias",
            "-8 (sharper) to 8 (blurrier)",
        )?;
        to.check(finite_from_zero(self.init_range.into()), "rip_map.init_range", "0 or more")?;
        to.check(positive(self.rate), "rip_map.rate", "a number above 0")
    }
}
