//! Tables as LaTeX, for the package booktabs.

/// Returns rows as a `tabular`. The first row is the header; with `ends_with_mean`, a line separates the last row. The
/// first column is text, the others are numbers.
pub fn tabular(rows: &[Vec<String>], ends_with_mean: bool) -> String {
    let columns = rows.first().map_or(0, Vec::len);
    let mut text = format!("\\begin{{tabular}}{{l{}}}\n\\toprule\n", "r".repeat(columns.saturating_sub(1)));
    for (i, row) in rows.iter().enumerate() {
        if i > 0 && (i == 1 || (ends_with_mean && i + 1 == rows.len())) {
            text += "\\midrule\n";
        }
        let cells: Vec<_> = row.iter().map(|cell| escaped(cell)).collect();
        text += &format!("{} \\\\\n", cells.join(" & "));
    }
    text + "\\bottomrule\n\\end{tabular}\n"
}

/// Escapes text for LaTeX and converts dashes and signs.
pub fn escaped(text: &str) -> String {
    let mut safe = String::new();
    for c in text.chars() {
        match c {
            '\\' => safe += "\\textbackslash{}",
            '~' => safe += "\\textasciitilde{}",
            '^' => safe += "\\textasciicircum{}",
            '–' => safe += "--",
            '±' => safe += "$\\pm$",
            '×' => safe += "$\\times$",
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => safe.extend(['\\', c]),
            c => safe.push(c),
        }
    }
    safe
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_table_has_its_rules_and_nothing_that_latex_reads_otherwise() {
        let rows = [["a_b", "50 %"], ["c", "1 ± 2"], ["mean", "3"]].map(|row| row.map(String::from).to_vec());
        let expected = "\\begin{tabular}{lr}\n\\toprule\na\\_b & 50 \\% \\\\\n\\midrule\nc & 1 $\\pm$ 2 \\\\\n\\midrule\nmean & 3 \\\\\n\
                        \\bottomrule\n\\end{tabular}\n";
        assert_eq!(tabular(&rows, true), expected);
        assert_eq!(tabular(&rows, false).matches("midrule").count(), 1);
        assert_eq!(tabular(&rows[..2], true).matches("midrule").count(), 1, "one row is no mean of others");
    }
}
