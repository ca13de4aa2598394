//! Sections of settings that crates other than core own. A crate implements [`Section`] for its typed section. The program
//! registers the section with [`ForeignSection::of`], and [`Config::section`](crate::Config::section) reads it.

use super::checker::Checker;
use super::values::{fit, shown};
use crate::config::defaults::{Addition, ForeignSection, Fragment, definitions_of};
use crate::{Advice, Error, Place, Result};
use serde::{Serialize, de::DeserializeOwned};
use std::collections::BTreeMap;
use toml::{Table, Value};

/// A typed section of settings that a crate other than core owns. Its fields may include core's settings of the same
/// section.
///
/// ```
/// use serde::{Deserialize, Serialize};
/// use trimip_core::{Checker, Config, Definitions, ForeignSection, Fragment, Result, Section, Settings};
///
/// #[derive(Serialize, Deserialize)]
/// struct Lamp {
///     watts: f64,
/// }
///
/// impl Section for Lamp {
///     const NAME: &'static str = "lamp";
///     const FRAGMENTS: &'static [Fragment] = &[Fragment {
///         after: "",
///         table: r#"
/// [lamp]
/// section = { free = true, meaning = "a lamp" }
/// watts = { default = 60.0, range = [0, 100], meaning = "its power" }
/// "#,
///     }];
/// }
///
/// let definitions = Definitions::new(&[ForeignSection::of::<Lamp>()], &[]);
/// let settings = Settings::of(definitions.into()).with("lamp.watts", 40.0)?;
/// assert_eq!(Config::from_settings(&settings)?.section::<Lamp>()?.watts, 40.0);
/// # Ok::<(), trimip_core::Error>(())
/// ```
pub trait Section: Serialize + DeserializeOwned {
    /// Name, as written between brackets.
    const NAME: &'static str;
    /// Settings that the crate adds to the section, in order.
    const FRAGMENTS: &'static [Fragment];
    /// Addition of the section to another part of the program, such as
    /// [loss terms](crate::field::losses::LossSection).
    const ADDITION: Option<Addition> = None;

    /// Refuses settings that contradict each other.
    ///
    /// # Errors
    /// The error names the setting, its place and what is expected.
    fn check(&self, to: &Checker<'_>) -> Result<()> {
        let _ = to;
        Ok(())
    }
}

impl ForeignSection {
    /// Returns the section that the type `S` describes.
    pub const fn of<S: Section>() -> Self {
        Self { name: S::NAME, fragments: S::FRAGMENTS, check: check::<S>, addition: S::ADDITION }
    }
}

fn check<S: Section>(table: &Table, to: &Checker<'_>) -> Result<()> {
    read::<S>(table, to).map(drop)
}

/// Reads the typed section from `table`. Settings missing from `table` have their defaults.
pub(crate) fn read<S: Section>(table: &Table, to: &Checker<'_>) -> Result<S> {
    let mut table = table.clone();
    for (key, definition) in S::FRAGMENTS.iter().flat_map(definitions_of) {
        let path = format!("{}.{key}", S::NAME);
        let value = match table.remove(&key) {
            Some(value) => fit(&definition.default, value).map_err(|(found, expected)| {
                Error::input(
                    to.place(&path),
                    format!("`{path}` is {found}"),
                    Advice::Expected(expected.to_string()),
                )
            })?,
            None => definition.default,
        };
        if let Some(range) = definition.range {
            to.check(range.holds(&value), &path, &range.expected(&value))?;
        }
        table.insert(key, value);
    }
    let whole = Table::from_iter([(S::NAME.to_string(), Value::Table(table))]);
    let mut whole: BTreeMap<String, S> = typed(whole, to)?;
    let section = whole.remove(S::NAME).unwrap_or_else(|| unreachable!("it was put in above"));
    section.check(to)?;
    Ok(section)
}

/// Reads the typed form of a table of settings.
///
/// # Errors
/// When the typed form rejects a value. The error names the place where the value was set.
pub(crate) fn typed<T: DeserializeOwned>(table: Table, to: &Checker<'_>) -> Result<T> {
    serde_path_to_error::deserialize(table).map_err(|error| {
        let path = error.path().to_string();
        // If the error is in an element of a list, name the setting that holds the whole list.
        let setting = path.split('[').next().unwrap_or_default();
        let advice = "see its meaning in the table of settings";
        Error::input(to.place(setting), error.into_inner().message(), advice)
    })
}

/// Returns the place of a value in a configuration in memory, for an error.
pub(crate) fn in_memory(path: &str, value: Option<&Value>) -> Place {
    value.map_or(path.into(), |value| format!("configuration: {path} = {}", shown(value)).into())
}
