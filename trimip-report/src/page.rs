//! Shared parts of all pages: one self-contained HTML file with its style and script, escaped text, tables, and the
//! plot with its legend and its two time axes.

pub use super::escape::escape;

use super::svg::{self, Line};
use trimip::machine;

/// Returns a whole page around `content`, which goes inside its `main` element.
pub fn whole(title: &str, content: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{}</title>\n\
         <style>\n{}</style>\n</head>\n<body>\n<main>\n{content}\
         <footer>Written by trimip {}.</footer>\n</main>\n<script>\n{}</script>\n</body>\n</html>\n",
        escape(title),
        include_str!("style.css"),
        escape(&machine::version()),
        include_str!("script.js"),
    )
}

/// Returns rows of text as a table that scrolls if it is wider than its window. The first row is the header. The first
/// column is left-aligned; the others are numbers and right-aligned. With `ends_with_mean`, the last row is bold.
pub fn table(rows: &[Vec<String>], ends_with_mean: bool) -> String {
    let last = rows.len().saturating_sub(1);
    let row = |(i, cells): (usize, &Vec<String>)| {
        let tag = if i == 0 { "th" } else { "td" };
        let cells = cells.iter().enumerate().map(|(column, cell)| {
            let class = if column == 0 { "" } else { " class=\"n\"" };
            format!("<{tag}{class}>{}</{tag}>", escape(cell))
        });
        let class = if ends_with_mean && i == last && i > 0 { " class=\"mean\"" } else { "" };
        format!("<tr{class}>{}</tr>", cells.collect::<String>())
    };
    let body: String = rows.iter().enumerate().map(row).collect();
    format!("<div class=\"scroll\"><table>{body}</table></div>")
}

/// Returns a table of names and values, with one pair per row.
pub fn pairs(rows: &[(&str, String)]) -> String {
    let rows = rows.iter().map(|(name, value)| format!("<tr><td>{name}</td><td>{}</td></tr>", escape(value)));
    format!("<table class=\"pairs\">{}</table>", rows.collect::<String>())
}

/// Returns a section with the plot of `lines` over logarithmic and over linear time; empty if there is nothing to draw. `note` is HTML.
pub fn plot(title: &str, lines: &[Line], note: &str) -> String {
    let Some((logarithmic, linear)) = svg::plot(lines, true).zip(svg::plot(lines, false)) else {
        return String::new();
    };
    format!(
        "<section class=\"plot\"><h2>{title}</h2><div class=\"legend\">{}</div>\
         <div class=\"log\">{logarithmic}</div><div class=\"linear\">{linear}</div>\
         <div class=\"axis\"><label><input type=\"radio\" name=\"axis\" id=\"axis-log\" checked> logarithmic time</label>\
         <label><input type=\"radio\" name=\"axis\" id=\"axis-linear\"> linear time</label></div>\
         <p class=\"lead\">{note} Training time only: evaluations and pictures are not counted. The right axis is the root \
         mean squared error that corresponds to the PSNR.</p></section>\n",
        svg::legend(lines)
    )
}

/// Asserts that `page` is self-contained: it fetches nothing, and every opened element is closed. Used by tests of pages.
///
/// # Panics
/// If the page is not self-contained.
pub fn expect_whole(page: &str) {
    assert!(page.starts_with("<!doctype html>") && page.ends_with("</html>\n"));
    for fetching in ["http:", "https:", "@import", "url(", "<link"] {
        assert!(!page.contains(fetching), "{fetching}");
    }
    assert!(page.split("src=\"").skip(1).all(|rest| rest.starts_with("data:")));
    for tag in ["section", "table", "tr", "td", "div", "svg", "details", "p", "figure", "span", "script"] {
        let open = page.matches(&format!("<{tag}>")).count() + page.matches(&format!("<{tag} ")).count();
        assert_eq!(open, page.matches(&format!("</{tag}>")).count(), "{tag}");
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tables_escape_their_cells_and_tell_numbers_from_names() {
        let rows = [["a", "n"], ["x<y", "1"], ["mean", "2"]].map(|row| row.map(String::from).to_vec());
        let html = table(&rows, true);
        assert!(html.contains("<td>x&lt;y</td><td class=\"n\">1</td>") && html.contains("<th>a</th>"));
        assert!(html.contains("<tr class=\"mean\"><td>mean"));
    }

    #[test]
    fn a_page_fetches_nothing() {
        expect_whole(&whole("a < b", &plot("nothing", &[], "")));
    }
}
