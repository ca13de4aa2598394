//! Settings of crates other than core in a configuration: their values, and their positions in the configuration's text.

use super::Config;
use crate::config::defaults::{Definitions, ForeignSection, Placed};
use crate::config::settings::checker::Checker;
use crate::config::settings::section::{Section, in_memory, read};
use crate::config::settings::text::{insert, parts_of};
use crate::config::settings::values::line;
use crate::{Error, Result, Settings};
use std::collections::BTreeMap;
use std::sync::Arc;
use toml::{Table, Value};

/// Values of settings that other crates own, as they were read. A setting without a value has its default.
#[derive(Clone)]
pub struct Foreign {
    definitions: Arc<Definitions>,
    carried: Vec<Placed>,
    values: BTreeMap<String, Value>,
}

impl Default for Foreign {
    fn default() -> Self {
        Self { definitions: Definitions::core(), carried: Vec::new(), values: BTreeMap::new() }
    }
}

impl std::fmt::Debug for Foreign {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_map().entries(&self.values).finish()
    }
}

impl PartialEq for Foreign {
    fn eq(&self, other: &Self) -> bool {
        let mut paths = self.values.keys().chain(other.values.keys());
        paths.all(|path| self.value(path, other) == other.value(path, self))
    }
}

impl Foreign {
    /// Collects the foreign values of `settings`.
    pub(super) fn of(settings: &Settings) -> Self {
        let core = Definitions::core();
        let foreign = settings.iter().filter(|(path, ..)| core.default(path).is_none());
        Self {
            definitions: settings.definitions().clone(),
            carried: settings.carried().to_vec(),
            values: foreign.map(|(path, value, _)| (path.to_string(), value.0)).collect(),
        }
    }

    /// Returns the definitions with which this configuration was made.
    pub(super) fn definitions(&self) -> &Arc<Definitions> {
        &self.definitions
    }

    /// Returns the paths of the values.
    pub(super) fn paths(&self) -> impl Iterator<Item = &String> {
        self.values.keys()
    }

    /// Returns a value, or its default from the definitions of `self` or `other`.
    pub(super) fn value<'a>(&'a self, path: &str, other: &'a Self) -> Option<&'a Value> {
        let default = || self.definitions.default(path).or(other.definitions.default(path));
        self.values.get(path).or_else(default)
    }

    /// Inserts the values into the text of core's settings, each at its position.
    pub(super) fn put_into(&self, text: &str) -> String {
        let mut lines: Vec<String> = text.lines().map(String::from).collect();
        let carried = self.carried.iter().filter(|setting| self.definitions.default(&setting.path).is_none());
        for Placed { path, after } in self.definitions.placed().iter().chain(carried) {
            if let Some(value) = self.values.get(path) {
                let (section, key) = parts_of(path);
                insert(&mut lines, &format!("[{section}]"), after, line(key, value));
            }
        }
        lines.join("\n") + "\n"
    }
}

impl Config {
    /// Returns the sections of other crates that the program registered.
    pub(crate) fn registered_sections(&self) -> &[ForeignSection] {
        self.foreign.definitions.registered()
    }

    /// Returns a section that another crate owns, in its typed form. Settings that this configuration does not name have
    /// their defaults.
    ///
    /// # Errors
    /// The error names the first setting whose value has the wrong type or is out of range.
    pub fn section<S: Section>(&self) -> Result<S> {
        let settings = self.as_settings();
        let table = settings.table();
        let own = table.get(S::NAME).and_then(Value::as_table);
        let value = |path: &str| own.and_then(|own| own.get(parts_of(path).1));
        read(own.unwrap_or(&Table::new()), &Checker::new(&|path| in_memory(path, value(path)), &|_| true))
    }

    /// Changes a section that another crate owns.
    ///
    /// # Errors
    /// Fails for the reasons of [`section`](Self::section), and if a number does not fit into 63 bits.
    pub fn change<S: Section>(&mut self, change: impl FnOnce(&mut S)) -> Result<()> {
        let mut section = self.section::<S>()?;
        change(&mut section);
        let text = toml::to_string(&BTreeMap::from([(S::NAME, &section)]));
        let text =
            text.map_err(|error| Error::input(S::NAME, error.to_string(), "use numbers below 2^63"))?;
        let definitions = self.foreign.definitions.with(ForeignSection::of::<S>());
        let mut settings = Settings::carrying(definitions);
        settings.apply_file("config", &self.whole_text())?;
        settings.apply_file("code", &text)?;
        *self = Self::of_settings(&settings, &Checker::new(&|path| settings.place(path), &|_| true))?;
        Ok(())
    }
}
