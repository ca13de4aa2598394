//! Settings from the command line, validated.

use crate::{
    args::{SceneArguments, SettingsArguments},
    mistake,
};
use std::path::Path;
use trimip::{Config, Error, Result, Settings, systems};
use trimip_capture::quoted_path;
use trimip_core::text;
use trimip_data::{is_archive, is_film};

/// Merges the settings of a system, a configuration file and the command line, and checks every range.
pub fn load(arguments: &SettingsArguments) -> Result<(Settings, Config)> {
    let mut settings = trimip::settings::defaults();
    if let Some(name) = &arguments.system {
        systems::find(name)?.apply(&mut settings)?;
    }
    if let Some(path) = &arguments.config {
        let text = text::read(path, "name an existing configuration file, such as configs/quickstart.toml")?;
        settings.apply_file(&path.display().to_string(), &text)?;
    }
    for assignment in &arguments.set {
        settings.apply_assignment(assignment)?;
    }
    let config = Config::from_settings(&settings)?;
    Ok((settings, config))
}

/// Like [`load`], with the folder and the minutes of the command line. These override the file, and `--set` overrides them.
pub fn load_scene(scene: &SceneArguments, arguments: &SettingsArguments) -> Result<(Settings, Config)> {
    let mut set = Vec::new();
    if let Some(folder) = &scene.folder {
        set.push(format!("data.root={}", trimip::SettingValue::from(scene_root(folder)?)));
    }
    if let Some(minutes) = scene.minutes {
        if !(minutes.is_finite() && minutes > 0.0) {
            return Err(Error::input(
                format!("--minutes {minutes}"),
                "is not a duration",
                "give a number above 0",
            ));
        }
        set.push(format!("train.seconds={:?}", 60.0 * minutes));
    }
    set.extend(arguments.set.iter().cloned());
    load(&SettingsArguments { set, ..arguments.clone() })
}

