//! Curves of error against time: read from run folders or CSV files of other programs, and compared in a table.

use crate::terminal;
use serde::Serialize;
use std::path::{Path, PathBuf};
use trimip::run::curve::{Evaluated, curve, parse};
use trimip::{Error, Result, run::history::History};
use trimip_core::text;
use trimip_report::svg::{Line, Point};

pub use trimip::run::curve::Measure;

/// A curve of error against time.
#[derive(Debug)]
pub struct Curve {
    /// Display name.
    pub name: String,
    /// Measurements during training, in order of time.
    pub points: Vec<Measure>,
    /// The final measurement, if it uses other test views than the curve.
    pub last: Option<Measure>,
    /// The run folder, if the curve comes from a run.
    pub folder: Option<PathBuf>,
}

/// The time at which a curve reaches a PSNR.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Reach {
    /// Seconds of training.
    pub seconds: f64,
    /// True if the first measurement is already above the PSNR, so that the PSNR was reached at this time or earlier.
    pub at_most: bool,
}

impl std::fmt::Display for Reach {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}{:.1} s", if self.at_most { "≤ " } else { "" }, self.seconds)
    }
}

impl Curve {
    /// Reads the curve that `path` or `name=path` names; the curve of a folder is its `error_vs_time.csv`.
    pub fn read(text: &str) -> Result<Self> {
        let (name, path) = match text.split_once('=') {
            Some((name, path)) if !Path::new(text).exists() => (name.to_string(), Path::new(path)),
            _ => (text.trim_end_matches('/').to_string(), Path::new(text)),
        };
        let folder = path.is_dir().then(|| path.to_path_buf());
        let path = if folder.is_some() { path.join("error_vs_time.csv") } else { path.to_path_buf() };
        let text = text::read(&path, "name a run folder or a CSV file")?;
        let (points, last) = parse(&path.display().to_string(), &text)?;
        Ok(Self { name, points, last, folder })
    }

    /// Returns the curve of a run, from its history.
    ///
    /// # Errors
    /// When the run was never evaluated.
    pub fn of_run(folder: &Path, history: &History) -> Result<Self> {
        let rows = history.evaluations.iter().map(|e| Evaluated {
            measure: Measure { seconds: e.totals.seconds, psnr: e.psnr },
            ends: e.last,
            views: Some(e.stride.to_string()),
        });
        let (points, last) = curve(rows).ok_or_else(|| {
            Error::input(folder.display(), "the run was not evaluated", "set eval.final = 1")
        })?;
        Ok(Self { name: folder.display().to_string(), points, last, folder: Some(folder.to_path_buf()) })
    }

    /// Returns the time at which the curve first reaches `psnr`; `None` if it never does. Interpolates linearly over
    /// the logarithm of time, or over time itself after a measurement at time zero.
    pub fn reaches(&self, psnr: f64) -> Option<Reach> {
        let at = |seconds: f64| Some(Reach { seconds, at_most: false });
        let mut before: Option<&Measure> = None;
        for point in &self.points {
            if point.psnr >= psnr {
                let Some(before) = before else {
                    return Some(Reach { seconds: point.seconds, at_most: point.seconds > 0.0 });
                };
                let fraction = (psnr - before.psnr) / (point.psnr - before.psnr);
                if before.seconds <= 0.0 {
                    return at(before.seconds + fraction * (point.seconds - before.seconds));
                }
                return at(before.seconds * (point.seconds / before.seconds).powf(fraction));
            }
            before = Some(point);
        }
        None
    }

    /// Converts the curve to a line of a plot.
    pub fn line(&self, color: &str) -> Line {
        let point = |m: &Measure| Point {
            seconds: m.seconds,
            psnr: m.psnr,
            hint: format!("{}: {:.2} dB after {}", self.name, m.psnr, terminal::duration(m.seconds)),
        };
        Line {
            name: self.name.clone(),
            color: color.into(),
            class: "mean",
            points: self.points.iter().map(point).collect(),
            // No ring is drawn if the last measurement is also the end of the curve.
            ring: self.last.as_ref().filter(|last| self.points.last() != Some(last)).map(point),
        }
    }

    /// Reads the `report.json` of the curve's run; returns null if there is none.
    pub fn report(&self) -> serde_json::Value {
        let text = self
            .folder
            .as_ref()
            .and_then(|folder| trimip_core::plain_file::read(&folder.join("report.json")).ok());
        text.and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default()
    }

    /// Converts the curve to JSON, with the times at which it reaches each PSNR.
    pub fn json(&self, reach: &[f64]) -> serde_json::Value {
        let pair = |m: &Measure| serde_json::json!({ "seconds": m.seconds, "psnr": m.psnr });
        serde_json::json!({
            "name": self.name,
            "curve": self.points.iter().map(pair).collect::<Vec<_>>(),
            "final": self.last.as_ref().map(pair),
            "mean": self.report()["mean"],
            "reaches": reach.iter().map(|&psnr| reach_json(psnr, self.reaches(psnr))).collect::<Vec<_>>(),
        })
    }
}

/// Returns a PSNR and the time at which it is reached, as JSON; `seconds` is null if the PSNR is never reached.
pub fn reach_json(psnr: f64, reach: Option<Reach>) -> serde_json::Value {
    serde_json::json!({
        "psnr": psnr,
        "seconds": reach.map(|reach| reach.seconds),
        "at_most": reach.is_some_and(|reach| reach.at_most),
    })
}

