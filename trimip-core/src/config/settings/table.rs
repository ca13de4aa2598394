//! Reads tables of settings. A setting is a line `key = { default, range, free, meaning }`, and a section begins with
//! `section = { meaning, shared, free }`.

use super::values::plain;
use crate::config::range::Range;
use serde::Deserialize;
use toml::de::{DeTable, DeValue};
use toml::{Table, Value};

/// An entry of a table.
pub(crate) enum Item {
    /// The beginning of a section.
    Section { name: String, meaning: String, shared: bool, free: bool },
    /// A setting of the section before it.
    Setting { key: String, default: Value, range: Option<Range>, free: bool, meaning: String },
}

/// Key of the description of a section.
const HEAD: &str = "section";

/// Key that every setting has and no section has.
const DEFAULT: &str = "default";

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Head {
    meaning: String,
    #[serde(default)]
    shared: bool,
    #[serde(default)]
    free: bool,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Row {
    default: Value,
    range: Option<[Value; 2]>,
    #[serde(default)]
    free: bool,
    meaning: String,
}

/// Returns the sections and settings of a table, in order. Tables are compiled in and tested.
///
/// # Panics
/// If the text is not a table of settings.
pub(crate) fn items(text: &str) -> Vec<Item> {
    let table = DeTable::parse(text).unwrap_or_else(|error| panic!("not a table of settings: {error}"));
    let mut found = Vec::new();
    collect(table.get_ref(), &mut found);
    found
}

/// Adds the entries of a table in the order of the text.
fn collect(table: &DeTable<'_>, found: &mut Vec<Item>) {
    let mut entries: Vec<_> = table.iter().collect();
    entries.sort_by_key(|(key, _)| key.span().start);
    for (key, value) in entries {
        let (name, DeValue::Table(inner)) = (key.get_ref().to_string(), value.get_ref()) else {
            panic!("`{}` is not a table", key.get_ref());
        };
        if inner.contains_key(DEFAULT) {
            let Row { default, range, free, meaning } = read(&name, inner);
            found.push(Item::Setting { key: name, default, range: range.map(Range::new), free, meaning });
        } else if name != HEAD {
            let head = inner.get(HEAD).and_then(|head| head.get_ref().as_table());
            let head = head.unwrap_or_else(|| panic!("[{name}] has no `{HEAD}`"));
            let Head { meaning, shared, free } = read(&name, head);
            found.push(Item::Section { name, meaning, shared, free });
            collect(inner, found);
        }
    }
}

fn read<T: serde::de::DeserializeOwned>(name: &str, table: &DeTable<'_>) -> T {
    let fields = table.iter().map(|(key, value)| (key.get_ref().to_string(), plain(value)));
    Table::from_iter(fields).try_into().unwrap_or_else(|error| panic!("`{name}`: {error}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAMP: &str = r#"
above = { default = true, meaning = "above all sections" }

[lamp]
section = { free = true, meaning = "a lamp" }
watts = { default = 60.0, range = [0, 1e3], meaning = "its power" }
tint = { default = "warm", free = true, meaning = 'its colour: "warm" | "cold"' }
"#;

    #[test]
    fn settings_are_read_in_order() {
        let found: Vec<String> = items(LAMP)
            .iter()
            .map(|item| match item {
                Item::Section { name, meaning, shared, free } => {
                    format!("[{name}] {meaning} {shared} {free}")
                }
                Item::Setting { key, default, range, free, meaning } => {
                    let range = range.as_ref().map_or(String::new(), Range::to_string);
                    format!("{key} {default} {range} {free} {meaning}")
                }
            })
            .collect();
        let expected = [
            "above true  false above all sections",
            "[lamp] a lamp false true",
            "watts 60.0 0 to 1e3 false its power",
            "tint \"warm\"  true its colour: \"warm\" | \"cold\"",
        ];
        assert_eq!(found, expected);
    }

    #[test]
    fn other_tables_are_refused() {
        for text in [
            "watts = 60.0",
            "[lamp]\nwatts = { default = 60.0, meaning = \"its power\" }",
            "watts = { default = 60.0 }",
            "watts = { default = 60.0, meaning = \"its power\", colour = 3 }",
        ] {
            assert!(std::panic::catch_unwind(|| items(text)).is_err(), "{text}");
        }
    }
}
