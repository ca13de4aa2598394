//! Plots like the paper's Figure 1: quality against time as curves, and quality against time and size as points.
//! Measured and published figures have separate panels with the same range of quality.

use super::look::{headline, look};
use super::scatter::{Mark, panel, range};
use crate::comparison::{Comparison, Figures, Run, Scales, TableRow, mean_curve};
use crate::page;
use crate::svg::{DASHED, Line, Point};
use trimip::formatting;
use trimip::run::curve::Measure;
use trimip::systems::{
    System,
    published::{PUBLISHED, Published},
};

/// Draws the curves of all systems: one per system if all its runs are measured, otherwise one per run.
pub fn curves(comparison: &Comparison, scales: Scales) -> String {
    let lines: Vec<Line> =
        comparison.systems.iter().flat_map(|system| lines(comparison, scales, system)).collect();
    let whole = lines.iter().all(|line| line.class.contains("mean"));
    let note = match (comparison.scenes.len(), whole) {
        (1, true) => {
            "Each line is one system: the mean of its seeds, on about four test views. The rings at the end are on all measured views."
        }
        (_, true) => {
            "Each line is one system: the mean of its seeds and scenes, on about four test views of each scene. The rings at the end are on all measured views."
        }
        _ => {
            "Each line is one system, or one run of a system whose runs are not all measured yet, on about four test views of each scene. The rings at the end are on all measured views."
        }
    };
    page::plot(&format!("Quality against time, {}", scales.title().to_lowercase()), &lines, note)
}

fn lines(comparison: &Comparison, scales: Scales, system: &System) -> Vec<Line> {
    let mine = |run: &&Run| run.scales == scales && run.system == system.name;
    let all: Vec<&Run> = comparison.runs.iter().filter(mine).collect();
    let known: Vec<(&Run, &Figures)> =
        all.iter().filter_map(|run| Some((*run, run.figures.as_ref()?))).collect();
    let curves: Vec<&[Measure]> = known.iter().map(|(_, figures)| &figures.curve[..]).collect();
    let (color, dashed) = look(system.name);
    let point = |m: &Measure, of: &str| Point {
        seconds: m.seconds,
        psnr: m.psnr,
        hint: format!("{}{of}: {:.2} dB after {}", system.title, m.psnr, formatting::duration(m.seconds)),
    };
    let line = |points: &[Measure], end: Measure, of: &str, mean: bool| Line {
        name: system.title.into(),
        color: color.into(),
        class: match (mean, dashed) {
            (true, false) => "mean",
            (true, true) => "mean dashed",
            (false, false) => "run",
            (false, true) => DASHED,
        },
        points: points.iter().map(|m| point(m, of)).collect(),
        // No ring is drawn if the curve already ends at this point.
        ring: (!points.last().is_some_and(|last| same(last, &end)))
            .then(|| point(&end, &format!("{of}, all measured views"))),
    };
    let headline = headline(comparison, scales).into_iter().find(|row| row.system == system.name);
    match mean_curve(&curves).filter(|_| known.len() == all.len()).zip(headline) {
        Some((mean, row)) => {
            let end = Measure { seconds: row.cell.seconds, psnr: row.cell.psnr };
            vec![line(&mean, end, "", true)]
        }
        None => known
            .iter()
            .map(|(run, figures)| {
                let end = Measure { seconds: figures.seconds, psnr: figures.mean.psnr };
                line(&figures.curve, end, &format!(" on {}", run.scene), false)
            })
            .collect(),
    }
}

/// Returns true for measures that differ at most by rounding.
fn same(a: &Measure, b: &Measure) -> bool {
    (a.seconds - b.seconds).abs() <= 1e-6 * b.seconds && (a.psnr - b.psnr).abs() < 1e-6
}

/// Draws quality against time and against size, measured and published; empty if nothing was measured.
pub fn points(comparison: &Comparison, scales: Scales) -> String {
    let rows: Vec<_> = headline(comparison, scales)
        .into_iter()
        .filter(|row| row.scenes[0] == row.scenes[1] && row.cell.psnr.is_finite())
        .collect();
    if rows.is_empty() {
        return String::new();
    }
    let measured = |value: &dyn Fn(&TableRow) -> f64, unit: &dyn Fn(f64) -> String| -> Vec<Mark> {
        let mark = |row: &TableRow| Mark {
            x: value(row),
            psnr: row.cell.psnr,
            label: row.title.into(),
            color: look(row.system).0,
            quoted: false,
            hint: format!("{}: {:.2} dB, {}", row.title, row.cell.psnr, unit(value(row))),
        };
        rows.iter().map(mark).filter(Mark::is_drawn).collect()
    };
    let published = |value: &dyn Fn(&Published) -> Option<f64>, unit: &str| -> Vec<Mark> {
        let mark = |row: &Published| {
            let psnr = if scales == Scales::Four { row.average } else { row.single }?;
            let x = value(row)?;
            let hint = format!("{}, published: {psnr:.2} dB, {x} {unit}", row.name);
            Some(Mark { x, psnr, label: row.name.into(), color: "var(--faint)", quoted: true, hint })
        };
        PUBLISHED.iter().filter_map(mark).collect()
    };
    let size = [
        measured(&|row| row.cell.model_bytes / 1e6, &|mb| formatting::bytes((mb * 1e6) as u64)),
        published(&|row| row.megabytes, "MB"),
    ];
    let time =
        [measured(&|row| row.cell.seconds, &formatting::duration), published(&|row| row.minutes, "min")];
    let all: Vec<f64> = size.iter().chain(&time).flatten().map(|mark| mark.psnr).collect();
    let quality = range(&all);
    let figure = |caption: &str, marks: &[Mark], axis: &str| {
        panel(marks, axis, quality).map_or_else(String::new, |svg| {
            format!("<figure><figcaption>{caption}</figcaption>{svg}</figure>")
        })
    };
    let mut panels =
        figure("Measured here", &size[0], "model / MB") + &figure("Published", &size[1], "model / MB");
    // With equal training times the points would lie above each other, and the curves already show their quality.
    let ends = || time[0].iter().map(|mark| mark.x);
    let apart = ends().fold(0.0, f64::max) > 1.1 * ends().fold(f64::INFINITY, f64::min);
    if apart {
        panels += &figure("Measured here: on this machine", &time[0], "training time / s");
    }
    if scales == Scales::Four {
        panels += &figure("Published: on GPUs", &time[1], "training time / min");
    }
    let here = match &comparison.scenes[..] {
        [scene] => page::escape(scene),
        scenes => formatting::count(scenes.len() as u64, "scene"),
    };
    let equal =
        if apart { "" } else { " All systems were trained for the same time here: see the curves above." };
    format!(
        "<section><h2>Quality against size and time, {}</h2><div class=\"panels\">{panels}</div><p class=\"lead\">Dots were measured here, on {here}; rings are \
         the papers’ figures for the eight Blender scenes, with their own splits and backgrounds, on GPUs. Higher and further \
         left is better.{equal}</p></section>\n",
        scales.title().to_lowercase()
    )
}
