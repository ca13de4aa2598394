//! Layers of settings: defaults, then a configuration file, then `--set a.b=c`. Each value keeps its origin. Keys that are
//! not in the defaults are refused with file, line and column.

use crate::{Error, Result, defaults::DEFAULTS};
use std::collections::BTreeMap;
use std::sync::LazyLock;
use toml::de::{DeTable, DeValue};
use toml::{Spanned, Table, Value};

/// Settings of earlier versions that had one value only, and why. That value is accepted and ignored, so that old files
/// load; any other is refused.
const RETIRED: [(&str, i64, &str); 1] =
    [("encoder.channels", 16, "16, or leave it out: a texel of the tri-mip planes has 16 features")];

/// Where an effective value came from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// The table of defaults.
    Default,
    /// `file:line:column`.
    File(String),
    /// `--set` on the command line.
    CommandLine,
    /// A program that uses the library.
    Code,
    /// The scene plan.
    Plan,
}

impl std::fmt::Display for Origin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Default => f.write_str("default"),
            Self::File(place) => f.write_str(place),
            Self::CommandLine => f.write_str("--set"),
            Self::Code => f.write_str("code"),
            Self::Plan => f.write_str("scene plan"),
        }
    }
}

/// The table of defaults, read once.
static TABLE: LazyLock<Settings> = LazyLock::new(Settings::of_table);

/// Every setting by its dotted path, with its effective value and origin.
#[derive(Clone, Debug)]
pub struct Settings {
    entries: BTreeMap<String, (Value, Origin)>,
}

impl Settings {
    /// The defaults alone.
    pub fn defaults() -> Self {
        TABLE.clone()
    }

    /// Reads the table of defaults.
    fn of_table() -> Self {
        let table: Table =
            toml::from_str(DEFAULTS).unwrap_or_else(|error| unreachable!("defaults.toml is tested: {error}"));
        let mut entries = BTreeMap::new();
        for (section, value) in table {
            match value {
                Value::Table(fields) => entries.extend(
                    fields
                        .into_iter()
                        .map(|(key, value)| (format!("{section}.{key}"), (value, Origin::Default))),
                ),
                value => {
                    entries.insert(section, (value, Origin::Default));
                }
            }
        }
        Self { entries }
    }

    /// Applies the text of a configuration file; `name` is used in errors.
    ///
    /// # Errors
    /// When the text is not TOML, a key is unknown or a value has another type; names line and column.
    pub fn apply_file(&mut self, name: &str, text: &str) -> Result<()> {
        let table = DeTable::parse(text).map_err(|error| {
            let place = error.span().map_or(name.to_string(), |span| place(name, text, span.start));
            Error::input(place, format!("not valid TOML: {}", error.message()), "mend the line")
        })?;
        self.apply_table(name, text, "", table.get_ref())
    }

    fn apply_table(&mut self, name: &str, text: &str, prefix: &str, table: &DeTable<'_>) -> Result<()> {
        for (key, value) in table {
            let path = if prefix.is_empty() {
                key.get_ref().to_string()
            } else {
                format!("{prefix}.{}", key.get_ref())
            };
            let place = place(name, text, key.span().start);
            if let DeValue::Table(inner) = value.get_ref()
                && self.is_section(&path)
            {
                self.apply_table(name, text, &path, inner)?;
            } else {
                self.put(&path, plain(value), &place, Origin::File(place.clone()))?;
            }
        }
        Ok(())
    }

    /// Applies one `a.b=c` of the command line. A value that is not valid TOML is taken as a string.
    ///
    /// # Errors
    /// When there is no `=`, the key is unknown or the value has another type.
    pub fn apply_assignment(&mut self, assignment: &str) -> Result<()> {
        let place = format!("--set {assignment}");
        let Some((path, text)) = assignment.split_once('=') else {
            return Err(Error::input(place, "no '=' found", "write --set section.key=value"));
        };
        self.put(path.trim(), parsed(text), &place, Origin::CommandLine)
    }

    /// Applies a value set in code; for chaining.
    ///
    /// # Errors
    /// When there is no such setting or the value has another type.
    pub fn with(mut self, path: &str, value: impl Into<Value>) -> Result<Self> {
        self.set(path, value)?;
        Ok(self)
    }

    /// Applies a value set in code.
    ///
    /// # Errors
    /// When there is no such setting or the value has another type.
    pub fn set(&mut self, path: &str, value: impl Into<Value>) -> Result<()> {
        self.put(path, value.into(), "code", Origin::Code)
    }

