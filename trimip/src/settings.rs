//! The settings of this build: those of core, of the readers of photographs and of the backends. Also overrides of a trained
//! model's settings, and the printed form of settings: aligned `key = value` lines with the meaning and origin of each value, in
//! the order of the table of defaults.

use crate::backends;
use std::sync::{Arc, LazyLock};
use trimip_core::{
    Config, Definitions, Error, ForeignSection, Origin, Place, Result, Settings, field::model::Model,
};

/// The definitions of all settings of this build.
static ALL: LazyLock<Arc<Definitions>> = LazyLock::new(|| Arc::new(definitions_with(&[])));

fn definitions_with(others: &[ForeignSection]) -> Definitions {
    let own = std::iter::once(trimip_data::SECTION).chain(backends::sections());
    let sections: Vec<_> = own.chain(others.iter().copied()).collect();
    Definitions::new(&sections, backends::ABSENT)
}

/// Returns the definitions of all settings of this build: defaults, ranges and meanings.
pub fn definitions() -> Arc<Definitions> {
    ALL.clone()
}

/// Returns the defaults of all settings of this build.
pub fn defaults() -> Settings {
    Settings::of(definitions())
}

/// Returns the defaults of all settings of this build and of `sections`, which other crates own. A
/// [`LossSection`](crate::losses::LossSection) adds terms to the loss.
///
/// # Panics
/// As [`Definitions::new`].
pub fn with_sections(sections: &[ForeignSection]) -> Settings {
    Settings::of(Arc::new(definitions_with(sections)))
}

/// Returns the settings of a configuration that was built in code, after checking every range.
///
/// # Errors
/// When a setting is out of range; the message names the first one.
pub fn of(config: &Config) -> Result<Settings> {
    config.validate()?;
    let mut settings = defaults();
    settings.apply_file("code", &config.to_toml())?;
    Ok(settings)
}

/// Returns the settings whose values in a configuration built in code differ from the defaults. The scene plan may decide about all others.
///
/// ```
/// use trimip::{Config, Training, settings};
///
/// let mut config = Config::default();
/// config.train.seconds = 60.0;
/// config.change::<trimip::data::DataConfig>(|data| data.root = "data/lego".into())?;
/// let training = Training::new(settings::changed(&config)?, "runs/lego".as_ref());
/// # drop(training);
/// # Ok::<(), trimip::Error>(())
/// ```
///
/// # Errors
/// As [`of`].
pub fn changed(config: &Config) -> Result<Settings> {
    let mut settings = of(config)?;
    for (path, default, _) in defaults().iter() {
        if settings.value(path) == default.to_string() {
            settings.set_origin(path, Origin::Default);
        }
    }
    Ok(settings)
}

/// Applies assignments to the configuration of a trained model. Settings that define the model are refused.
///
/// # Errors
/// When a setting does not exist, is out of range, or belongs to the trained model.
pub fn override_model(model: &mut Model, assignments: &[String]) -> Result<()> {
    let own = ["data", "eval", "renderer", "hybrid", "backend", "threads"];
    let free: Vec<&str> = own.into_iter().chain(backends::sections().map(|section| section.name)).collect();
    let mut settings = defaults();
    settings.apply_file("model", &model.config.to_toml())?;
    for assignment in assignments {
        settings.apply_assignment(assignment)?;
        let key = assignment.split('=').next().unwrap_or_default().trim();
        let section = key.split('.').next().unwrap_or_default();
        let belongs = !free.contains(&section) || key == "data.origin";
        if let Some((last, others)) = free.split_last().filter(|_| belongs) {
            return Err(Error::input(
                Place::argument("set", assignment),
                "this setting belongs to the trained model",
                format!("change only {} or {last} here, or train another model", others.join(", ")),
            ));
        }
    }
    model.config = Config::from_settings(&settings)?;
    Ok(())
}

/// A setting as displayed.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingRow {
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

/// Returns all settings in the order of the table of defaults.
pub fn rows(settings: &Settings) -> Vec<SettingRow> {
    let mut rows = Vec::new();
    for section in settings.definitions().documented() {
        for setting in &section.settings {
            let path = match section.name.as_str() {
                "" => setting.key.clone(),
                name => format!("{name}.{}", setting.key),
            };
            let range = if setting.range.is_empty() { String::new() } else { format!("{}: ", setting.range) };
            rows.push(SettingRow {
                section: section.name.clone(),
                key: setting.key.clone(),
                value: settings.value(&path),
                origin: settings.origin(&path).clone(),
                meaning: range + &setting.meaning,
            });
        }
    }
    rows
}

