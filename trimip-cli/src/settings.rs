//! From the command line to checked settings, and their printed form: aligned `key = value` lines with what each means
//! and where its value came from, in the order of the documented table of defaults.

use crate::args::SettingsArguments;
use std::path::Path;
use trimip_core::{Config, DEFAULTS, Error, Origin, Result, Settings, model::Model};

/// Settings of a configuration file and the command line, every range checked.
pub fn load(arguments: &SettingsArguments) -> Result<(Settings, Config)> {
    let mut settings = Settings::defaults();
    if let Some(path) = &arguments.config {
        let text = std::fs::read_to_string(path).map_err(|error| {
            Error::input(
                path.display(),
                error,
                "name an existing configuration file, such as configs/quickstart.toml",
            )
        })?;
        settings.apply_file(&path.display().to_string(), &text)?;
    }
    for assignment in &arguments.set {
        settings.apply_assignment(assignment)?;
    }
    let config = Config::from_settings(&settings)?;
    Ok((settings, config))
}

/// Lays assignments over the configuration of a finished model. What belongs to the model itself cannot be changed.
pub fn override_model(model: &mut Model, assignments: &[String]) -> Result<()> {
    let mut settings = Settings::defaults();
    settings.apply_file("model", &model.config.to_toml())?;
    for assignment in assignments {
        settings.apply_assignment(assignment)?;
        let key = assignment.split('=').next().unwrap_or_default().trim();
        let section = key.split('.').next().unwrap_or_default();
        if !["data", "eval", "renderer", "backend", "threads", "wgpu"].contains(&section) {
            return Err(Error::input(
                format!("--set {assignment}"),
                "this setting belongs to the trained model",
                "change only data, eval, renderer, backend, threads or wgpu here, or train another model",
            ));
        }
    }
    model.config = Config::from_settings(&settings)?;
    Ok(())
}

/// A setting as it is shown.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Section, empty for the settings above all sections.
    pub section: String,
    /// Key within the section.
    pub key: String,
    /// Value as TOML.
    pub value: String,
    /// Where it came from.
    pub origin: Origin,
    /// What it means: the comment of the table of defaults.
    pub meaning: String,
}

/// Every setting in the order of the table of defaults.
pub fn rows(settings: &Settings) -> Vec<Row> {
    let mut rows = Vec::new();
    let mut section = String::new();
    for line in DEFAULTS.lines() {
        if let Some(name) = line.strip_prefix('[') {
            section = name.split(']').next().unwrap_or_default().to_string();
        }
        let Some((key, rest)) = line.split_once(" = ").filter(|_| !line.starts_with(['#', '['])) else {
            continue;
        };
        let path = if section.is_empty() { key.to_string() } else { format!("{section}.{key}") };
        if let Some((_, value, origin)) = settings.iter().find(|(other, ..)| *other == path) {
            rows.push(Row {
                section: section.clone(),
                key: key.to_string(),
                value: value.to_string(),
                origin: origin.clone(),
                meaning: rest.split_once("# ").map_or("", |(_, text)| text.trim()).to_string(),
            });
        }
    }
    rows
}

/// The settings as aligned TOML with the origin of each value as its comment.
pub fn text(settings: &Settings) -> String {
    let rows = rows(settings);
    let key_width = rows.iter().map(|row| row.key.len()).max().unwrap_or(0);
    let value_width = rows.iter().map(|row| row.value.len()).max().unwrap_or(0).min(40);
    let (mut text, mut section) = (String::new(), "");
    for row in &rows {
        if row.section != section {
            section = &row.section;
            text += &format!("\n[{section}]\n");
        }
        text += &format!("{:key_width$} = {:value_width$}  # {}\n", row.key, row.value, row.origin);
    }
    text
}

/// Name of the run folder when the user gives none: `runs/<stem of the configuration file>`.
pub fn default_folder(config: Option<&Path>) -> std::path::PathBuf {
    let stem = config.and_then(Path::file_stem).map_or("default".into(), |stem| stem.to_string_lossy());
    Path::new("runs").join(stem.as_ref())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_setting_is_shown_once_with_its_meaning_and_is_toml() {
        let mut settings = Settings::defaults();
        settings.apply_assignment("train.steps=7").unwrap();
        let rows = rows(&settings);
        assert_eq!(rows.len(), settings.iter().count());
        assert_eq!(rows[0].key, "backend");
        assert!(rows.iter().any(|row| row.key == "hidden" && row.meaning.contains("width")));
        let text = text(&settings);
        assert!(text.lines().any(|line| line.starts_with("steps") && line.ends_with("# --set")), "{text}");
        assert_eq!(Config::from_toml("shown", &text).unwrap().train.steps, 7);
    }

    #[test]
    fn a_trained_model_keeps_its_shape() {
        let mut model = Model::new(Config::default(), Default::default());
        override_model(&mut model, &["data.root=elsewhere".into(), "threads=1".into()]).unwrap();
        assert_eq!((model.config.data.root.as_str(), model.config.threads), ("elsewhere", 1));
        let error = override_model(&mut model, &["encoder.plane_size=64".into()]).unwrap_err();
        assert_eq!(error.exit_code(), 2);
    }

    #[test]
    fn every_configuration_that_is_shipped_is_valid() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
        let mut count = 0;
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            let arguments = SettingsArguments { config: Some(path.clone()), set: vec![] };
            let (_, config) = load(&arguments).unwrap_or_else(|error| panic!("{error}"));
            crate::backends::check(&config.backend).unwrap_or_else(|error| panic!("{error}"));
            assert!(
                std::fs::read_to_string(&path).unwrap().starts_with("# "),
                "{}: no head comment",
                path.display()
            );
            count += 1;
        }
        assert!(count >= 6);
    }
}
