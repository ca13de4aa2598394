//! Layers of settings: defaults, then a configuration file, then `--set a.b=c`. Each value keeps its origin. Keys that are
//! not in the definitions are refused with an error that names file, line and column.

pub(crate) mod checker;
mod earlier;
pub(crate) mod section;
pub(crate) mod setting_value;
pub(crate) mod table;
pub(crate) mod text;
pub(crate) mod values;

use crate::config::defaults::{Definitions, Placed};
use crate::config::origin::Origin;
use crate::{Advice, Error, Place, Result};
use checker::Checker;
use earlier::{RETIRED, renamed};
use serde::Serialize;
use setting_value::SettingValue;
use std::collections::BTreeMap;
use std::sync::Arc;
use text::parts_of;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};
use values::{fit, is_plain, parsed, plain, shown};

/// Effective values and origins of all settings, by dotted path. Serialised as a table of sections.
#[derive(Clone)]
pub struct Settings {
    definitions: Arc<Definitions>,
    entries: BTreeMap<String, (Value, Origin)>,
    /// Undefined settings, in the order in which they were given.
    carried: Vec<Placed>,
    /// True if settings that are not in these definitions, because another crate owns them, are accepted and kept.
    carries: bool,
}

impl std::fmt::Debug for Settings {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_map().entries(&self.entries).finish()
    }
}

impl Serialize for Settings {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> std::result::Result<S::Ok, S::Error> {
        self.table().serialize(serializer)
    }
}

impl Settings {
    /// Returns core's settings only, with their defaults; `trimip::settings::defaults` has those of all crates.
    pub fn defaults() -> Self {
        Self::of(Definitions::core())
    }

    /// Returns all defined settings with their defaults.
    pub fn of(definitions: Arc<Definitions>) -> Self {
        let defaults = definitions.defaults();
        let entries =
            defaults.map(|(path, value)| (path.to_string(), (value.clone(), Origin::Default))).collect();
        Self { definitions, entries, carried: Vec::new(), carries: false }
    }

    /// Returns the same as [`of`](Self::of), but files may add settings of other crates that are not defined here. These
    /// settings are kept unchanged; the crate that owns them checks them when it reads them.
    pub(crate) fn carrying(definitions: Arc<Definitions>) -> Self {
        Self { carries: true, ..Self::of(definitions) }
    }

    /// Returns the definitions of the settings.
    pub fn definitions(&self) -> &Arc<Definitions> {
        &self.definitions
    }

    /// Returns the undefined settings that were given, in order.
    pub(crate) fn carried(&self) -> &[Placed] {
        &self.carried
    }

    /// Applies the text of a configuration file; `name` is used in errors.
    ///
    /// # Errors
    /// When the text is not TOML, a key is unknown or a value has the wrong type; the error names line and column.
    pub fn apply_file(&mut self, name: &str, text: &str) -> Result<()> {
        let table = DeTable::parse(text).map_err(|error| {
            let place = error.span().map_or(Place::from(name), |span| place(name, text, span.start));
            Error::input(place, format!("not valid TOML: {}", error.message()), "correct the line")
        })?;
        self.apply_table(name, text, "", table.get_ref())
    }

    fn apply_table(&mut self, name: &str, text: &str, section: &str, table: &DeTable<'_>) -> Result<()> {
        let path = |key: &str| if section.is_empty() { key.to_string() } else { format!("{section}.{key}") };
        let mut undefined = Vec::new();
        for (key, value) in table {
            let (path, start) = (path(key.get_ref()), key.span().start);
            let origin = || Origin::File(place(name, text, start).to_string());
            if let Some(new) = renamed(&path).filter(|new| table.contains_key(parts_of(new).1)) {
                return Err(Error::input(
                    place(name, text, start),
                    format!("`{path}` is the earlier name of `{new}`, which is given too"),
                    "leave one of them out",
                ));
            }
            match value.get_ref() {
                DeValue::Table(inner) if self.is_section(&path) => {
                    self.apply_table(name, text, &path, inner)?;
                }
                _ if self.is_undefined(&path) => undefined.push((start, path, value)),
                _ => self.put(&path, plain(value), place(name, text, start), origin())?,
            }
        }
        // Undefined settings are sorted by their position in the text, because they are written again in that order.
        undefined.sort_by_key(|(start, ..)| *start);
        for (start, path, value) in undefined {
            let place = place(name, text, start);
            match value.get_ref() {
                DeValue::Table(inner) if section.is_empty() && self.carries_in(&path) => {
                    self.apply_table(name, text, &path, inner)?;
                }
                _ => {
                    let before = table.iter().filter(|(key, _)| key.span().start < start);
                    let before = before.max_by_key(|(key, _)| key.span().start);
                    let after = before.map_or("", |(key, _)| key.get_ref());
                    let origin = Origin::File(place.to_string());
                    self.carry(&path, after, plain(value), place, origin)?;
                }
            }
        }
        Ok(())
    }

