//! `compare`: curves of error against time beside each other, from run folders or anybody's CSV: a table of the times at
//! which each reaches given PSNRs, and a plot.

use crate::args::CompareArguments;
use crate::curves::{Curve, table};
use crate::report::svg::{self, Line};
use crate::terminal;
use trimip_core::{Error, Result, tensors::write_atomically};

/// Curves that are told apart by colour.
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
    if let Some(path) = &arguments.svg {
        let lines: Vec<Line> =
            curves.iter().zip(svg::COLORS).map(|(curve, color)| curve.line(color)).collect();
        let text = svg::alone(&lines).ok_or_else(|| {
            Error::input(
                "compare",
                "no curve has a measure to draw",
                "name runs that were evaluated on the way",
            )
        })?;
        write_atomically(path, text.as_bytes())?;
    }
    if let Some(path) = &arguments.json {
        let rows: Vec<_> = curves.iter().map(|curve| curve.json(&reach)).collect();
        write_atomically(path, serde_json::to_string_pretty(&rows).map_err(Error::run)?.as_bytes())?;
    }
    Ok(0)
}
