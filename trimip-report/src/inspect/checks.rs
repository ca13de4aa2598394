//! The checks of a capture on its page: suspicious checks with advice, all checks with their limits, and the figures of every view.

use super::super::page::{escape, table};
use super::space::number;
use trimip::data::checks::{Check, Values, Verdict, name};
use trimip::inspect::Inspection;

/// Maximum number of views that are listed for one check.
const LISTED: usize = 40;

/// Returns all three sections.
pub fn sections(seen: &Inspection) -> String {
    [suspicious(seen), every(seen), views(seen)].concat()
}

fn suspicious(seen: &Inspection) -> String {
    let told: String = seen.checks.iter().filter_map(|check| card(seen, check)).collect();
    let content = match told.is_empty() {
        true => "<p>Nothing is beyond the limits below.</p>".to_string(),
        false => told,
    };
    format!("<section><h2>Suspicious</h2>{content}</section>\n")
}

/// Returns a suspicious check with its views.
fn card(seen: &Inspection, check: &Check) -> Option<String> {
    let Verdict::Suspicious(advice) = check.verdict else { return None };
    let train = &seen.seen.scene.train;
    let mut names: Vec<String> = check
        .suspects
        .iter()
        .take(LISTED)
        .map(|suspect| format!("{} ({})", name(train, suspect.view).unwrap_or("?"), suspect.figure))
        .collect();
    if check.suspects.len() > LISTED {
        names.push(format!("{} more", check.suspects.len() - LISTED));
    }
    let views = match names.is_empty() {
        true => String::new(),
        false => format!("<p>Views: {}.</p>", escape(&names.join(", "))),
    };
    Some(format!(
        "<h3>{} <b class=\"badge doubtful\">suspicious</b></h3><p>{}.</p>{views}<p><b>What to do:</b> {}.</p>",
        escape(check.name),
        escape(&check.figure),
        escape(advice)
    ))
}

fn every(seen: &Inspection) -> String {
    let row = |check: &Check| {
        let (class, verdict) = match check.verdict {
            Verdict::Fine => ("good", "fine"),
            Verdict::Suspicious(_) => ("doubtful", "suspicious"),
            Verdict::Unknown => ("plain", "not known"),
        };
        format!(
            "<tr><td>{}</td><td><b class=\"badge {class}\">{verdict}</b></td><td>{}</td><td>{}</td></tr>",
            escape(check.name),
            escape(&check.figure),
            escape(&check.limit)
        )
    };
    format!(
        "<section><h2>All checks</h2><div class=\"scroll\"><table><tr><th>check</th><th>conclusion</th><th>found</th>\
         <th>suspicious if</th></tr>{}</table></div></section>\n",
        seen.checks.iter().map(row).collect::<String>()
    )
}

/// Returns the table with the figures of all training views.
fn views(seen: &Inspection) -> String {
    let train = &seen.seen.scene.train;
    let columns: Vec<&Values> = seen.checks.iter().flat_map(|check| &check.values).collect();
    if columns.is_empty() {
        return String::new();
    }
    let mut rows = vec![vec!["view".to_string()]];
    rows[0].extend(columns.iter().map(|values| values.name.to_string()));
    for view in 0..train.scales.first().map_or(0, |scale| scale.views.len()) {
        let mut row = vec![name(train, view).unwrap_or("?").to_string()];
        let figure = |values: &&Values| values.of.get(view).copied().flatten().map_or("–".into(), number);
        row.extend(columns.iter().map(figure));
        rows.push(row);
    }
    format!(
        "<section><details><summary>Figures of every training view</summary>{}</details></section>\n",
        table(&rows, false)
    )
}