    /// Applies one `a.b=c` of the command line. A value that is not valid TOML is taken as a string.
    ///
    /// # Errors
    /// When there is no `=`, the key is unknown or the value has the wrong type.
    pub fn apply_assignment(&mut self, assignment: &str) -> Result<()> {
        let place = Place::argument("set", assignment);
        let Some((path, text)) = assignment.split_once('=') else {
            return Err(Error::input(place, "no '=' found", "write section.key=value"));
        };
        self.put(path.trim(), parsed(text), place, Origin::CommandLine)
    }

    /// Applies a value set in code and returns the settings, for chaining.
    ///
    /// # Errors
    /// When there is no such setting or the value has the wrong type.
    pub fn with(mut self, path: &str, value: impl Into<SettingValue>) -> Result<Self> {
        self.set(path, value)?;
        Ok(self)
    }

    /// Applies a value set in code.
    ///
    /// # Errors
    /// When there is no such setting or the value has the wrong type.
    pub fn set(&mut self, path: &str, value: impl Into<SettingValue>) -> Result<()> {
        self.put(path, value.into().0, "settings".into(), Origin::Code)
    }

    /// Applies a decision of the scene plan; `value` is TOML text.
    ///
    /// # Errors
    /// When there is no such setting or the value has the wrong type.
    pub fn decide(&mut self, path: &str, value: &str) -> Result<()> {
        self.put(path, parsed(value), "scene plan".into(), Origin::Plan)
    }

    /// Returns the effective value of a setting as TOML text; empty if there is no such setting.
    pub fn value(&self, path: &str) -> String {
        self.get(path).map_or_else(String::new, shown)
    }

    /// Returns the source of a setting's effective value.
    pub fn origin(&self, path: &str) -> &Origin {
        self.entries.get(path).map_or(&Origin::Default, |(_, origin)| origin)
    }

    /// Sets the origin of a setting's effective value; does nothing if there is no such setting. [`Origin::Default`] also
    /// replaces the value with the default.
    pub fn set_origin(&mut self, path: &str, origin: Origin) {
        let Some((value, own)) = self.entries.get_mut(path) else { return };
        if origin == Origin::Default
            && let Some((_, default)) = self.definitions.defaults().find(|(known, _)| *known == path)
        {
            *value = default.clone();
        }
        *own = origin;
    }

    fn put(&mut self, path: &str, value: Value, place: Place, origin: Origin) -> Result<()> {
        let path = renamed(path).unwrap_or(path);
        if let Some((_, only, expected)) = RETIRED.iter().find(|(retired, ..)| *retired == path) {
            return match value.as_integer() == Some(*only) {
                true => Ok(()),
                false => Err(Error::input(
                    place,
                    format!("`{path}` is {value}"),
                    Advice::Expected((*expected).into()),
                )),
            };
        }
        let Some(entry) = self.entries.get_mut(path) else {
            let is_beside = |setting: &&Placed| parts_of(&setting.path).0 == parts_of(path).0;
            let last = self.carried.iter().rev().find(is_beside);
            let after = last.map_or_else(String::new, |last| parts_of(&last.path).1.to_string());
            return self.carry(path, &after, value, place, origin);
        };
        // `eval.final` takes a stride or a flag.
        let flag = path == "eval.final" && value.is_bool();
        let fitted = match self.definitions.default(path) {
            Some(default) if !flag => fit(default, value),
            _ => Ok(value),
        };
        entry.0 = fitted.map_err(|(found, expected)| {
            Error::input(place, format!("`{path}` is {found}"), Advice::Expected(expected.to_string()))
        })?;
        let given = positive(&entry.0);
        entry.1 = origin.clone();
        // A run has one budget: the one given last.
        let other = BUDGETS.iter().find(|pair| pair[0] == path).map(|pair| pair[1]);
        if let Some(other) = other.filter(|_| given).and_then(|other| self.entries.get_mut(other)) {
            other.0 = fit(&other.0, Value::Integer(0)).unwrap_or(Value::Integer(0));
            other.1 = origin;
        }
        Ok(())
    }

