//! Settings of a trained model, and the printed form of settings: aligned `key = value` lines with the meaning and
//! origin of each value, in the order of the table of defaults.

use trimip_core::{Config, DEFAULTS, Error, Origin, Result, Settings, model::Model};

/// The settings of a configuration that was built in code. Checks every range.
///
/// # Errors
/// When a setting is out of range; the message names the first one.
pub fn of(config: &Config) -> Result<Settings> {
    config.validate()?;
    let mut settings = Settings::defaults();
    settings.apply_file("code", &config.to_toml())?;
    Ok(settings)
}

/// Applies assignments to the configuration of a trained model. Settings that define the model cannot change.
///
/// # Errors
/// When a setting does not exist, is out of range, or belongs to the trained model.
pub fn override_model(model: &mut Model, assignments: &[String]) -> Result<()> {
    let mut settings = Settings::defaults();
    settings.apply_file("model", &model.config.to_toml())?;
    for assignment in assignments {
        settings.apply_assignment(assignment)?;
        let key = assignment.split('=').next().unwrap_or_default().trim();
        let section = key.split('.').next().unwrap_or_default();
        if !["data", "eval", "renderer", "hybrid", "backend", "threads", "wgpu"].contains(&section) {
            return Err(Error::input(
                format!("--set {assignment}"),
                "this setting belongs to the trained model",
                "change only data, eval, renderer, hybrid, backend, threads or wgpu here, or train another model",
            ));
        }
    }
    model.config = Config::from_settings(&settings)?;
    Ok(())
}

/// A setting as displayed.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Section; empty for top-level settings.
    pub section: String,
    /// Key within the section.
    pub key: String,
    /// Value as TOML.
    pub value: String,
    /// Origin of the value.
    pub origin: Origin,
    /// Meaning: the setting's comment in the table of defaults.
    pub meaning: String,
}

/// All settings in the order of the table of defaults.
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

/// The settings as aligned TOML, with the origin of each value as a comment.
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
    fn a_configuration_built_in_code_is_checked() {
        let mut config = Config { seed: 7, ..Config::default() };
        assert_eq!(Config::from_settings(&of(&config).unwrap()).unwrap(), config);
        config.encoder.levels = 0;
        let error = of(&config).unwrap_err();
        assert!(error.exit_code() == 2 && error.message.contains("encoder.levels = 0"), "{error}");
    }

    #[test]
    fn a_trained_model_keeps_its_shape() {
        let mut model = Model::new(Config::default(), Default::default());
        override_model(&mut model, &["data.root=elsewhere".into(), "threads=1".into()]).unwrap();
        assert_eq!((model.config.data.root.as_str(), model.config.threads), ("elsewhere", 1));
        let error = override_model(&mut model, &["encoder.plane_size=64".into()]).unwrap_err();
        assert_eq!(error.exit_code(), 2);
    }
}
