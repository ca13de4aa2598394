//! What all pages share: one HTML file that holds its style and script and fetches nothing, text made safe, tables, the
//! plot with its legend and its two axes.

use super::svg::{self, Line};
use trimip::machine;

/// A whole page around the content of its `main`.
pub fn whole(title: &str, content: &str) -> String {
    format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{}</title>\n\
         <style>\n{}</style>\n</head>\n<body>\n<main>\n{content}\
         <footer>Written by trimip-cli {}.</footer>\n</main>\n<script>\n{}</script>\n</body>\n</html>\n",
        escape(title),
        include_str!("style.css"),
        escape(&machine::version()),
        include_str!("script.js"),
    )
}

/// Text that is safe inside HTML.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

/// Rows of text as a table that scrolls where it is wider than its window: the first row is the head, the first column
/// stands to the left, the others, numbers, to the right. The last row is printed bold where it is a mean.
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

/// Names and values, one a row.
pub fn pairs(rows: &[(&str, String)]) -> String {
    let rows = rows.iter().map(|(name, value)| format!("<tr><td>{name}</td><td>{}</td></tr>", escape(value)));
    format!("<table class=\"pairs\">{}</table>", rows.collect::<String>())
}

/// A section with the plot of `lines` over logarithmic and linear time; empty where there is nothing to draw. `note` is
/// HTML.
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
         of the mean squared error that the PSNR stands for.</p></section>\n",
        svg::legend(lines)
    )
}

/// Fails unless `page` is one file: it fetches nothing, and every element that is opened is closed.
#[cfg(test)]
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
