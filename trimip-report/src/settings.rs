//! The settings in the report: first those that were chosen, then, folded, those with default values.

use super::page::escape;
use trimip::settings::{SettingRow, rows};
use trimip::{Origin, Settings};

/// Returns the section with the settings.
pub fn section(settings: &Settings) -> String {
    let rows = rows(settings);
    let (set, defaults): (Vec<_>, Vec<_>) = rows.iter().partition(|row| row.origin != Origin::Default);
    let table = |rows: &[&SettingRow]| {
        let body: String = rows.iter().map(|row| setting(row)).collect();
        format!(
            "<div class=\"scroll\"><table class=\"settings\"><tr><th>setting</th><th>value</th><th>from</th>\
             <th class=\"m\">meaning</th></tr>{body}</table></div>"
        )
    };
    let chosen =
        if set.is_empty() { "<p>Every setting has its default.</p>".to_string() } else { table(&set) };
    format!(
        "<section><h2>Settings</h2>{chosen}<details><summary>{} settings at their defaults</summary>{}</details></section>\n",
        defaults.len(),
        table(&defaults)
    )
}

fn setting(row: &SettingRow) -> String {
    let path = if row.section.is_empty() { row.key.clone() } else { format!("{}.{}", row.section, row.key) };
    let class = if row.origin == Origin::Default { "" } else { " class=\"set\"" };
    format!(
        "<tr{class}><td class=\"k\">{path}</td><td class=\"v\">{}</td><td class=\"o\">{}</td><td class=\"m o\">{}</td></tr>",
        escape(&row.value),
        escape(&row.origin.to_string()),
        escape(&row.meaning)
    )
}
