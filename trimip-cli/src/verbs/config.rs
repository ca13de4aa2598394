//! `config`: the effective settings with their origins, or the documented table of defaults.

use crate::{args::ConfigArguments, settings, terminal};
use trimip::Result;

/// Prints settings as TOML.
pub fn run(arguments: &ConfigArguments) -> Result<u8> {
    if arguments.defaults {
        terminal::line(trimip::settings::definitions().text().trim_end());
    } else {
        let (settings, _) = settings::load_scene(&arguments.scene, &arguments.settings)?;
        terminal::line(trimip::settings::text(&settings).trim_end());
    }
    Ok(0)
}
