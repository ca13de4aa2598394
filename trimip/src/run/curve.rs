//! Curves of error against time: the columns `seconds` and `psnr_mean` of a CSV file that a run or another program wrote.

use trimip_core::{Error, Result};

/// A point of a curve.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Measure {
    /// Seconds of training.
    pub seconds: f64,
    /// Mean PSNR of the scales, dB.
    pub psnr: f64,
}

/// Parses the measurements of a CSV text and sorts them as [`curve`] does; the final one is the line that a column
/// `last` marks. Lines with an empty PSNR, evaluations whose result was not a number, are skipped.
///
/// # Errors
/// When a column is missing, a value is not a finite number, or there are no evaluations; the error names `file`.
pub fn parse(file: &str, text: &str) -> Result<(Vec<Measure>, Option<Measure>)> {
    let mut lines = text.lines().zip(1..).filter(|(line, _)| !line.trim().is_empty());
    let header: Vec<&str> =
        lines.next().map_or(Vec::new(), |(line, _)| line.split(',').map(str::trim).collect());
    let column = |name: &str| header.iter().position(|column| *column == name);
    let missing = |name: &str| {
        Error::input(file, format!("has no column `{name}`"), "name the columns in the first line")
    };
    let seconds = column("seconds").ok_or_else(|| missing("seconds"))?;
    let psnr = column("psnr_mean").ok_or_else(|| missing("psnr_mean"))?;
    let (is_last, stride) = (column("last"), column("stride"));
    let mut rows = Vec::new();
    for (line, number) in lines {
        let cells: Vec<&str> = line.split(',').map(str::trim).collect();
        if cells.get(psnr) == Some(&"") {
            continue;
        }
        let value = |column: usize| {
            let cell = cells.get(column).copied().unwrap_or_default();
            cell.parse::<f64>().ok().filter(|value| value.is_finite()).ok_or_else(|| {
                Error::input(
                    format!("{file}:{number}"),
                    format!("`{}` is `{cell}`", header[column]),
                    "expected a finite number",
                )
            })
        };
        let measure = Measure { seconds: value(seconds)?, psnr: value(psnr)? };
        let ends = is_last.is_some_and(|column| cells.get(column) == Some(&"true"));
        let views = stride.and_then(|column| cells.get(column)).map(|cell| (*cell).to_string());
        rows.push(Evaluated { measure, ends, views });
    }
    curve(rows.into_iter())
        .ok_or_else(|| Error::input(file, "has no evaluations", "name a run that was evaluated"))
}

/// One evaluation of a run.
pub struct Evaluated {
    /// Time and PSNR.
    pub measure: Measure,
    /// True for the evaluation at the end of the run.
    pub ends: bool,
    /// The views evaluated, if known.
    pub views: Option<String>,
}

/// Returns the points of a curve in order of time, and the final measurement; `None` without measurements. The final measurement
/// is also a point if it uses the same views as the row before it. If it is the only measurement, it is a point and is not
/// returned separately.
pub fn curve(rows: impl Iterator<Item = Evaluated>) -> Option<(Vec<Measure>, Option<Measure>)> {
    let (mut points, mut last, mut before) = (Vec::new(), None, None);
    for Evaluated { measure, ends, views } in rows {
        if ends {
            last = Some(measure);
        }
        // The final measurement also belongs to the curve if it uses the same views as the curve.
        if !ends || (views.is_some() && views == before) {
            points.push(measure);
            before = views;
        }
    }
    points.sort_by(|a: &Measure, b| a.seconds.total_cmp(&b.seconds));
    if points.is_empty() {
        points.extend(last.take());
    }
    (!points.is_empty()).then_some((points, last))
}