/// Formats the [`rows`] for a terminal.
pub fn table(curves: &[Curve], reach: &[f64]) -> String {
    let mut rows = rows(curves, reach);
    let reports: Vec<_> = curves.iter().map(Curve::report).collect();
    for (name, key) in [("LPIPS", "lpips"), ("FLIP", "flip"), ("MS-SSIM", "ms_ssim"), ("SSIM", "ssim")] {
        let values: Vec<Option<f64>> = reports.iter().map(|report| report["mean"][key].as_f64()).collect();
        if values.iter().all(Option::is_none) {
            continue;
        }
        let cells = values.iter().map(|value| value.map_or("–".into(), |value| format!("{value:.4}")));
        for (row, cell) in rows.iter_mut().zip([name.to_string()].into_iter().chain(cells)) {
            row.insert(BEFORE_REACH, cell);
        }
    }
    aligned(&rows)
}

/// Number of columns before those of the times at which PSNRs are reached.
const BEFORE_REACH: usize = 4;

/// Returns a header, then one row per curve: its end, and the time at which it reaches each PSNR.
pub fn rows(curves: &[Curve], reach: &[f64]) -> Vec<Vec<String>> {
    let mut rows = vec![vec!["curve".to_string(), "seconds".into(), "PSNR / dB".into(), "final / dB".into()]];
    rows[0].extend(reach.iter().map(|psnr| format!("{psnr} dB after")));
    for curve in curves {
        let end = &curve.points[curve.points.len() - 1];
        let mut row = vec![curve.name.clone(), format!("{:.1}", end.seconds), format!("{:.2}", end.psnr)];
        row.push(curve.last.map_or("–".into(), |last| format!("{:.2}", last.psnr)));
        row.extend(
            reach.iter().map(|psnr| curve.reaches(*psnr).map_or("–".into(), |reach| reach.to_string())),
        );
        rows.push(row);
    }
    rows
}

/// Formats rows as lines of aligned columns: the first column left-aligned, the others right-aligned.
pub fn aligned(rows: &[Vec<String>]) -> String {
    let width = |column: usize| rows.iter().map(|row| row[column].chars().count()).max().unwrap_or(0);
    let lines: Vec<String> = rows
        .iter()
        .map(|row| {
            let cells = row.iter().enumerate().map(|(i, cell)| {
                let pad = " ".repeat(width(i) - cell.chars().count());
                if i == 0 { format!("{cell}{pad}") } else { format!("{pad}{cell}") }
            });
            cells.collect::<Vec<_>>().join("  ").trim_end().to_string()
        })
        .collect();
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Curve {
        let (points, last) = parse("x.csv", text).unwrap();
        Curve { name: "x".into(), points, last, folder: None }
    }

    #[test]
    fn a_curve_reaches_what_lies_between_its_measures() {
        let from_the_start = read("seconds,psnr_mean\n0,10\n40,20\n");
        let curve =
            read("seconds,psnr_mean,last\n100,30,false\n10,20,false\n1000,29,false\n1000,28.5,true\n");
        assert_eq!(curve.last, Some(Measure { seconds: 1000.0, psnr: 28.5 }));
        // Halfway in dB is halfway in the logarithm of time.
        assert!((curve.reaches(25.0).unwrap().seconds - 1000_f64.sqrt()).abs() < 1e-9);
        let at = |seconds, at_most| Some(Reach { seconds, at_most });
        assert_eq!((curve.reaches(30.0), curve.reaches(30.1)), (at(100.0, false), None));
        assert_eq!(from_the_start.reaches(15.0), at(20.0, false));
        // A PSNR below the first measurement was reached by the time of this measurement, unless that time is zero.
        assert_eq!((curve.reaches(15.0), from_the_start.reaches(5.0)), (at(10.0, true), at(0.0, false)));
        let table = table(&[curve], &[15.0, 25.0, 40.0]);
        assert!(table.contains("≤ 10.0 s") && table.contains(" 31.6 s") && table.ends_with('–'), "{table}");
    }

    #[test]
    fn a_last_measure_on_the_same_views_ends_the_curve() {
        let text = |stride| format!("seconds,psnr_mean,stride,last\n10,20,25,false\n20,30,{stride},true\n");
        assert_eq!((read(&text(25)).points.len(), read(&text(1)).points.len()), (2, 1));
    }

    #[test]
    fn a_run_measured_at_its_end_alone_is_a_point() {
        let curve = read("seconds,psnr_mean,last\n100,30,true\n");
        assert_eq!((curve.points.len(), curve.last), (1, None));
    }

    #[test]
    fn broken_tables_are_named_with_their_line() {
        let message = |text: &str| parse("x.csv", text).unwrap_err().to_string();
        assert!(message("seconds,psnr\n1,2\n").contains("psnr_mean"));
        assert!(message("seconds,psnr_mean\n1,2\n3\n").contains("x.csv:3"));
        assert!(message("seconds,psnr_mean\n1,nan\n").contains("x.csv:2"));
        assert_eq!(read("seconds,psnr_mean\n1,20\n2,\n3,30\n").points.len(), 2);
        assert!(message("").contains("seconds") && message("seconds,psnr_mean\n").contains("no evaluations"));
    }
}
