//! Definitions of settings: default, range, meaning, and whether a resumed run may change the setting. Core's definitions
//! are in the table `defaults.toml`. Other crates add [`ForeignSection`]s: tables of the same syntax, which are inserted
//! into core's.

use crate::Result;
use crate::config::range::Range;
use crate::config::settings::checker::Checker;
use crate::config::settings::table::{Item, items};
use crate::config::settings::values::shown;
use std::any::Any;
use std::collections::BTreeMap;
use std::sync::{Arc, LazyLock};
use toml::{Table, Value};

/// Core's table of settings.
const CORE: &str = include_str!("defaults.toml");

/// Column at which the meanings begin in [`Definitions::text`].
const COLUMN: usize = 32;

/// Consecutive settings of a section.
#[derive(Clone, Copy, Debug)]
pub struct Fragment {
    /// Key of the setting that the first of them follows; empty if they begin their section.
    pub after: &'static str,
    /// The settings, in the syntax of core's table.
    pub table: &'static str,
}

/// A section that a crate other than core owns, or that crate's settings in a section that it shares with core.
/// `ForeignSection::of` makes it from a [`Section`](crate::Section).
#[derive(Clone, Copy)]
pub struct ForeignSection {
    /// Name, as written between brackets.
    pub name: &'static str,
    /// Its settings.
    pub fragments: &'static [Fragment],
    /// Checks the values of the section, given as a table.
    pub(crate) check: fn(&Table, &Checker<'_>) -> Result<()>,
    /// Addition to another top-level module of core, such as loss terms.
    pub(crate) addition: Option<Addition>,
}

/// Addition of a section to another top-level module of core. Only that module knows its type.
/// [`losses::addition`](crate::field::losses::addition) makes one for loss terms.
#[derive(Clone, Copy)]
pub struct Addition(pub(crate) &'static (dyn Any + Send + Sync));

/// A section of the table of settings. The settings above all sections form a section without a name.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct DocumentedSection {
    /// Name, as written between brackets.
    pub name: String,
    /// Meaning of the section.
    pub meaning: String,
    /// True if crates other than core may add settings to the section.
    pub shared: bool,
    /// True if a resumed run may change all of its settings.
    pub free: bool,
    /// Its settings, in order.
    pub settings: Vec<DocumentedSetting>,
}

/// A setting of the table of settings.
#[derive(Clone, Debug, PartialEq)]
pub struct DocumentedSetting {
    /// Key within its section.
    pub key: String,
    /// Default, as TOML.
    pub default: String,
    /// Range of its numbers, such as `0 to 1024`; empty if the setting is not a number.
    pub range: String,
    /// Meaning, as in the table.
    pub meaning: String,
    /// True if a resumed run may change it.
    pub free: bool,
}

/// Path of a setting of a crate other than core, and the key of the setting that it follows in its section.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Placed {
    pub path: String,
    pub after: String,
}

/// Definition of a setting.
#[derive(Clone, Debug)]
pub(crate) struct Definition {
    pub default: Value,
    pub range: Option<Range>,
    pub free: bool,
}

/// Definitions of all settings of a program: those of core and those of the sections that the program registered.
pub struct Definitions {
    documented: Vec<DocumentedSection>,
    known: BTreeMap<String, Definition>,
    registered: Vec<ForeignSection>,
    placed: Vec<Placed>,
    /// Names of sections that only other builds define.
    absent: Vec<&'static str>,
}

/// Definitions of core's settings only.
static CORE_ALONE: LazyLock<Arc<Definitions>> = LazyLock::new(|| Arc::new(Definitions::new(&[], &[])));

impl Definitions {
    /// Definitions of core's settings only.
    pub fn core() -> Arc<Self> {
        CORE_ALONE.clone()
    }