/// Returns the settings as aligned TOML, with the origin of each value as a comment.
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
        let mut settings = defaults();
        settings.apply_assignment("train.steps=7").unwrap();
        let rows = rows(&settings);
        assert_eq!(rows.len(), settings.iter().count());
        assert_eq!(rows[0].key, "backend");
        assert!(rows.iter().any(|row| row.key == "hidden" && row.meaning.contains("width")));
        let text = text(&settings);
        assert!(
            text.lines().any(|line| line.starts_with("steps") && line.ends_with("# command line")),
            "{text}"
        );
        assert_eq!(Config::from_toml("shown", &text).unwrap().train.steps, 7);
    }

    #[test]
    fn a_configuration_built_in_code_is_checked() {
        let mut config = Config { seed: 7, ..Config::default() };
        assert_eq!(Config::from_settings(&of(&config).unwrap()).unwrap(), config);
        config.encoder.levels = 0;
        let error = of(&config).unwrap_err();
        assert!(
            error.kind() == trimip_core::ErrorKind::Input && error.message().contains("encoder.levels = 0"),
            "{error}"
        );
    }

    #[test]
    fn a_trained_model_keeps_its_shape() {
        let mut model = Model::new(Config::default(), Default::default());
        override_model(&mut model, &["data.root=elsewhere".into(), "threads=1".into()]).unwrap();
        assert_eq!((model.config.data.root.as_str(), model.config.threads), ("elsewhere", 1));
        let error = override_model(&mut model, &["encoder.plane_size=64".into()]).unwrap_err();
        assert_eq!(error.kind(), trimip_core::ErrorKind::Input);
    }

    /// Checks that the page of all settings is up to date. A build without a backend lacks the settings of that backend.
    #[cfg(feature = "wgpu")]
    #[test]
    fn generated_page_is_that_of_all_tables() {
        let (path, text) =
            (concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/settings.md"), definitions().page());
        if std::env::var_os("TRIMIP_WRITE_DOCS").is_some() {
            std::fs::write(path, &text).unwrap();
        }
        let found = std::fs::read_to_string(path).unwrap_or_default().replace("\r\n", "\n");
        let renewal = "renew it with TRIMIP_WRITE_DOCS=1 cargo test -p trimip generated";
        assert!(found == text, "{path} is out of date; {renewal}");
    }

    #[test]
    fn every_setting_has_a_meaning_and_every_number_a_range() {
        for section in definitions().documented() {
            for setting in &section.settings {
                let number = setting.default.parse::<f64>().is_ok();
                assert!(
                    !setting.meaning.is_empty() && number <= !setting.range.is_empty(),
                    "{}",
                    setting.key
                );
            }
        }
    }

    #[test]
    fn settings_of_a_backend_that_a_build_lacks_are_carried_along() {
        let lacking = Definitions::new(&[trimip_data::SECTION], &["wgpu"]);
        let mut settings = Settings::of(lacking.into());
        settings.apply_file("run.toml", "[wgpu]\nadapter = \"any\"\n").unwrap();
        settings.apply_assignment("wgpu.deterministic=false").unwrap();
        let config = Config::from_settings(&settings).unwrap();
        assert!(config.to_toml().ends_with("[wgpu]\nadapter = \"any\"\ndeterministic = false\n"));
        assert!(settings.apply_assignment("other.adapter=any").is_err());
    }

    #[test]
    fn the_order_of_a_configuration_is_that_of_its_owners_together() {
        let config = Config::from_settings(&defaults()).unwrap();
        let text = config.to_toml();
        let data = text.split_once("[data]\n").and_then(|(_, rest)| rest.split_once("\n\n")).unwrap().0;
        let keys: Vec<&str> = data.lines().filter_map(|line| line.split(" = ").next()).collect();
        let expected = "root format images train test holdout holdout_by test_list lens masks mask_keeps mask_role depths realign origin scales \
                        convention edge_exponents background builtin_size builtin_train builtin_test \
                        builtin_supersampling builtin_finish most_pixels pixels";
        assert_eq!(keys, expected.split_whitespace().collect::<Vec<_>>());
        // Core reads and writes the same text without the definitions of the other crates' settings.
        assert_eq!(Config::from_toml("model", &text).unwrap().to_toml(), text);
    }
}