/// Returns the folder or archive of a scene, as `data.root`. For anything else, the error suggests what to type.
pub fn scene_root(folder: &Path) -> Result<String> {
    let (place, name) = (folder.display(), folder.file_name().unwrap_or_default().to_string_lossy());
    let text = |path: &Path| {
        let text = path.to_str().map(String::from);
        text.ok_or_else(|| Error::input(path.display(), "the path is not UTF-8", "rename the folder"))
    };
    if folder.join("checkpoint.safetensors").is_file() || folder.join("model.safetensors").is_file() {
        return Err(Error::input(
            folder,
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
        return Err(mistake::no_verb(&place.to_string()));
    }
    if name.starts_with("transforms") && name.ends_with(".json") || name == "metadata.json" {
        let parent = folder.parent().filter(|parent| *parent != Path::new(""));
        return text(parent.unwrap_or(Path::new(".")));
    }
    if is_archive(folder) {
        return text(folder);
    }
    let advice = match name.ends_with(".toml") {
        true => format!("type `trimip-cli --config {place}`"),
        false if is_film(folder) => {
            format!("find the cameras of its frames: trimip-cli capture {}", quoted_path(folder))
        }
        false => "name the folder that holds transforms.json and the photographs".into(),
    };
    Err(Error::input(folder, "is a file, not the folder of a scene", advice))
}

/// Parses a duration such as `90s`, `5m` or `1.5h` and returns it in seconds; a number without a unit means minutes.
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
        .ok_or_else(|| Error::input(place, format!("`{text}` is not a duration"), "write 90s, 5m or 1h"))
}

/// Returns the default run folder: `runs/` and the name of the configuration file, or else of the scene's archive or folder, followed by
/// the system.
pub fn default_folder(
    config: Option<&Path>,
    scene: Option<&Path>,
    system: Option<&str>,
) -> std::path::PathBuf {
    let whole = scene.map(|scene| scene.canonicalize().unwrap_or_else(|_| scene.to_path_buf()));
    let folder = whole.map(|whole| match whole.parent() {
        _ if is_archive(&whole) => whole.with_extension(""),
        Some(parent) if whole.is_file() => parent.into(),
        _ => whole,
    });
    let name = config.and_then(Path::file_stem).or(folder.as_deref().and_then(Path::file_name));
    let names =
        name.map(|name| name.to_string_lossy().into_owned()).into_iter().chain(system.map(String::from));
    let name = names.collect::<Vec<_>>().join("-");
    Path::new("runs").join(if name.is_empty() { "default" } else { &name })
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip_core::scene::origin::LocalOrigin;

    #[test]
    fn durations_are_read_in_seconds_minutes_and_hours() {
        let read = |text: &str| duration("--continue-for", text).map_err(|error| error.kind());
        assert_eq!(
            [read("90s"), read("5m"), read("1.5 h"), read("2")],
            [Ok(90.0), Ok(300.0), Ok(5400.0), Ok(120.0)]
        );
        for text in ["", "m", "-5m", "5 weeks", "nan", "infm"] {
            assert_eq!(read(text), Err(trimip_core::ErrorKind::Input), "{text}");
        }
    }

    #[test]
    fn what_is_no_scene_is_answered_with_what_to_type() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        for (name, answer) in [
            ("transforms.json", None),
            ("a.toml", Some("--config")),
            ("b.png", Some("transforms.json")),
            ("-c d.MP4", Some("trimip-cli capture")),
        ] {
            std::fs::write(path(name), "").unwrap();
            match (scene_root(&path(name)), answer) {
                (Ok(root), None) => assert_eq!(Path::new(&root), folder.path()),
                (Err(error), Some(answer)) => assert!(error.message().contains(answer), "{error}"),
                (other, _) => panic!("{name}: {other:?}"),
            }
        }
        assert!(scene_root(Path::new("rendr")).unwrap_err().message().contains("--help"));
        assert_eq!(default_folder(None, Some(folder.path()), None).file_name(), folder.path().file_name());
        let archive = folder.path().join("capture.1.zip");
        std::fs::write(&archive, "").unwrap();
        assert_eq!(scene_root(&archive).unwrap(), archive.to_str().unwrap());
        assert_eq!(default_folder(None, Some(&archive), None), Path::new("runs/capture.1"));
        let named = |config: Option<&str>, system| default_folder(config.map(Path::new), None, system);
        assert_eq!(named(Some("a/b.toml"), Some("ngp")), Path::new("runs/b-ngp"));
        assert_eq!((named(None, Some("ngp")), named(None, None)), ("runs/ngp".into(), "runs/default".into()));
        std::fs::write(path("model.safetensors"), "").unwrap();
        let error = scene_root(folder.path()).unwrap_err();
        assert!(
            error.kind() == trimip_core::ErrorKind::Input && error.message().contains("--continue-for"),
            "{error}"
        );
    }

    #[test]
    fn every_configuration_that_is_shipped_is_valid() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs");
        let mut count = 0;
        for entry in std::fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.extension().is_none_or(|end| end != "toml") {
                continue;
            }
            let arguments = SettingsArguments { config: Some(path.clone()), ..Default::default() };
            let (_, config) = load(&arguments).unwrap_or_else(|error| panic!("{error}"));
            trimip::backends::check(&config.backend).unwrap_or_else(|error| panic!("{error}"));
            assert!(
                std::fs::read_to_string(&path).unwrap().starts_with("# "),
                "{}: no head comment",
                path.display()
            );
            count += 1;
        }
        assert!(count >= 6);
    }

    #[test]
    fn the_path_that_is_shipped_ends_16_times_as_far_away_as_it_begins() {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../configs/zoom.json");
        let intrinsics = trimip::Intrinsics::from_angle(8, 8, 0.7);
        let cameras = trimip::view::cameras::path(&file, intrinsics, LocalOrigin::default()).unwrap();
        // All cameras look at one point of the built-in scene.
        let distances: Vec<f64> = cameras
            .iter()
            .map(|(_, camera)| (camera.origin - glam::DVec3::new(0.0, 0.0, 0.1)).length())
            .collect();
        assert!((distances[cameras.len() - 1] / distances[0] - 16.0).abs() < 1e-3, "{distances:?}");
        assert!(distances.is_sorted());
    }
}