    /// Returns the definitions of core's settings and those of `sections`. `absent` names the sections of crates that this
    /// build lacks: their settings are kept as given, and nothing reads them.
    ///
    /// # Panics
    /// If a fragment's table, which is compiled into its crate, is not a table of settings.
    pub fn new(sections: &[ForeignSection], absent: &[&'static str]) -> Self {
        let mut definitions = Self {
            documented: vec![DocumentedSection { meaning: "the run".into(), ..DocumentedSection::default() }],
            known: BTreeMap::new(),
            registered: sections.to_vec(),
            placed: Vec::new(),
            absent: absent.to_vec(),
        };
        definitions.add(CORE, None);
        for fragment in sections.iter().flat_map(|section| section.fragments) {
            definitions.add(fragment.table, Some(fragment.after));
        }
        definitions
    }

    /// Adds the settings of a table to their sections: core's at the end, those of other crates after the key `after`.
    fn add(&mut self, table: &'static str, after: Option<&'static str>) {
        let (mut at, mut all_free, mut after) = (0, false, after.map(String::from));
        for item in items(table) {
            match item {
                Item::Section { name, meaning, shared, free } => {
                    let found = self.documented.iter().position(|section| section.name == name);
                    at = found.unwrap_or_else(|| {
                        let section = DocumentedSection { name, meaning, shared, free, settings: Vec::new() };
                        self.documented.push(section);
                        self.documented.len() - 1
                    });
                    all_free = free;
                }
                Item::Setting { key, default, range, free, meaning } => {
                    let free = free || all_free;
                    let section = &mut self.documented[at];
                    let path = match section.name.as_str() {
                        "" => key.clone(),
                        name => format!("{name}.{key}"),
                    };
                    let setting = DocumentedSetting {
                        key: key.clone(),
                        default: shown(&default),
                        range: range.as_ref().map_or(String::new(), Range::to_string),
                        meaning,
                        free,
                    };
                    match &mut after {
                        None => section.settings.push(setting),
                        Some(after) => {
                            section.insert(after, setting);
                            let after = std::mem::replace(after, key);
                            self.placed.push(Placed { path: path.clone(), after });
                        }
                    }
                    self.known.insert(path, Definition { default, range, free });
                }
            }
        }
    }

    /// Returns these definitions with those of `section` added, unless the section is registered already.
    pub(crate) fn with(self: &Arc<Self>, section: ForeignSection) -> Arc<Self> {
        if self.registered.iter().any(|known| known.name == section.name) {
            return self.clone();
        }
        let all = [&self.registered[..], &[section]].concat();
        Arc::new(Self::new(&all, &self.absent))
    }

    /// Returns a configuration file that has every setting with its default, its range and its meaning.
    pub fn text(&self) -> String {
        let mut text = "# Every setting with its default. A configuration file names only the settings it changes; unknown keys are refused.\n\
            # \"1 to 8: ..\" is the range of a number, of each number of a list, or of the values in pairs [fraction of the run, value].\n\
            # \"free: ..\" marks a setting, or a whole section, that a resumed run may change.\n\
            # \"Paper\" is Tri-MipRF (ICCV 2023), \"code\" is its authors' PyTorch implementation.\n\n"
            .to_string();
        for section in &self.documented {
            if !section.name.is_empty() {
                let free = if section.free { "free: " } else { "" };
                text += &format!("\n{:COLUMN$}# {free}{}\n", format!("[{}]", section.name), section.meaning);
            }
            for DocumentedSetting { key, default, range, meaning, free } in &section.settings {
                let free = if *free && !section.free { "free: " } else { "" };
                let range = if range.is_empty() { String::new() } else { format!("{range}: ") };
                let line = format!("{key} = {default}");
                text += &format!("{line:0$}# {free}{range}{meaning}\n", COLUMN.max(line.len() + 1));
            }
        }
        text
    }

    /// Returns the settings, section by section.
    pub fn documented(&self) -> &[DocumentedSection] {
        &self.documented
    }

    /// Iterates over the dotted path and the default of every setting, sorted by path.
    pub(crate) fn defaults(&self) -> impl Iterator<Item = (&str, &Value)> {
        self.known.iter().map(|(path, definition)| (path.as_str(), &definition.default))
    }

    /// Returns the default of a setting, which also determines the setting's type; `None` for unknown settings.
    pub(crate) fn default(&self, path: &str) -> Option<&Value> {
        self.known.get(path).map(|definition| &definition.default)
    }

    /// Returns the range of a setting; `None` if it has none.
    pub(crate) fn range(&self, path: &str) -> Option<&Range> {
        self.known.get(path)?.range.as_ref()
    }

    /// Returns true for a setting that a resumed run may change.
    pub fn is_free(&self, path: &str) -> bool {
        self.known.get(path).is_some_and(|definition| definition.free)
    }

    /// Returns the registered sections of crates other than core.
    pub(crate) fn registered(&self) -> &[ForeignSection] {
        &self.registered
    }

    /// Returns the settings of crates other than core, in order.
    pub(crate) fn placed(&self) -> &[Placed] {
        &self.placed
    }

    /// Returns true for a section that only other builds define.
    pub(crate) fn is_absent(&self, section: &str) -> bool {
        self.absent.contains(&section)
    }

    /// Returns true for a section that may have settings beyond these definitions, because it is shared or unknown.
    pub(crate) fn may_have_more(&self, section: &str) -> bool {
        self.documented.iter().find(|known| known.name == section).is_none_or(|known| known.shared)
    }
}

/// Returns the key and the definition of each setting of a fragment.
pub(crate) fn definitions_of(fragment: &Fragment) -> impl Iterator<Item = (String, Definition)> {
    items(fragment.table).into_iter().filter_map(|item| match item {
        Item::Setting { key, default, range, free, .. } => Some((key, Definition { default, range, free })),
        Item::Section { .. } => None,
    })
}

impl DocumentedSection {
    /// Inserts a setting after the key `after`; at the beginning if `after` is empty, at the end if no setting has that key.
    fn insert(&mut self, after: &str, setting: DocumentedSetting) {
        let at = match after {
            "" => 0,
            after => {
                self.settings.iter().position(|own| own.key == after).map_or(self.settings.len(), |at| at + 1)
            }
        };
        self.settings.insert(at, setting);
    }

