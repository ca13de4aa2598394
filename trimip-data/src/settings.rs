//! The settings of this crate: how photographs are found, read and stored, and the built-in scene. The tables in
//! `settings/` hold their defaults, ranges and meanings. They share the section `[data]` with settings of trimip-core.

use serde::{Deserialize, Serialize};
use trimip_core::config::Convention;

/// Where the photographs are and how they are read: the section `[data]`, with core's settings in it.
///
/// ```toml
#[doc = include_str!("settings/photographs.toml")]
/// ```
///
/// ```toml
#[doc = include_str!("settings/builtin.toml")]
/// ```
///
/// ```toml
#[doc = include_str!("settings/pixels.toml")]
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the tables above and core's document the fields")]
pub struct DataConfig {
    pub root: String,
    pub origin: Vec<f64>,
    pub format: String,
    pub images: String,
    pub train: Vec<String>,
    pub test: String,
    pub holdout: u32,
    pub holdout_by: HoldoutBy,
    pub test_list: String,
    pub lens: bool,
    pub masks: String,
    pub mask_keeps: MaskKeeps,
    pub mask_role: MaskRole,
    pub depths: bool,
    pub realign: bool,
    pub scales: u32,
    pub convention: Convention,
    pub edge_exponents: Vec<f32>,
    pub background: [f32; 3],
    pub builtin_size: u32,
    pub builtin_train: u32,
    pub builtin_test: u32,
    pub builtin_supersampling: u32,
    pub builtin_finish: Finish,
    pub most_pixels: f64,
    pub pixels: PixelStore,
}

impl Default for DataConfig {
    /// Returns the values of the tables.
    fn default() -> Self {
        let section = trimip_core::Config::default().section();
        section.unwrap_or_else(|error| unreachable!("the tables are tested: {error}"))
    }
}

impl DataConfig {
    /// Describes the frames that a model is tested on.
    pub fn tested_on(&self) -> String {
        let train = self.train.join(" + ");
        match (self.holdout, self.holdout_by) {
            (0, _) if !self.test_list.is_empty() => format!("the frames of {}", self.test_list),
            (0, HoldoutBy::Stride) => self.test.clone(),
            (0, HoldoutBy::Sector) => format!("one sector of the cameras of {train}, held out"),
            (every, HoldoutBy::Stride) => format!("one frame in {every} of {train}, held out"),
            (every, HoldoutBy::Sector) => {
                format!("one frame in {every} of {train}, held out as one sector of the cameras")
            }
        }
    }
}

/// Which frames are held out for testing.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum HoldoutBy {
    /// Every n-th frame.
    Stride,
    /// The same number of frames, but those of the cameras nearest to the first one.
    Sector,
}

/// The colour of a mask that marks what is kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaskKeeps {
    /// White, except in Instant-NGP's `dynamic_mask_*`.
    Auto,
    /// White.
    White,
    /// Black.
    Black,
}

/// Meaning of the pixels that a mask does not keep.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum MaskRole {
    /// Empty space for masks of a folder, unknown for `mask_path` and `dynamic_mask_*`.
    Auto,
    /// Empty space: the mask is the photograph's alpha.
    Object,
    /// Unknown: the pixels are neither trained nor evaluated.
    Ignore,
}

/// Where decoded training photographs are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PixelStore {
    /// In memory if they take less than half of what is available, otherwise in a file.
    Auto,
    /// In memory.
    Memory,
    /// In a file without a name in the system's temporary folder.
    Disk,
}

/// View dependence of the built-in scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Finish {
    /// Some surfaces are glossy.
    Mixed,
    /// No surface is glossy: every point has one colour.
    Matt,
    /// All surfaces are glossy.
    Lacquered,
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::{Config, Definitions, Settings};

    #[test]
    fn settings_out_of_range_are_refused_with_their_place() {
        for (assignment, expected) in [
            ("data.train=[\"train\", \"train\"]", "each split once"),
            ("data.train=[]", "at least one split"),
            ("data.holdout=1", "2 and more"),
            ("data.holdout_by=\"azimuth\"", "sector"),
            ("data.builtin_size=7", "8 to 4096"),
            ("data.format=\"raw\"", "blender"),
        ] {
            let mut settings = Settings::of(Definitions::new(&[crate::SECTION], &[]).into());
            settings.apply_assignment(assignment).unwrap();
            let error = Config::from_settings(&settings).unwrap_err();
            assert_eq!(error.kind(), trimip_core::ErrorKind::Input);
            assert!(error.message().starts_with("command line: data."), "{error}");
            assert!(error.message().contains(expected), "{assignment}: {error}");
        }
    }

    #[test]
    fn the_section_has_core_s_settings_too() {
        let mut config = Config::default();
        config.data.scales = 2;
        config.change(|data: &mut DataConfig| data.background = [0.0, 0.5, 1.0]).unwrap();
        let data = config.section::<DataConfig>().unwrap();
        assert_eq!((data.scales, data.background), (2, config.data.background));
        assert_eq!(config.data.background, [0.0, 0.5, 1.0]);
    }
}
