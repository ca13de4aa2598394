//! The settings of this backend. Their defaults and meanings are in the table `settings.toml`.

use serde::{Deserialize, Serialize};
use trimip_core::{ForeignSection, Fragment, Section};

/// The settings of this backend, which a program can register.
pub const SECTION: ForeignSection = ForeignSection::of::<WgpuConfig>();

/// The GPU: the section `[wgpu]`.
///
/// ```toml
#[doc = include_str!("settings.toml")]
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
#[expect(missing_docs, reason = "the table above documents the fields")]
pub struct WgpuConfig {
    pub adapter: String,
    pub deterministic: bool,
    pub photographs: Photographs,
}

impl Section for WgpuConfig {
    const NAME: &'static str = "wgpu";
    const FRAGMENTS: &'static [Fragment] = &[Fragment { after: "", table: include_str!("settings.toml") }];
}

/// Where a GPU backend keeps the training photographs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Photographs {
    /// On the device if they fit into one binding, otherwise on the host.
    Auto,
    /// On the device.
    Device,
    /// On the host; the pixels of each step are uploaded.
    Host,
}
