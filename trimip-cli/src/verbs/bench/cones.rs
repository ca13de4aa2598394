//! Error against time per view for 1, 2×2, 4×4 and 8×8 cones per pixel and for the model's own numbers of cones, at every scale. Pictures
//! are compared with the test photographs, with and without the set's edge exponents; with a true box filter of the finest photographs; and
//! with the picture of the same model with the most cones, which is its converged average over a pixel.

use crate::args::BenchArguments;
use crate::curves::aligned;
use crate::progress::spinner;
use crate::terminal;
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeSet;
use std::path::Path;
use std::time::Instant;
use trimip::machine::{self, Machine};
use trimip::report::scale_name;
use trimip::run::folder as run_folder;
use trimip::{backends, settings};
use trimip_core::atomic::write_atomically;
use trimip_core::field::model::Model;
use trimip_core::measures::metrics::psnr;
use trimip_core::run::evaluate::compared;
use trimip_core::scene::cones::{Division, PixelPattern};
use trimip_core::{Error, Frame, Result, ViewSet, Viewer};
use trimip_report::svg::{self, Line, Point};

/// Numbers of cones along a side of a pixel, in addition to the model's own numbers. The largest number is the reference.
const SIDES: [u32; 4] = [1, 2, 4, 8];

/// Results for one number of cones at one scale: means over the views.
#[derive(Clone, Debug, Default, Serialize)]
struct ConeRow {
    /// Reduction of the views: 1, 2, 4, 8.
    scale: u32,
    /// Number of cones along a side of a pixel.
    side: u32,
    /// True if the model's own rule selects this number of cones.
    own: bool,
    /// PSNR in dB, with the set's edge exponents.
    psnr: f64,
    /// PSNR in dB, without the set's edge exponents.
    psnr_plain: f64,
    /// PSNR in dB relative to a true box filter of the finest photographs.
    psnr_box: f64,
    /// PSNR in dB relative to the picture with the most cones; `None` for that picture itself.
    psnr_converged: Option<f64>,
    milliseconds: f64,
    /// True if no other number of cones at this scale is both faster and closer to the box filter.
    pareto: bool,
}

/// Renders the test views with every number of cones.
pub fn run(arguments: &BenchArguments, path: &Path) -> Result<u8> {
    let mut model = run_folder::read_model(path)?;
    settings::override_model(&mut model, &arguments.settings.set)?;
    backends::check(&model.config.backend)?;
    let scene = trimip_data::open_test(&model.config.section()?)?;
    let division = Division::new(&model.config);
    let stride = scene.frames.len().div_ceil(arguments.views as usize).max(1);
    let indices: Vec<usize> = (0..scene.frames.len()).step_by(stride).collect();
    let sides = sides(&division, &scene.frames.load(0)?);
    let mut sessions = sides.iter().map(|&side| load(&model, side)).collect::<Result<Vec<_>>>()?;
    let bar = spinner();
    let (mut rows, mut converged_errors): (Vec<ConeRow>, Vec<f64>) = (Vec::new(), Vec::new());
    let fraction = 1.0 / indices.len() as f64;
    for &index in &indices {
        let set = scene.frames.load(index)?;
        let views = set.scales.iter().flat_map(|scale| scale.views.clone().map(|view| (scale.factor, view)));
        for (at, (factor, view)) in views.enumerate() {
            let camera = &set.views[view].camera;
            let own = division.pattern(camera);
            let mut frames = Vec::new();
            for (session, side) in sessions.iter_mut().zip(sides.iter().copied()) {
                let name = &set.views[view].name;
                bar.set_message(format!("view {name} {}: {side}x{side} cones", scale_name(factor)));
                let started = Instant::now();
                let frame = session.render(camera)?;
                frames.push((side, frame, 1e3 * started.elapsed().as_secs_f64()));
            }
            let converged = frames.last().map(|(_, frame, _)| frame.rgb()).unwrap_or_default();
            for (i, (side, frame, milliseconds)) in frames.into_iter().enumerate() {
                let place = at * sides.len() + i;
                if rows.len() == place {
                    rows.push(ConeRow {
                        scale: factor,
                        side,
                        own: PixelPattern::Grid(side) == own,
                        ..ConeRow::default()
                    });
                    converged_errors.push(0.0);
                }
                let row = &mut rows[place];
                let [shown, plain, boxed] = errors(&model, &set, view, factor, frame.clone());
                row.psnr += fraction * shown;
                row.psnr_plain += fraction * plain;
                row.psnr_box += fraction * boxed;
                row.milliseconds += fraction * milliseconds;
                converged_errors[place] += fraction * psnr(&frame.rgb(), &converged);
            }
        }
    }
    bar.finish_and_clear();
    for (row, &error) in rows.iter_mut().zip(&converged_errors) {
        row.psnr_converged = error.is_finite().then_some(error);
    }
    mark_front(&mut rows);
    terminal::line(table(&rows));
    terminal::prose(format!(
        "{} of {} views, {}; converged: the average of {} cones; {}",
        indices.len(),
        scene.frames.len(),
        scene.name,
        sides[sides.len() - 1].pow(2),
        Machine::detect().cpu
    ));
    write(arguments, path, &model, &rows, &indices)?;
    Ok(0)
}

/// Returns the numbers of cones along a side of a pixel that are compared, ascending.
fn sides(division: &Division, views: &ViewSet) -> Vec<u32> {
    let own = views.views.iter().filter_map(|view| match division.pattern(&view.camera) {
        PixelPattern::Grid(side) => Some(side),
        PixelPattern::Quincunx => None,
    });
    let all: BTreeSet<u32> = own.chain(SIDES).collect();
    all.into_iter().collect()
}

