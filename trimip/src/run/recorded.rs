//! A run as recorded in its folder, without its data.

use super::{folder::RunFolder, history::History, train::Trained};
use crate::report::{Report, Status};
use serde_json::Value;
use std::path::Path;
use trimip_core::{
    Config, Error, Origin, Result, SettingValue, Settings, measures::quality::mean_quality, plain_file,
};

/// A run: its folder, its settings and what happened in it.
#[derive(Clone, Debug)]
pub struct Recorded {
    /// The run's folder.
    pub folder: RunFolder,
    /// Name of the scene.
    pub scene: String,
    /// The effective configuration, scene plan included.
    pub config: Config,
    /// The effective configuration with the origin of each value, where known.
    pub settings: Settings,
    /// The run's event history.
    pub history: History,
    /// State of the run.
    pub status: Status,
}

impl Recorded {
    /// Reads a run folder. Takes no lock: a run that is still training is read in its current state.
    ///
    /// # Errors
    /// When there is no run, or its configuration is of another version.
    pub fn open(path: &Path) -> Result<Self> {
        let folder = RunFolder::new(path);
        let config = folder.config();
        if !config.is_file() {
            return Err(Error::input(
                path.display(),
                "holds no run",
                "name the folder of a run, such as runs/quickstart",
            ));
        }
        let text = trimip_core::text::read(&config, "name the folder of a run")?;
        let mut settings = crate::settings::defaults();
        settings.apply_file(&config.display().to_string(), &text)?;
        restore_origins(&mut settings, &folder);
        let config = Config::from_settings(&settings)?;
        let history = History::of(&folder.events());
        let status = match history.last() {
            Some(last) if folder.model().is_file() => judged(mean_quality(&last.scales).judge(&config.eval)),
            _ => Status::Stopped,
        };
        Ok(Self { scene: super::train::scene_name(&config), folder, config, settings, history, status })
    }

    /// Returns the record of a training that has ended.
    pub fn of(trained: &Trained) -> Self {
        use super::train::Outcome;
        let status = match &trained.outcome {
            Ok(Outcome::Stopped) => Status::Stopped,
            Ok(Outcome::Finished | Outcome::AlreadyComplete) => judged(trained.judge()),
            Err(error) => Status::Failed(error.message().clone()),
        };
        Self {
            folder: trained.folder.clone(),
            scene: trained.scene.clone(),
            config: trained.config.clone(),
            settings: trained.settings.clone(),
            history: trained.history.clone(),
            status,
        }
    }

    /// Collects the report of the run.
    pub fn report(&self) -> Report<'_> {
        let status = self.status.clone();
        Report::gather(&self.folder, status, &self.scene, &self.config, &self.settings, &self.history)
    }
}

/// Returns true for equal values; numbers are equal with and without a decimal point.
fn is_same(a: &Value, b: &Value) -> bool {
    match (a, b) {
        (Value::Number(a), Value::Number(b)) => a.as_f64() == b.as_f64(),
        (Value::Array(a), Value::Array(b)) => {
            a.len() == b.len() && a.iter().zip(b).all(|(a, b)| is_same(a, b))
        }
        _ => a == b,
    }
}

/// Sets the origins of settings from the report of their run, where the report has the same values. Without a report
/// the origins are unchanged.
fn restore_origins(settings: &mut Settings, folder: &RunFolder) {
    let text = plain_file::read_to_string(&folder.json()).unwrap_or_default();
    let report: Value = serde_json::from_str(&text).unwrap_or_default();
    let stated = |path: &str, value: &SettingValue| -> Option<Origin> {
        let stated = report["settings"].get(path)?;
        let same = serde_json::to_value(value).is_ok_and(|value| is_same(&value, &stated["value"]));
        stated["origin"].as_str().filter(|_| same).map(Origin::from)
    };
    let found: Vec<_> = settings
        .iter()
        .filter_map(|(path, value, _)| stated(path, &value).map(|origin| (path.to_string(), origin)))
        .collect();
    found.into_iter().for_each(|(path, origin)| settings.set_origin(&path, origin));
}

/// Returns the state of a finished run whose quality has been judged.
fn judged(judgement: Result<()>) -> Status {
    judgement.map_or_else(|error| Status::Failed(error.message()), |()| Status::Finished)
}
