//! The stages of Tri-MipRF on any GPU through wgpu: the place they will live. This build has none yet and says so.

use trimip_core::{Error, Result, Session, ViewSet, config::Config, model::Model};

/// Says that this build cannot train on a GPU.
pub fn open(config: &Config, _: ViewSet) -> Result<Box<dyn Session>> {
    Err(missing(&config.backend))
}

/// Says that this build cannot render on a GPU.
pub fn load(_: &Model) -> Result<Box<dyn Session>> {
    Err(missing("wgpu"))
}

/// One line: what is missing and what to do.
pub fn missing(backend: &str) -> Error {
    Error::input(
        format!("backend = \"{backend}\""),
        "this build has no wgpu backend yet",
        "set backend = \"cpu\"",
    )
}