    /// Returns the settings as a table in Markdown.
    pub fn markdown(&self) -> String {
        let cell = |text: &str| ['|', '<', '[', '*'].into_iter().fold(text.to_string(), escaped);
        let mut table = "| setting | default | range | meaning |\n|---|---|---|---|\n".to_string();
        for DocumentedSetting { key, default, range, meaning, .. } in &self.settings {
            table += &format!("| `{key}` | `{default}` | {range} | {} |\n", cell(meaning));
        }
        table
    }
}

impl Definitions {
    /// Returns the page of all settings in Markdown.
    pub fn page(&self) -> String {
        let mut page = "# Settings\n\n\
            <!-- Generated from the tables of settings of all crates; TRIMIP_WRITE_DOCS=1 cargo test -p trimip generated renews it. -->\n\n\
            A configuration file names only what it changes; `--set section.key=value` overrides the file. Unknown keys are\n\
            refused. A range holds for each number of a list, and for the values of pairs \\[fraction of the run, value].\n\
            `trimip-cli config` prints every value and where it came from. \"Paper\" is Tri-MipRF (ICCV 2023), \"code\"\n\
            is its authors' PyTorch implementation.\n"
            .to_string();
        for section in self.documented() {
            let heading = match section.name.as_str() {
                "" => "Above all sections".to_string(),
                name => format!("`[{name}]`"),
            };
            page += &format!("\n## {heading}\n\n{}.\n\n{}", sentence(&section.meaning), section.markdown());
        }
        page
    }
}

/// Puts a backslash before every `sign`, so that Markdown shows it literally.
fn escaped(text: String, sign: char) -> String {
    text.replace(sign, &format!("\\{sign}"))
}

/// Capitalises the first letter.
fn sentence(text: &str) -> String {
    let mut rest = text.chars();
    rest.next().map_or_else(String::new, |first| first.to_uppercase().chain(rest).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn every_setting_is_documented_once_and_every_number_has_a_range_that_holds_its_default() {
        let definitions = Definitions::core();
        let mut paths: Vec<String> = Vec::new();
        for section in definitions.documented() {
            assert!(!section.meaning.is_empty());
            for setting in &section.settings {
                assert!(!setting.meaning.is_empty(), "{} has no meaning", setting.key);
                paths.push(format!("{}.{}", section.name, setting.key).trim_start_matches('.').to_string());
            }
        }
        paths.sort();
        assert_eq!(paths, definitions.defaults().map(|(path, _)| path).collect::<Vec<_>>());
        for (path, value) in definitions.defaults() {
            let numeric = match value {
                Value::Array(values) => values.iter().all(|value| !value.is_str()),
                value => value.is_integer() || value.is_float(),
            };
            assert_eq!(definitions.range(path).is_some(), numeric, "{path}");
            assert!(definitions.range(path).is_none_or(|range| range.holds(value)), "{path}");
        }
    }

    #[test]
    fn what_a_run_may_change_is_marked_in_the_table() {
        let definitions = Definitions::core();
        for path in ["backend", "threads", "memory", "data.root", "eval.stride", "plan.aabb", "file.planes"] {
            assert!(definitions.is_free(path), "{path}");
        }
        for path in ["seed", "train.steps", "data.scales", "encoder.kind", "no.such"] {
            assert!(!definitions.is_free(path), "{path}");
        }
    }

    /// Checks that the tables in the documentation of core's sections are up to date.
    #[test]
    fn generated_tables_are_those_of_the_table_of_defaults() {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("src/config/tables");
        for section in Definitions::core().documented().iter().filter(|section| !section.name.is_empty()) {
            let (path, text) = (folder.join(format!("{}.md", section.name)), section.markdown());
            if std::env::var_os("TRIMIP_WRITE_DOCS").is_some() {
                std::fs::write(&path, &text).unwrap();
            }
            let found = std::fs::read_to_string(&path).unwrap_or_default().replace("\r\n", "\n");
            assert!(
                found == text,
                "{} is out of date; renew it with TRIMIP_WRITE_DOCS=1 cargo test -p trimip-core generated",
                path.display()
            );
        }
    }
}