    /// Keeps an undefined setting, placed after the key `after`. Fails if the section takes no undefined settings.
    fn carry(&mut self, path: &str, after: &str, value: Value, place: Place, origin: Origin) -> Result<()> {
        let (section, key) = parts_of(path);
        let bare =
            |name: &str| name.bytes().all(|byte| byte.is_ascii_alphanumeric() || b"_-".contains(&byte));
        if self.carries_in(section) && bare(section) && bare(key) && !key.is_empty() && is_plain(&value) {
            self.carried.push(Placed { path: path.to_string(), after: after.to_string() });
            self.entries.insert(path.to_string(), (value, origin));
            return Ok(());
        }
        let mut known: Vec<&str> =
            self.entries.keys().map(String::as_str).filter(|key| parts_of(key).0 == section).collect();
        if section.is_empty() || known.is_empty() {
            known = self.entries.keys().map(|key| key.split('.').next().unwrap_or(key)).collect();
            known.dedup();
        }
        Err(Error::input(
            place,
            format!("unknown setting `{path}`"),
            Advice::Expected(format!("one of: {}", known.join(", "))),
        ))
    }

    /// Returns true if a section takes undefined settings.
    fn carries_in(&self, section: &str) -> bool {
        let others = self.carries && self.definitions.may_have_more(section);
        !section.is_empty() && (others || self.definitions.is_absent(section))
    }

    fn is_section(&self, path: &str) -> bool {
        self.entries.keys().any(|key| key.contains('.') && parts_of(key).0 == path)
    }

    fn is_undefined(&self, path: &str) -> bool {
        let is_earlier = renamed(path).is_some() || RETIRED.iter().any(|(retired, ..)| *retired == path);
        !self.entries.contains_key(path) && !is_earlier
    }

    /// Refuses the first number that is not in its range.
    pub(crate) fn check_ranges(&self, to: &Checker<'_>) -> Result<()> {
        for (path, value, _) in self.iter() {
            if let Some(range) = self.definitions.range(path) {
                to.check(range.holds(&value.0), path, &range.expected(&value.0))?;
            }
        }
        Ok(())
    }

    /// Iterates over the dotted path, effective value and origin of every setting, sorted by path.
    pub fn iter(&self) -> impl Iterator<Item = (&str, SettingValue, &Origin)> {
        self.entries
            .iter()
            .map(|(path, (value, origin))| (path.as_str(), SettingValue(value.clone()), origin))
    }

    /// Returns the path, value and origin of the setting at `path`, for an error.
    pub fn place(&self, path: &str) -> Place {
        match self.entries.get(path) {
            Some((value, origin)) => {
                Place::Setting { path: path.into(), value: shown(value), origin: origin.clone() }
            }
            None => path.into(),
        }
    }

    /// Returns the effective value of a setting.
    pub(crate) fn get(&self, path: &str) -> Option<&Value> {
        self.entries.get(path).map(|(value, _)| value)
    }

    /// Returns the effective settings as one TOML table.
    pub(crate) fn table(&self) -> Table {
        self.table_of(self.entries.keys().map(String::as_str))
    }

    /// Returns the settings with these `paths` as one TOML table.
    pub(crate) fn table_of<'a>(&self, paths: impl Iterator<Item = &'a str>) -> Table {
        let mut table = Table::new();
        for (path, value) in paths.filter_map(|path| Some((path, self.get(path)?))) {
            match path.split_once('.') {
                None => {
                    table.insert(path.to_string(), value.clone());
                }
                Some((section, key)) => {
                    if let Value::Table(fields) =
                        table.entry(section).or_insert_with(|| Value::Table(Table::new()))
                    {
                        fields.insert(key.to_string(), value.clone());
                    }
                }
            }
        }
        table
    }
}

/// Each budget of a run, and the budget that it sets to 0.
const BUDGETS: [[&str; 2]; 2] = [["train.seconds", "train.steps"], ["train.steps", "train.seconds"]];

fn positive(value: &Value) -> bool {
    value.as_float().or(value.as_integer().map(|number| number as f64)).is_some_and(|number| number > 0.0)
}