    /// Applies a decision of the scene plan; `value` is TOML text.
    ///
    /// # Errors
    /// When there is no such setting or the value has another type.
    pub fn decide(&mut self, path: &str, value: &str) -> Result<()> {
        self.put(path, parsed(value), "scene plan", Origin::Plan)
    }

    /// The effective value of a setting as TOML text; empty if there is no such setting.
    pub fn value(&self, path: &str) -> String {
        self.entries.get(path).map_or_else(String::new, |(value, _)| value.to_string())
    }

    /// Where the effective value of a setting came from.
    pub fn origin(&self, path: &str) -> &Origin {
        self.entries.get(path).map_or(&Origin::Default, |(_, origin)| origin)
    }

    fn put(&mut self, path: &str, value: Value, place: &str, origin: Origin) -> Result<()> {
        if let Some((_, only, expected)) = RETIRED.iter().find(|(retired, ..)| *retired == path) {
            return match value.as_integer() == Some(*only) {
                true => Ok(()),
                false => {
                    Err(Error::input(place, format!("`{path}` is {value}"), format!("expected {expected}")))
                }
            };
        }
        let Some(entry) = self.entries.get_mut(path) else {
            let section = path.rsplit_once('.').map_or("", |(section, _)| section);
            let mut known: Vec<&str> =
                self.entries.keys().map(String::as_str).filter(|key| section_of(key) == section).collect();
            if section.is_empty() || known.is_empty() {
                known = self.entries.keys().map(|key| key.split('.').next().unwrap_or(key)).collect();
                known.dedup();
            }
            return Err(Error::input(
                place,
                format!("unknown setting `{path}`"),
                format!("expected one of: {}", known.join(", ")),
            ));
        };
        // `eval.final` takes a stride or a flag.
        let flag = path == "eval.final" && value.is_bool();
        let fitted = if flag { Ok(value) } else { fit(default_of(path), value) };
        entry.0 = fitted.map_err(|(found, expected)| {
            Error::input(place, format!("`{path}` is {found}"), format!("expected {expected}"))
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

    fn is_section(&self, path: &str) -> bool {
        self.entries.keys().any(|key| section_of(key) == path)
    }

    /// Dotted path, effective value and origin of every setting, sorted by path.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Value, &Origin)> {
        self.entries.iter().map(|(path, (value, origin))| (path.as_str(), value, origin))
    }

    /// Where the value at `path` came from, as text for an error.
    pub fn place(&self, path: &str) -> String {
        match self.entries.get(path) {
            Some((value, origin)) => format!("{origin}: {path} = {}", shown(value)),
            None => path.to_string(),
        }
    }

    /// The effective settings as one TOML table.
    pub fn table(&self) -> Table {
        let mut table = Table::new();
        for (path, (value, _)) in &self.entries {
            match path.split_once('.') {
                None => {
                    table.insert(path.clone(), value.clone());
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

/// Each budget of a run, and the one it replaces.
const BUDGETS: [[&str; 2]; 2] = [["train.seconds", "train.steps"], ["train.steps", "train.seconds"]];

fn positive(value: &Value) -> bool {
    value.as_float().or(value.as_integer().map(|number| number as f64)).is_some_and(|number| number > 0.0)
}

/// The default of a setting, which has its type.
fn default_of(path: &str) -> &'static Value {
    TABLE.entries.get(path).map_or(&Value::Boolean(false), |(value, _)| value)
}

fn section_of(path: &str) -> &str {
    path.split_once('.').map_or("", |(section, _)| section)
}

/// `name:line:column` of a byte offset.
fn place(name: &str, text: &str, offset: usize) -> String {
    let before = &text[..offset.min(text.len())];
    let line = before.matches('\n').count() + 1;
    let column = before.chars().rev().take_while(|&c| c != '\n').count() + 1;
    format!("{name}:{line}:{column}")
}

/// A spanned value without its spans.
fn plain(value: &Spanned<DeValue<'_>>) -> Value {
    match value.get_ref() {
        DeValue::String(text) => Value::String(text.to_string()),
        DeValue::Integer(number) => i64::from_str_radix(number.as_str(), number.radix())
            .map_or_else(|_| Value::String(number.to_string()), Value::Integer),
        DeValue::Float(number) => {
            number.as_str().parse().map_or_else(|_| Value::String(number.to_string()), Value::Float)
        }
        DeValue::Boolean(flag) => Value::Boolean(*flag),
        DeValue::Datetime(date) => Value::Datetime(*date),
        DeValue::Array(items) => Value::Array(items.iter().map(plain).collect()),
        DeValue::Table(fields) => Value::Table(
            fields.iter().map(|(key, value)| (key.get_ref().to_string(), plain(value))).collect(),
        ),
    }
}

/// A value as TOML; text that is not valid TOML becomes a string.
fn parsed(text: &str) -> Value {
    toml::from_str::<Table>(&format!("value = {text}"))
        .ok()
        .and_then(|mut table| table.remove("value"))
        .unwrap_or_else(|| Value::String(text.to_string()))
}

/// A value for a message: TOML, but 1e308 not with all of its digits.
pub(crate) fn shown(value: &Value) -> String {
    match value {
        Value::Float(number) => format!("{number:?}"),
        Value::Array(values) => {
            format!("[{}]", values.iter().map(shown).collect::<Vec<_>>().join(", "))
        }
        value => value.to_string(),
    }
}

/// `value` in the type of the default; integers are accepted for floats. `Err` holds what was found and what is expected.
fn fit(default: &Value, value: Value) -> std::result::Result<Value, (String, &'static str)> {
    let found = shown(&value);
    match (default, value) {
        (Value::Float(_), Value::Integer(number)) => Ok(Value::Float(number as f64)),
        // A schedule of one value.
        (Value::Array(items), value @ (Value::Integer(_) | Value::Float(_))) if matches!(items.first(), Some(Value::Array(piece)) if piece.len() == 2) => {
            fit(default, Value::Array(vec![Value::Array(vec![Value::Float(0.0), value])]))
        }
        (Value::Array(items), Value::Array(values)) => match items.first() {
            None => Ok(Value::Array(values)),
            Some(item) => values
                .into_iter()
                .map(|value| fit(item, value))
                .collect::<std::result::Result<_, _>>()
                .map(Value::Array),
        },
        (default, value) if default.same_type(&value) => Ok(value),
        (default, _) => Err((
            found,
            match default {
                Value::String(_) => "a string",
                Value::Integer(_) => "a whole number",
                Value::Float(_) => "a number",
                Value::Boolean(_) => "true or false",
                Value::Array(_) => "a list",
                Value::Table(_) | Value::Datetime(_) => "a table",
            },
        )),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
        assert_eq!(settings.place("seed"), "run.toml:1:1: seed = 7");
        assert_eq!(settings.place("train.steps"), "--set: train.steps = 20");
    }

    #[test]
    fn a_number_is_a_schedule_of_one_value() {
        let mut settings = Settings::defaults();
        settings.apply_file("run.toml", "[renderer]\ncolor_weight = 0.5\n").unwrap();
        settings.apply_assignment("renderer.step_scale=2").unwrap();
        let config = crate::Config::from_settings(&settings).unwrap();
        assert_eq!(config.renderer.color_weight.values().collect::<Vec<_>>(), [0.5]);
        assert_eq!(config.renderer.step_scale.at(0.3), 2.0);
        assert!(settings.apply_assignment("optimizer.milestones=0.5").is_err(), "a list of numbers is none");
    }

    #[test]
    fn what_is_wrong_is_named_with_its_place() {
        let mut settings = Settings::defaults();
        let error = settings.apply_file("run.toml", "seed = 1\n[train]\n  stepz = 3\n").unwrap_err();
        assert!(
            error.message.starts_with("run.toml:3:3: unknown setting `train.stepz`; expected one of: "),
            "{error}"
        );
        assert!(error.message.contains("train.steps"), "{error}");
        let error = settings.apply_file("run.toml", "[trian]\nsteps = 3\n").unwrap_err();
        assert!(
            error.message.contains("unknown setting `trian`") && error.message.contains("train"),
            "{error}"
        );
        let error = settings.apply_file("run.toml", "[train]\nsteps = \"many\"\n").unwrap_err();
        assert!(
            error.message.contains("run.toml:2:1") && error.message.contains("a whole number"),
            "{error}"
        );
        let error = settings.apply_file("run.toml", "[train\n").unwrap_err();
        assert!(error.message.starts_with("run.toml:1:"), "{error}");
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
        assert_eq!(error.exit_code(), 2);
        for part in ["old.toml:2:1", "`encoder.channels` is 8", "expected 16"] {
            assert!(error.message.contains(part), "{part} in {error}");
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
        // A whole configuration names both, one of them 0.
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
