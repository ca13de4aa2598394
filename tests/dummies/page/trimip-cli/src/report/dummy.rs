//! The page of `check`: the laws of all cases with their worst errors, as one self-contained file.

use super::page;
use crate::check::Finding;

/// The whole page of what was found on each backend.
pub fn page(found: &[(String, Finding)]) -> String {
    let head = ["case", "law", "backend", "worst", "bound"].map(String::from);
    let row = |(backend, finding): &(String, Finding)| {
        let [worst, bound] = [finding.worst, finding.bound].map(|number| format!("{number:.1e}"));
        vec![finding.case.clone(), finding.law.into(), backend.clone(), worst, bound]
    };
    let rows: Vec<Vec<String>> = std::iter::once(head.into()).chain(found.iter().map(row)).collect();
    let content = format!("<header><h1>Laws</h1></header>\n{}", page::table(&rows, false));
    page::whole("Tri-MipRF laws", &content)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_whole_and_has_every_law() {
        let finding = Finding { part: "rays", case: "a < b".into(), law: "none", worst: 2.0, bound: 1e-3 };
        let page = page(&[("cpu".into(), finding)]);
        page::expect_whole(&page);
        assert!(page.contains("<td>a &lt; b</td>") && page.contains(">1.0e-3</td>"), "{page}");
    }
}