/// Returns the place `name:line:column` of a byte offset in `text`.
fn place(name: &str, text: &str, offset: usize) -> Place {
    let before = &text[..offset.min(text.len())];
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
    Place::Text { file: name.into(), line, column: Some(column) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn origins_are_set_and_the_default_restores_its_value() {
        let mut settings = Settings::defaults();
        settings.set_origin("seed", Origin::Plan);
        settings.set_origin("nothing.of.this", Origin::Plan);
        assert_eq!([settings.origin("seed"), settings.origin("threads")], [&Origin::Plan, &Origin::Default]);
        let before = settings.value("encoder.halvings");
        settings.apply_file("run.toml", "[encoder]\nhalvings = [[0.0, 0.0]]\n").unwrap();
        settings.set_origin("encoder.halvings", Origin::Default);
        assert_eq!(settings.value("encoder.halvings"), before, "the form of the default");
    }

    #[test]
    fn a_later_layer_wins_and_is_named() {
        let mut settings = Settings::defaults();
        settings.apply_file("run.toml", "seed = 7\n[train]\nsteps = 10\n").unwrap();
        settings.apply_assignment("train.steps=20").unwrap();
        settings.apply_assignment("data.root=some/folder").unwrap();
        let table = settings.table();
        assert_eq!(table["seed"].as_integer(), Some(7));
        assert_eq!(table["train"]["steps"].as_integer(), Some(20));
        assert_eq!(table["data"]["root"].as_str(), Some("some/folder"));
        assert_eq!(settings.place("seed").to_string(), "run.toml:1:1: seed = 7");
        assert_eq!(settings.place("train.steps").to_string(), "command line: train.steps = 20");
    }

    #[test]
    fn what_is_wrong_is_named_with_its_place() {
        let mut settings = Settings::defaults();
        let error = settings.apply_file("run.toml", "seed = 1\n[train]\n  stepz = 3\n").unwrap_err();
        assert!(
            error.message().starts_with("run.toml:3:3: unknown setting `train.stepz`; expected one of: "),
            "{error}"
        );
        assert!(error.message().contains("train.steps"), "{error}");
        let error = settings.apply_file("run.toml", "[trian]\nsteps = 3\n").unwrap_err();
        assert!(
            error.message().contains("unknown setting `trian`") && error.message().contains("train"),
            "{error}"
        );
        let error = settings.apply_file("run.toml", "[train]\nsteps = \"many\"\n").unwrap_err();
        assert!(
            error.message().contains("run.toml:2:1") && error.message().contains("a whole number"),
            "{error}"
        );
        let error = settings.apply_file("run.toml", "[train\n").unwrap_err();
        assert!(error.message().starts_with("run.toml:1:"), "{error}");
        assert!(settings.apply_assignment("train.steps").is_err());
    }

    #[test]
    fn a_retired_setting_is_read_at_its_only_value_and_refused_at_others() {
        let mut settings = Settings::defaults();
        let before = settings.table();
        settings.apply_file("old.toml", "[encoder]\nchannels = 16\nlevels = 8\n").unwrap();
        settings.apply_assignment("encoder.channels=16").unwrap();
        assert_eq!(settings.table(), before);
        let error = settings.apply_file("old.toml", "[encoder]\nchannels = 8\n").unwrap_err();
        assert_eq!(error.kind(), crate::ErrorKind::Input);
        for part in ["old.toml:2:1", "`encoder.channels` is 8", "expected 16"] {
            assert!(error.message().contains(part), "{part} in {error}");
        }
    }

    #[test]
    fn the_budget_that_is_given_last_counts() {
        let mut settings = Settings::defaults();
        let budget = |settings: &Settings| [settings.value("train.seconds"), settings.value("train.steps")];
        assert_eq!(budget(&settings), ["300.0", "0"]);
        settings.apply_file("run.toml", "[train]\nsteps = 10\n").unwrap();
        assert_eq!(budget(&settings), ["0.0", "10"]);
        settings.apply_assignment("train.seconds=60").unwrap();
        assert_eq!(budget(&settings), ["60.0", "0"]);
        // A complete configuration names both budgets, one of them as 0.
        settings.apply_file("config.toml", "[train]\nseconds = 0.0\nsteps = 7\n").unwrap();
        assert_eq!(budget(&settings), ["0.0", "7"]);
    }

    #[test]
    fn an_integer_serves_as_a_float() {
        let mut settings = Settings::defaults();
        settings.apply_assignment("train.seconds=300").unwrap();
        settings.apply_assignment("data.background=[0, 0, 0]").unwrap();
        assert_eq!(settings.table()["train"]["seconds"].as_float(), Some(300.0));
    }
}
