//! `compare`: curves of error against time, from run folders or CSV files of other programs. Prints a table with the time at which each
//! curve reaches given PSNRs, and writes a plot and a page with the pictures of the runs.

use crate::args::CompareArguments;
use crate::curves::{Curve, rows, table};
use crate::terminal;
use trimip_core::{Error, Result};
use trimip_report::beside::{self, Entry};
use trimip_report::svg::{self, Line};
use trimip_report::{page, save};

/// Maximum number of curves: one per colour.
const MOST: usize = svg::COLORS.len();

/// Runs the verb.
pub fn run(arguments: &CompareArguments) -> Result<u8> {
    if arguments.curves.len() > MOST {
        return Err(Error::input(
            "compare",
            format!("{} curves", arguments.curves.len()),
            format!("compare at most {MOST} at once"),
        ));
    }
    let curves = arguments.curves.iter().map(|text| Curve::read(text)).collect::<Result<Vec<_>>>()?;
    let mut reach: Vec<f64> = arguments.reach.iter().copied().filter(|psnr| psnr.is_finite()).collect();
    reach.sort_by(f64::total_cmp);
    terminal::line(table(&curves, &reach));
    let lines: Vec<Line> = curves.iter().zip(svg::COLORS).map(|(curve, color)| curve.line(color)).collect();
    if let Some(path) = &arguments.svg {
        let text = svg::alone(&lines, svg::TRAINING).ok_or_else(|| {
            Error::input(
                "compare",
                "no curve has a measurement to draw",
                "name runs that were evaluated during training",
            )
        })?;
        save(path, &text)?;
    }
    if let Some(path) = &arguments.html {
        save(path, &html(&curves, &lines, &reach)?)?;
    }
    if let Some(path) = &arguments.json {
        let rows: Vec<_> = curves.iter().map(|curve| curve.json(&reach)).collect();
        save(path, &serde_json::to_string_pretty(&rows).map_err(Error::run)?)?;
    }
    Ok(0)
}

/// Returns the HTML page.
fn html(curves: &[Curve], lines: &[Line], reach: &[f64]) -> Result<String> {
    let entries: Vec<Entry> = curves
        .iter()
        .zip(lines)
        .map(|(curve, line)| Entry {
            name: curve.name.clone(),
            color: line.color.clone(),
            folder: curve.folder.clone(),
        })
        .collect();
    let names: Vec<&str> = curves.iter().map(|curve| curve.name.as_str()).collect();
    let content = [
        format!("<header><h1>{}</h1></header>\n", page::escape(&names.join(", "))),
        page::plot("Error against time", lines, "One line for each curve, on its own test views."),
        format!(
            "<section><h2>Times to given PSNRs</h2>{}<p class=\"lead\">Between two measurements, the time is \
             interpolated linearly over its logarithm. ≤ marks a curve whose first measurement is already above the PSNR, \
             which it reached at an unknown earlier time.</p></section>\n",
            page::table(&rows(curves, reach), false)
        ),
        beside::outcomes(&entries),
        beside::views(&entries)?,
        beside::differences(&entries),
    ];
    Ok(page::whole(&format!("{} – Tri-MipRF comparison", names.join(", ")), &content.concat()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_whole_and_its_legend_names_each_curve_once() {
        let folder = tempfile::tempdir().unwrap();
        let csv = folder.path().join("peer.csv");
        std::fs::write(&csv, "seconds,psnr_mean\n10,20\n40,30\n").unwrap();
        let path = folder.path().join("new/page.html");
        let arguments = CompareArguments {
            curves: vec![format!("a<b={}", csv.display()), format!("other={}", csv.display())],
            reach: vec![15.0, 25.0],
            svg: None,
            html: Some(path.clone()),
            json: None,
        };
        assert_eq!(run(&arguments).unwrap(), 0);
        let page = std::fs::read_to_string(&path).unwrap();
        page::expect_whole(&page);
        assert_eq!(page.matches("</i>a&lt;b</span>").count(), 1);
        assert!(page.contains("≤ 10.0 s") && page.contains("<td class=\"n\">20.0 s</td>"));
        let wrong = CompareArguments { html: Some(csv.join("page.html")), ..arguments };
        assert_eq!(run(&wrong).unwrap_err().kind(), trimip_core::ErrorKind::Input);
    }
}
