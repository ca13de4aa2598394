//! `data`: inspect a data set, write it at several scales, write the built-in scene.

use crate::{
    args::{DataAction, DataArguments, SettingsArguments},
    progress::by_rows,
    settings, terminal,
};
use std::path::Path;
use trimip::{Config, Error, Result, run::folder as run_folder};
use trimip_data::Watch;

/// Runs the selected action.
pub fn run(arguments: &DataArguments) -> Result<u8> {
    match &arguments.action {
        DataAction::Inspect { root, settings } => {
            let config = with_root(settings, root.as_deref())?;
            let lines = by_rows("reading photographs", |watch| trimip_data::inspect(&config.data, watch))?;
            lines.iter().for_each(terminal::prose);
        }
        DataAction::Multiscale { out, root, settings } => {
            let config = with_root(settings, root.as_deref())?;
            run_folder::create_writable(out)?;
            let write = |watch: Watch<'_>| trimip_data::write_multiscale(&config.data, out, watch);
            terminal::line(by_rows("writing photographs", write)?);
        }
        DataAction::Builtin { out, settings } => {
            let (_, config) = settings::load(settings)?;
            run_folder::create_writable(out)?;
            let write = |watch: Watch<'_>| trimip_data::write_builtin(&config.data, out, watch);
            terminal::line(by_rows("rendering photographs", write)?);
        }
    }
    Ok(0)
}

fn with_root(arguments: &SettingsArguments, root: Option<&Path>) -> Result<Config> {
    let (_, mut config) = settings::load(arguments)?;
    if let Some(root) = root {
        config.data.root = root
            .to_str()
            .ok_or_else(|| Error::input(root.display(), "the path is not UTF-8", "rename the folder"))?
            .to_string();
    }
    Ok(config)
}
