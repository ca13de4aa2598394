//! From the command line to checked settings, and their printed form: aligned `key = value` lines with what each means
//! and where its value came from, in the order of the documented table of defaults.

use crate::args::{SceneArguments, SettingsArguments};
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

/// As [`load`], with the folder and the minutes of the command line, which count more than the file and less than `--set`.
pub fn load_scene(scene: &SceneArguments, arguments: &SettingsArguments) -> Result<(Settings, Config)> {
    let mut set = Vec::new();
    if let Some(folder) = &scene.folder {
        set.push(format!("data.root={}", toml::Value::String(scene_root(folder)?)));
    }
    if let Some(minutes) = scene.minutes {
        if !(minutes.is_finite() && minutes > 0.0) {
            return Err(Error::input(format!("--minutes {minutes}"), "is no time", "give a number above 0"));
        }
        set.push(format!("train.seconds={:?}", 60.0 * minutes));
    }
    set.extend(arguments.set.iter().cloned());
    load(&SettingsArguments { config: arguments.config.clone(), set })
}

/// The folder of a scene as `data.root`; what is none is answered with what to type instead.
pub fn scene_root(folder: &Path) -> Result<String> {
    let (place, name) = (folder.display(), folder.file_name().unwrap_or_default().to_string_lossy());
    let text = |path: &Path| {
        let text = path.to_str().map(String::from);
        text.ok_or_else(|| Error::input(path.display(), "the path is not UTF-8", "rename the folder"))
    };
    if folder.join("checkpoint.safetensors").is_file() || folder.join("model.safetensors").is_file() {
        return Err(Error::input(
            &place,
            "holds a run, not photographs",
            format!(
                "type `trimip-cli eval {place}`, `trimip-cli render {place}`, or `trimip-cli --out {place} --continue-for 5m` \
                 to train it longer"
            ),
        ));
    }
    if folder.is_dir() {
        return text(folder);
    }
    if !folder.exists() {
        return Err(Error::input(
            &place,
            "is neither a verb nor a folder",
            "type `trimip-cli --help` for the verbs, or name a folder with photographs and their transforms.json",
        ));
    }
    if name.starts_with("transforms") && name.ends_with(".json") || name == "metadata.json" {
        let parent = folder.parent().filter(|parent| *parent != Path::new(""));
        return text(parent.unwrap_or(Path::new(".")));
    }
    let advice = match name.ends_with(".toml") {
        true => format!("type `trimip-cli --config {place}`"),
        false => "name the folder that holds transforms.json and the photographs".into(),
    };
    Err(Error::input(&place, "is a file, not the folder of a scene", advice))
}

/// Seconds of a duration such as `90s`, `5m` or `1.5h`; a bare number is minutes.
pub fn duration(place: &str, text: &str) -> Result<f64> {
    let text = text.trim();
    let end = text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len());
    let unit = match text[end..].trim() {
        "s" | "sec" | "seconds" => Some(1.0),
        "" | "m" | "min" | "minutes" => Some(60.0),
        "h" | "hours" => Some(3600.0),
        _ => None,
    };
    let seconds = text[..end].trim().parse::<f64>().ok().zip(unit).map(|(number, unit)| number * unit);
    seconds
        .filter(|seconds| seconds.is_finite() && *seconds > 0.0)
        .ok_or_else(|| Error::input(place, format!("`{text}` is no duration"), "write 90s, 5m or 1h"))
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

/// Name of the run folder when the user gives none: `runs/` and the stem of the configuration file, or the scene's folder.
pub fn default_folder(config: Option<&Path>, scene: Option<&Path>) -> std::path::PathBuf {
    let whole = scene.map(|scene| scene.canonicalize().unwrap_or_else(|_| scene.to_path_buf()));
    let folder =
        whole.as_deref().map(|whole| if whole.is_file() { whole.parent().unwrap_or(whole) } else { whole });
    let name = config.and_then(Path::file_stem).or(folder.and_then(Path::file_name));
    Path::new("runs").join(name.map_or("default".into(), |name| name.to_string_lossy()).as_ref())
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
    fn durations_are_read_in_seconds_minutes_and_hours() {
        let read = |text: &str| duration("--continue-for", text).map_err(|error| error.exit_code());
        assert_eq!(
            [read("90s"), read("5m"), read("1.5 h"), read("2")],
            [Ok(90.0), Ok(300.0), Ok(5400.0), Ok(120.0)]
        );
        for text in ["", "m", "-5m", "5 weeks", "nan", "infm"] {
            assert_eq!(read(text), Err(2), "{text}");
        }
    }

    #[test]
    fn what_is_no_scene_is_answered_with_what_to_type() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for (name, answer) in
            [("transforms.json", None), ("a.toml", Some("--config")), ("b.png", Some("transforms.json"))]
        {
            std::fs::write(path(name), "").unwrap();
            match (scene_root(&path(name)), answer) {
                (Ok(root), None) => assert_eq!(Path::new(&root), folder.path()),
                (Err(error), Some(answer)) => assert!(error.message.contains(answer), "{error}"),
                (other, _) => panic!("{name}: {other:?}"),
            }
        }
        assert!(scene_root(Path::new("rendr")).unwrap_err().message.contains("--help"));
        assert_eq!(default_folder(None, Some(folder.path())).file_name(), folder.path().file_name());
        std::fs::write(path("model.safetensors"), "").unwrap();
        let error = scene_root(folder.path()).unwrap_err();
        assert!(error.exit_code() == 2 && error.message.contains("--continue-for"), "{error}");
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
