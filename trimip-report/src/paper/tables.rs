//! The tables of the page: the measurements made here, with the best value of a column in bold and the second best
//! underlined, and the published figures.

use super::look::mark;
use crate::comparison::{
    Comparison, Scales, TableRow, columns, published_caption, published_cells, published_columns,
};
use crate::page::escape;
use trimip::systems::{Kind, SYSTEMS};

/// Maximum number of scenes for which the table of each scene is unfolded.
const OPEN: usize = 2;

/// Returns the tables of the measurements.
pub fn measured(comparison: &Comparison, scales: Scales) -> String {
    let mut html = String::new();
    if comparison.scenes.len() > 1 {
        html += "<h3>Mean over the scenes of each scene’s mean</h3>";
        html += &table(scales, &comparison.whole_rows(scales));
    }
    for scene in &comparison.scenes {
        let rows = table(scales, &comparison.scene_rows(scales, scene));
        html += &match comparison.scenes.len() {
            0..=OPEN => format!("<h3>{}</h3>{rows}", escape(scene)),
            _ => format!("<details><summary>{}</summary>{rows}</details>", escape(scene)),
        };
    }
    format!(
        "<section class=\"wide\"><h2>{}, measured here</h2>{html}<p class=\"lead\">PSNR in dB. “plain” is the mean without the edge \
         exponents of the set, like the published figures. “published” is the papers’ figure, with their own splits, backgrounds and \
         machines.</p></section>\n",
        scales.title()
    )
}

/// Returns a table of rows, with the best and the second best value of each column marked.
fn table(scales: Scales, rows: &[TableRow]) -> String {
    let columns = columns(scales, rows);
    let mut html = "<div class=\"scroll\"><table class=\"dense\"><tr><th>system</th>".to_string();
    for column in &columns {
        html += &format!("<th class=\"n\">{}</th>", escape(&column.head));
    }
    html += "</tr>";
    let ranks: Vec<Vec<usize>> = columns
        .iter()
        .map(|column| column.value.as_ref().map_or_else(Vec::new, |value| ranks(rows, value)))
        .collect();
    for (i, row) in rows.iter().enumerate() {
        html += &format!("<tr><td>{}{}{}</td>", mark(row.system), escape(row.title), tag(row.system));
        for (column, ranks) in columns.iter().zip(&ranks) {
            let class = match ranks.get(i) {
                Some(0) => " first",
                Some(1) => " second",
                _ if column.head == "published" => " quoted",
                _ => "",
            };
            html += &format!("<td class=\"n{class}\">{}</td>", escape(&(column.text)(row)));
        }
        html += "</tr>";
    }
    html + "</table></div>"
}

/// Returns the tag of a system that is not the published one.
fn tag(name: &str) -> String {
    let kind = SYSTEMS.iter().find(|system| system.name == name).map(|system| system.kind);
    match kind {
        Some(kind) if kind != Kind::Whole => format!("<span class=\"tag\">{}</span>", kind.word()),
        _ => String::new(),
    }
}

/// Returns the rank of each row by a value, 0 for the greatest. A mean over only some of the scenes has no rank, and
/// neither has a row without a rival.
fn ranks(rows: &[TableRow], value: &dyn Fn(&TableRow) -> f64) -> Vec<usize> {
    let rival = |row: &&TableRow| value(row).is_finite() && row.scenes[0] == row.scenes[1];
    let rivals: Vec<f64> = rows.iter().filter(rival).map(value).collect();
    let rank = |row: &TableRow| match rival(&row) && rivals.len() > 1 {
        true => rivals.iter().filter(|other| **other > value(row)).count(),
        false => usize::MAX,
    };
    rows.iter().map(rank).collect()
}

/// Returns the published figures.
pub fn published(scales: Scales) -> String {
    // The last three columns contain words.
    let class = |column: usize, count: usize| match column {
        0 => "",
        _ if column + 3 >= count => " class=\"w\"",
        _ => " class=\"n\"",
    };
    let head = published_columns(scales);
    let mut html = "<div class=\"scroll\"><table class=\"dense quote\"><tr>".to_string();
    for (i, name) in head.iter().enumerate() {
        html += &format!("<th{}>{}</th>", class(i, head.len()), escape(name));
    }
    html += "</tr>";
    for row in published_cells(scales) {
        html += "<tr>";
        for (i, cell) in row.iter().enumerate() {
            html += &format!("<td{}>{}</td>", class(i, row.len()), escape(cell));
        }
        html += "</tr>";
    }
    format!(
        "<section class=\"wide\"><h2>{}, published</h2><p class=\"lead\">Quoted, not measured here: {}.</p>{html}</table></div>\
         </section>\n",
        scales.title(),
        published_caption(scales)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::comparison::{Cell, scene_row};
    use trimip::systems::find;

    #[test]
    fn ranks_pass_over_what_was_not_measured_everywhere() {
        let row = |psnr: f64, scenes| TableRow {
            cell: Cell { psnr, ..Cell::UNKNOWN },
            scenes,
            ..scene_row(find("ngp").unwrap(), Scales::Four, "lego", &[])
        };
        let rows = [row(30.0, [2, 2]), row(35.0, [1, 2]), row(31.0, [2, 2]), row(f64::NAN, [0, 2])];
        let psnr = |row: &TableRow| row.cell.psnr;
        assert_eq!(ranks(&rows, &psnr), [1, usize::MAX, 0, usize::MAX]);
        assert_eq!(ranks(&rows[..1], &psnr), [usize::MAX]);
    }
}