/// Loads the model with `side` × `side` cones in every pixel.
fn load(model: &Model, side: u32) -> Result<Box<dyn Viewer>> {
    let mut model = model.clone();
    (model.config.renderer.cones, model.config.renderer.cone_width) = (side, 0.0);
    backends::load(&model)
}

/// Returns the PSNR of a rendered view in dB: with the set's edge exponents, without them, and relative to the true box filter.
fn errors(model: &Model, set: &ViewSet, view: usize, factor: u32, rendered: Frame) -> [f64; 3] {
    let data = &model.config.data;
    let seen = |rgb: Vec<[f32; 3]>| compared(set, view, rgb);
    let target = seen(set.composited(view, data.background));
    let finest = &set.scales[0];
    let truth = set.box_filtered(finest.views.start, factor / finest.factor, data.background);
    let plain = rendered.rgb();
    let shown = rendered.shown(data.background, data.edge_exponent(factor)).rgb();
    let (plain, shown) = (seen(plain), seen(shown));
    [psnr(&shown, &target), psnr(&plain, &target), psnr(&plain, &seen(truth))]
}

/// Marks the rows that no other row of the same scale beats in both time and error.
fn mark_front(rows: &mut [ConeRow]) {
    let points: Vec<_> = rows.iter().map(|row| (row.scale, row.milliseconds, row.psnr_box)).collect();
    for (row, own) in rows.iter_mut().zip(&points) {
        let beats = |other: &&(u32, f64, f64)| {
            other.0 == own.0 && other.1 <= own.1 && other.2 >= own.2 && *other != own
        };
        row.pareto = !points.iter().any(|other| beats(&other));
    }
}

fn table(rows: &[ConeRow]) -> String {
    let head = ["scale", "cones", "PSNR / dB", "plain", "box filter", "converged", "ms a view", "front"];
    let mut cells = vec![head.map(String::from).to_vec()];
    cells.extend(rows.iter().map(|row| {
        vec![
            scale_name(row.scale),
            format!("{0}x{0}{1}", row.side, if row.own { " (own)" } else { "" }),
            format!("{:.2}", row.psnr),
            format!("{:.2}", row.psnr_plain),
            format!("{:.2}", row.psnr_box),
            row.psnr_converged.map_or("–".into(), |psnr| format!("{psnr:.2}")),
            format!("{:.1}", row.milliseconds),
            if row.pareto { "*".into() } else { String::new() },
        ]
    }));
    aligned(&cells)
}

/// Writes `cones.json`, `cones.csv` and `cones.svg`.
fn write(
    arguments: &BenchArguments,
    path: &Path,
    model: &Model,
    rows: &[ConeRow],
    indices: &[usize],
) -> Result<()> {
    run_folder::create_writable(&arguments.out)?;
    let keep = |name: &str, text: &str| write_atomically(&arguments.out.join(name), text.as_bytes());
    let report = json!({
        "model": path.display().to_string(),
        "machine": Machine::detect(),
        "backend": model.config.backend,
        "version": machine::version(),
        "views": indices,
        "background": model.config.data.background,
        "edge_exponents": model.config.data.edge_exponents,
        "measures": "PSNR in dB of unrounded colours, means over the views: psnr with the edge exponents of the set, psnr_plain \
                     without them, psnr_box against a true box filter of the finest photographs, \
                     psnr_converged against the average of the most cones",
        "rows": rows,
    });
    keep("cones.json", &serde_json::to_string_pretty(&report).map_err(Error::run)?)?;
    let mut csv = "scale,side,own,psnr,psnr_plain,psnr_box,psnr_converged,milliseconds,pareto\n".to_string();
    for row in rows {
        let converged = row.psnr_converged.map_or(String::new(), |psnr| format!("{psnr:.3}"));
        csv += &format!(
            "{},{},{},{:.3},{:.3},{:.3},{converged},{:.3},{}\n",
            row.scale,
            row.side,
            row.own,
            row.psnr,
            row.psnr_plain,
            row.psnr_box,
            row.milliseconds,
            row.pareto
        );
    }
    keep("cones.csv", &csv)?;
    keep("cones.svg", &svg::alone(&lines(rows), "seconds a view").unwrap_or_default())
}

/// Returns one line per scale: PSNR relative to the box filter against time.
fn lines(rows: &[ConeRow]) -> Vec<Line> {
    let mut scales: Vec<u32> = rows.iter().map(|row| row.scale).collect();
    scales.dedup();
    let line = |(&scale, color): (&u32, &str)| {
        let own = rows.iter().filter(|row| row.scale == scale);
        let point = |row: &ConeRow| Point {
            seconds: 1e-3 * row.milliseconds,
            psnr: row.psnr_box,
            hint: format!("{0}x{0} cones: {1:.2} dB, {2:.1} ms", row.side, row.psnr_box, row.milliseconds),
        };
        Line {
            name: scale_name(scale),
            color: color.into(),
            class: "scale",
            points: own.map(point).collect(),
            ring: None,
        }
    };
    scales.iter().zip(svg::COLORS).map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_front_is_that_of_each_scale() {
        let row =
            |scale, milliseconds, psnr_box| ConeRow { scale, milliseconds, psnr_box, ..ConeRow::default() };
        let mut rows = vec![
            row(1, 10.0, 30.0),
            row(1, 40.0, 29.0),
            row(2, 3.0, 31.0),
            row(2, 12.0, 33.0),
            row(2, 50.0, 32.0),
        ];
        mark_front(&mut rows);
        assert_eq!(rows.iter().map(|row| row.pareto).collect::<Vec<_>>(), [true, false, true, true, false]);
        assert_eq!(lines(&rows).iter().map(|line| line.points.len()).collect::<Vec<_>>(), [2, 3]);
        let table = table(&rows);
        assert!(table.contains("box filter") && table.lines().count() >= 6, "{table}");
    }
}
