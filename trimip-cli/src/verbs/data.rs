//! `data`: inspects a data set, writes it at several scales, or writes the built-in scene.

use crate::{
    args::{DataAction, DataArguments, SettingsArguments},
    progress::by_rows,
    settings, terminal,
};
use std::path::Path;
use trimip::{Config, Result, Settings, inspect, run::folder as run_folder};
use trimip_data::Watch;

/// Runs the selected action.
pub fn run(arguments: &DataArguments) -> Result<u8> {
    match &arguments.action {
        DataAction::Inspect { root, html, settings } => {
            let (settings, _) = with_root(settings, root.as_deref())?;
            let seen = by_rows("reading photographs", |watch| inspect::inspect(settings, watch))?;
            seen.lines().iter().for_each(terminal::prose);
            if let Some(path) = html {
                trimip_report::save(path, &trimip_report::inspect::page(&seen)?)?;
            }
        }
        DataAction::Multiscale { out, root, settings } => {
            let (_, config) = with_root(settings, root.as_deref())?;
            run_folder::create_writable(out)?;
            let write = |watch: Watch<'_>| trimip_data::write_multiscale(&config.section()?, out, watch);
            terminal::line(by_rows("writing photographs", write)?);
        }
        DataAction::Builtin { out, settings } => {
            let (_, config) = settings::load(settings)?;
            run_folder::create_writable(out)?;
            let write = |watch: Watch<'_>| trimip_data::write_builtin(&config.section()?, out, watch);
            terminal::line(by_rows("rendering photographs", write)?);
        }
    }
    Ok(0)
}

fn with_root(arguments: &SettingsArguments, root: Option<&Path>) -> Result<(Settings, Config)> {
    let (mut given, _) = settings::load(arguments)?;
    if let Some(root) = root {
        // If the folder is missing, opening it reports the error, because this argument cannot be a mistyped verb.
        let root = match root.exists() {
            true => settings::scene_root(root)?,
            false => root.display().to_string(),
        };
        given.set("data.root", root)?;
    }
    let config = Config::from_settings(&given)?;
    Ok((given, config))
}
