//! The one table of defaults: values and meanings of all settings, and the pages generated from it.

use crate::range::Range;

/// Every setting with its default and its meaning, as a configuration file.
pub const DEFAULTS: &str = include_str!("defaults.toml");

/// A section of the table of defaults; the settings above all sections have no name.
#[derive(Clone, Debug, PartialEq)]
pub struct DocumentedSection {
    /// Name, as between brackets.
    pub name: String,
    /// What the section is about.
    pub meaning: String,
    /// Its settings, in order.
    pub settings: Vec<DocumentedSetting>,
}

/// A setting of the table of defaults.
#[derive(Clone, Debug, PartialEq)]
pub struct DocumentedSetting {
    /// Key within its section.
    pub key: String,
    /// Default, as TOML.
    pub default: String,
    /// The numbers that it takes, such as `0 to 1024`; empty if it is no number.
    pub range: String,
    /// What it means.
    pub meaning: String,
}

/// The table of defaults, section by section.
pub fn documented() -> Vec<DocumentedSection> {
    let mut sections =
        vec![DocumentedSection { name: String::new(), meaning: "the run".into(), settings: Vec::new() }];
    for line in DEFAULTS.lines() {
        let (text, meaning) = line.split_once(" # ").unwrap_or((line, ""));
        let meaning = meaning.trim().to_string();
        if let Some(name) = text.trim().strip_prefix('[').and_then(|text| text.strip_suffix(']')) {
            sections.push(DocumentedSection { name: name.into(), meaning, settings: Vec::new() });
        } else if let Some((key, default)) = text.split_once(" = ")
            && !line.starts_with('#')
            && let Some(section) = sections.last_mut()
        {
            let [key, default] = [key, default].map(|part| part.trim().to_string());
            let (range, meaning) = match meaning.split_once(": ") {
                Some((range, meaning)) if Range::parse(range).is_some() => (range.into(), meaning.into()),
                _ => (String::new(), meaning),
            };
            section.settings.push(DocumentedSetting { key, default, range, meaning });
        }
    }
    sections
}

impl DocumentedSection {
    /// The settings as a table in Markdown.
    pub fn markdown(&self) -> String {
        let cell = |text: &str| ['|', '<', '[', '*'].iter().fold(text.to_string(), escaped);
        let mut table = "| setting | default | range | meaning |\n|---|---|---|---|\n".to_string();
        for DocumentedSetting { key, default, range, meaning } in &self.settings {
            table += &format!("| `{key}` | `{default}` | {range} | {} |\n", cell(meaning));
        }
        table
    }
}

/// The page of all settings in Markdown.
pub fn settings_page() -> String {
    let mut page = "# Settings\n\n\
        <!-- Generated from trimip-core/src/defaults.toml; TRIMIP_WRITE_DOCS=1 cargo test -p trimip-core renews it. -->\n\n\
        A configuration file names only what it changes; `--set section.key=value` overrides the file. Unknown keys are\n\
        refused. A range holds for each number of a list, and for the values of pairs \\[fraction of the run, value].\n\
        `trimip-cli config` prints every value and where it came from. \"Paper\" is Tri-MipRF (ICCV 2023), \"code\"\n\
        is its authors' PyTorch implementation.\n"
        .to_string();
    for section in documented() {
        let heading = match section.name.as_str() {
            "" => "Above all sections".to_string(),
            name => format!("`[{name}]`"),
        };
        page += &format!("\n## {heading}\n\n{}.\n\n{}", sentence(&section.meaning), section.markdown());
    }
    page
}

/// With a backslash before every `sign`, so that Markdown takes it as it is.
fn escaped(text: String, sign: &char) -> String {
    text.replace(*sign, &format!("\\{sign}"))
}

/// With a capital at the beginning.
fn sentence(text: &str) -> String {
    let mut rest = text.chars();
    rest.next().map_or_else(String::new, |first| first.to_uppercase().chain(rest).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Settings;
    use std::path::Path;

    #[test]
    fn every_setting_is_documented_once() {
        let sections = documented();
        let paths: Vec<String> = sections
            .iter()
            .flat_map(|section| {
                let path = |key: &str| match section.name.as_str() {
                    "" => key.to_string(),
                    name => format!("{name}.{key}"),
                };
                section.settings.iter().map(move |setting| path(&setting.key)).collect::<Vec<_>>()
            })
            .collect();
        let settings = Settings::defaults();
        let mut sorted = paths.clone();
        sorted.sort();
        assert_eq!(sorted, settings.iter().map(|(path, ..)| path).collect::<Vec<_>>());
        assert!(sections.iter().all(|section| !section.meaning.is_empty()));
        for setting in sections.iter().flat_map(|section| &section.settings) {
            assert!(!setting.meaning.is_empty(), "{} has no meaning", setting.key);
        }
    }

    /// The generated files are up to date: the page of settings, and the tables in the documentation of the sections.
    #[test]
    fn generated_pages_are_those_of_the_table_of_defaults() {
        let root = Path::new(env!("CARGO_MANIFEST_DIR"));
        let mut files = vec![(root.join("../docs/settings.md"), settings_page())];
        files.extend(documented().into_iter().filter(|section| !section.name.is_empty()).map(|section| {
            (root.join(format!("src/config/tables/{}.md", section.name)), section.markdown())
        }));
        for (path, text) in files {
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
