//! The page of `check`: the laws of all cases with their worst errors, as one self-contained file.

use super::page;

/// A law and its worst error.
pub struct Law<'a> {
    /// The case in which it was measured.
    pub case: &'a str,
    /// Statement of the law.
    pub law: &'a str,
    /// The backend that was measured.
    pub backend: &'a str,
    /// The largest error that was measured, and the largest error that is allowed.
    pub worst: [f64; 2],
}

/// Returns the page of the laws as HTML.
pub fn page(laws: &[Law<'_>]) -> String {
    let head = ["case", "law", "backend", "worst", "bound"].map(String::from);
    let row = |law: &Law<'_>| {
        let [worst, bound] = law.worst.map(|number| format!("{number:.1e}"));
        vec![law.case.into(), law.law.into(), law.backend.into(), worst, bound]
    };
    let rows: Vec<Vec<String>> = std::iter::once(head.into()).chain(laws.iter().map(row)).collect();
    let content = format!("<header><h1>Laws</h1></header>\n{}", page::table(&rows, false));
    page::whole("Tri-MipRF laws", &content)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_whole_and_has_every_law() {
        let page = page(&[Law { case: "a < b", law: "none", backend: "cpu", worst: [2.0, 1e-3] }]);
        page::expect_whole(&page);
        assert!(page.contains("<td>a &lt; b</td>") && page.contains(">1.0e-3</td>"), "{page}");
    }
}
