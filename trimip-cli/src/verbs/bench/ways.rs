//! Error against time per frame for ways to render with few samples, at every scale of the test views. The error is relative to the
//! photographs, and to converged volume rendering of the same model. The ways are volume rendering with longer steps, with steps that
//! follow the cone and with early termination, and hybrid rendering with each of its settings varied; or the ways of `--try`.

use super::training::{Variant, tried};
use crate::args::BenchArguments;
use crate::curves::aligned;
use crate::progress::spinner;
use crate::terminal;
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;
use std::time::Instant;
use trimip::machine::{self, Machine};
use trimip::report::scale_name;
use trimip::run::folder as run_folder;
use trimip::{backends, settings};
use trimip_core::atomic::write_atomically;
use trimip_core::config::RendererKind;
use trimip_core::engine::proxy::Proxy;
use trimip_core::field::model::{Model, assets};
use trimip_core::measures::metrics::psnr;
use trimip_core::run::evaluate::compared;
use trimip_core::{Error, Result, Viewer};
use trimip_report::page;
use trimip_report::svg::{self, Line, Point};

/// Factor by which converged volume rendering shortens the model's steps.
const SHORTER: u32 = 4;

/// Name of the baseline: volume rendering as the model configures it.
const BASE: &str = "volume";

/// A way to render. The ways of a family differ in one setting.
struct Way {
    family: String,
    name: String,
    viewer: Box<dyn Viewer>,
}

/// Results of one way at one scale: means over the views.
#[derive(Clone, Debug, Default, Serialize)]
struct WayRow {
    /// Reduction of the views: 1, 2, 4, 8.
    scale: u32,
    family: String,
    name: String,
    /// PSNR in dB, with the set's edge exponents.
    psnr: f64,
    /// PSNR minus the PSNR of the first way, dB.
    gain: f64,
    /// PSNR in dB relative to converged volume rendering.
    psnr_converged: f64,
    /// Time per frame, milliseconds.
    milliseconds: f64,
    /// Time per frame of the first way divided by the time per frame of this one.
    speed: f64,
    /// True if no other way at this scale is both faster and closer to converged volume rendering.
    pareto: bool,
}

/// Renders test views in every way.
pub fn run(arguments: &BenchArguments, path: &Path) -> Result<u8> {
    let mut model = run_folder::read_model(path)?;
    settings::override_model(&mut model, &arguments.settings.set)?;
    backends::check(&model.config.backend)?;
    let data = model.config.data.clone();
    let scene = trimip_data::open_test(&model.config.section()?)?;
    let stride = scene.frames.len().div_ceil(arguments.views as usize).max(1);
    let indices: Vec<usize> = (0..scene.frames.len()).step_by(stride).collect();
    let mut converged = backends::load(&converged(&model))?;
    let mut ways = ways(&model, arguments)?;
    let bar = spinner();
    let mut found: BTreeMap<(u32, usize), WayRow> = BTreeMap::new();
    let fraction = 1.0 / indices.len() as f64;
    for &index in &indices {
        let set = scene.frames.load(index)?;
        // Coarse scales come first: the first pictures of a session also allocate its memory, so they should be the cheap ones.
        let views = set.scales.iter().rev().flat_map(|s| s.views.clone().map(move |view| (s.factor, view)));
        for (factor, view) in views {
            let camera = &set.views[view].camera;
            let at = format!("view {index} {}", scale_name(factor));
            bar.set_message(format!("{at}: converged"));
            let reference = converged.render(camera)?.rgb();
            let target = compared(&set, view, set.composited(view, data.background));
            for (i, way) in ways.iter_mut().enumerate() {
                bar.set_message(format!("{at}: {} {}", way.family, way.name));
                let started = Instant::now();
                let frame = way.viewer.render(camera)?;
                let milliseconds = 1e3 * started.elapsed().as_secs_f64();
                let row = found.entry((factor, i)).or_insert_with(|| WayRow {
                    scale: factor,
                    family: way.family.clone(),
                    name: way.name.clone(),
                    ..WayRow::default()
                });
                row.psnr_converged += fraction * psnr(&frame.rgb(), &reference);
                let shown = frame.shown(data.background, data.edge_exponent(factor));
                row.psnr += fraction * psnr(&compared(&set, view, shown.rgb()), &target);
                row.milliseconds += fraction * milliseconds;
            }
        }
    }
    bar.finish_and_clear();
    let mut rows: Vec<WayRow> = found.into_values().collect();
    compare(&mut rows);
    terminal::line(aligned(&cells(&rows)));
    terminal::prose(format!(
        "{} of {} views, {}; converged: steps a {SHORTER}th as long, nothing left out; * marks ways that no other way at the \
         scale beats in both time and error; {} on {}",
        indices.len(),
        scene.frames.len(),
        scene.name,
        model.config.backend,
        converged.device_name(),
    ));
    write(arguments, path, &model, &converged.device_name(), &rows, &indices)?;
    Ok(0)
}

/// Returns the model with the settings of converged volume rendering.
fn converged(model: &Model) -> Model {
    let mut model = model.clone();
    let renderer = &mut model.config.renderer;
    renderer.kind = RendererKind::Volume;
    renderer.steps_per_diagonal *= SHORTER;
    (renderer.min_transmittance, renderer.min_weight, renderer.step_per_radius) = (1e-6, 0.0, 0.0);
    model
}

/// Returns the ways to compare. The first is volume rendering as the model configures it.
fn ways(model: &Model, arguments: &BenchArguments) -> Result<Vec<Way>> {
    let has_proxy = Proxy::is_in(&assets(&model.file));
    let mut ways = vec![way(model, BASE, &Variant { name: BASE.into(), assignments: vec![volume()] })?];
    if !arguments.variants.is_empty() {
        for variant in tried(&arguments.variants)? {
            ways.push(way(model, &variant.name, &variant)?);
        }
        return Ok(ways);
    }
    for (family, name, assignments) in catalogue(model.config.renderer.steps_per_diagonal, has_proxy) {
        ways.push(way(model, family, &Variant { name, assignments })?);
    }
    Ok(ways)
}

fn way(model: &Model, family: &str, variant: &Variant) -> Result<Way> {
    let mut model = model.clone();
    settings::override_model(&mut model, &variant.assignments)?;
    Ok(Way { family: family.into(), name: variant.name.clone(), viewer: backends::load(&model)? })
}

fn volume() -> String {
    "renderer.kind=volume".into()
}

/// Returns the family, name and settings of the default ways, which are used without `--try`.
fn catalogue(steps: u32, has_proxy: bool) -> Vec<(&'static str, String, Vec<String>)> {
    let mut all = Vec::new();
    for longer in [1.5, 2.0, 3.0] {
        let assignment = format!("renderer.steps_per_diagonal={:.0}", f64::from(steps) / longer);
        all.push(("longer steps", format!("{longer} times"), vec![volume(), assignment]));
    }
    for radii in [3.0, 4.0, 6.0] {
        let assignment = format!("renderer.step_per_radius={radii:?}");
        all.push(("steps follow the cone", format!("{radii} radii"), vec![volume(), assignment]));
    }
    for (transmittance, weight) in [(1e-2, 0.0), (1e-2, 1e-3), (1e-2, 3e-3), (3e-2, 1e-2)] {
        let assignments = vec![
            volume(),
            format!("renderer.min_transmittance={transmittance:?}"),
            format!("renderer.min_weight={weight:?}"),
        ];
        all.push(("early stop", format!("transmittance {transmittance}, weight {weight}"), assignments));
    }
    if !has_proxy {
        return all;
    }
    let mut hybrid = |family: &'static str, name: String, assignments: &[String]| {
        let kind = ["renderer.kind=hybrid".to_string()];
        all.push((family, name, kind.iter().chain(assignments).cloned().collect()));
    };
    for cells in [0.75, 1.0, 1.25, 1.5, 2.0, 3.0] {
        hybrid("hybrid: step", format!("{cells} cells"), &[format!("hybrid.step={cells:?}")]);
    }
    for least in [0.001, 0.003, 0.01, 0.03] {
        hybrid("hybrid: least weight", format!("{least}"), &[format!("hybrid.least={least:?}")]);
    }
    for opaque in [0.0001, 0.002, 0.01, 0.03] {
        hybrid("hybrid: end of a ray", format!("{opaque}"), &[format!("hybrid.opaque={opaque:?}")]);
    }
    for (delta, samples, layers) in
        [(3.0, 8, 4), (6.0, 8, 4), (12.0, 8, 4), (12.0, 16, 1), (12.0, 16, 2), (12.0, 16, 4)]
    {
        let assignments = [
            "hybrid.rule=layers".to_string(),
            format!("hybrid.delta={delta:?}"),
            format!("hybrid.samples={samples}"),
            format!("hybrid.layers={layers}"),
        ];
        let name = format!("{samples} within ±{delta} cells, {layers} at most");
        hybrid("hybrid: layers", name, &assignments);
    }
    for fraction in [0.0, 0.1, 0.2, 0.4, 1.0] {
        hybrid(
            "hybrid: shared colours",
            format!("{fraction}"),
            &[format!("hybrid.shared_weight={fraction:?}")],
        );
    }
    all
}

/// Sets `gain` and `speed` relative to the first row of the same scale, and `pareto` relative to all rows of that scale.
fn compare(rows: &mut [WayRow]) {
    let all: Vec<_> = rows.iter().map(|r| (r.scale, r.psnr, r.milliseconds, r.psnr_converged)).collect();
    for (row, own) in rows.iter_mut().zip(&all) {
        let mut others = all.iter().filter(|other| other.0 == own.0);
        if let Some(base) = others.clone().next() {
            (row.gain, row.speed) = (own.1 - base.1, base.2 / own.2);
        }
        row.pareto = !others.any(|other| other != own && other.2 <= own.2 && other.3 >= own.3);
    }
}

fn cells(rows: &[WayRow]) -> Vec<Vec<String>> {
    let head = [
        "scale",
        "way",
        "",
        "ms a frame",
        "speed",
        "converged / dB",
        "photographs / dB",
        "minus volume",
        "front",
    ];
    let mut cells = vec![head.map(String::from).to_vec()];
    cells.extend(rows.iter().map(|row| {
        vec![
            scale_name(row.scale),
            row.family.clone(),
            if row.name == row.family { String::new() } else { row.name.clone() },
            format!("{:.1}", row.milliseconds),
            format!("{:.2}", row.speed),
            format!("{:.2}", row.psnr_converged),
            format!("{:.3}", row.psnr),
            format!("{:+.3}", row.gain),
            if row.pareto { "*".into() } else { String::new() },
        ]
    }));
    cells
}

/// Writes `ways.json`, `ways.csv`, a plot per scale (`ways-1.svg`, ..), and all results as `ways.html`.
fn write(
    arguments: &BenchArguments,
    path: &Path,
    model: &Model,
    device: &str,
    rows: &[WayRow],
    indices: &[usize],
) -> Result<()> {
    run_folder::create_writable(&arguments.out)?;
    let keep = |name: &str, text: &str| write_atomically(&arguments.out.join(name), text.as_bytes());
    let machine = Machine::detect();
    let report = json!({
        "model": path.display().to_string(),
        "machine": machine,
        "backend": model.config.backend,
        "device": device,
        "version": machine::version(),
        "views": indices,
        "background": model.config.data.background,
        "edge_exponents": model.config.data.edge_exponents,
        "measures": "means over the views: psnr in dB with the edge exponents of the set, gain the same minus that of \
                     the first way, psnr_converged in dB against volume rendering with shorter steps, milliseconds of a frame, \
                     speed relative to the first way",
        "rows": rows,
    });
    keep("ways.json", &serde_json::to_string_pretty(&report).map_err(Error::run)?)?;
    let mut csv = "scale,family,name,milliseconds,speed,psnr_converged,psnr,gain,pareto\n".to_string();
    for row in rows {
        let text = |text: &str| text.replace('"', "\"\"");
        csv += &format!(
            "{},\"{}\",\"{}\",{:.3},{:.3},{:.3},{:.4},{:.4},{}\n",
            row.scale,
            text(&row.family),
            text(&row.name),
            row.milliseconds,
            row.speed,
            row.psnr_converged,
            row.psnr,
            row.gain,
            row.pareto
        );
    }
    keep("ways.csv", &csv)?;
    let mut sections = String::new();
    for group in rows.chunk_by(|a, b| a.scale == b.scale) {
        let scale = group[0].scale;
        sections += &format!("<section><h2>{}</h2>\n", scale_name(scale));
        let mut plot = |suffix: &str, title: &str, value: fn(&WayRow) -> f64| {
            let plot = svg::alone(&lines(group, value), "seconds a frame").unwrap_or_default();
            sections += &format!("<h3>{title}</h3>\n{plot}");
            keep(&format!("ways-{scale}{suffix}.svg"), &plot)
        };
        plot("", "Against converged volume rendering", |row| row.psnr_converged)?;
        plot("-photographs", "Against the photographs", |row| row.psnr)?;
        sections += &page::table(&cells(group), false);
        sections += "</section>\n";
    }
    let head = format!(
        "<header><h1>Ways to render with few samples</h1><p class=\"lead\">{}, backend {} on {}; means over {}. Converged: steps a \
         {SHORTER}th as long, nothing left out. A star marks ways that no other way at the scale beats in both time \
         and error.</p></header>\n",
        page::escape(&path.display().to_string()),
        page::escape(&model.config.backend),
        page::escape(device),
        terminal::count(indices.len() as u64, "view"),
    );
    keep("ways.html", &page::whole("Ways to render with few samples – Tri-MipRF", &(head + &sections)))
}

/// Returns one line per family at a scale.
fn lines(rows: &[WayRow], value: fn(&WayRow) -> f64) -> Vec<Line> {
    let point = |row: &WayRow| Point {
        seconds: 1e-3 * row.milliseconds,
        psnr: value(row),
        hint: format!("{} {}: {:.2} dB, {:.1} ms", row.family, row.name, value(row), row.milliseconds),
    };
    let line = |(i, family): (usize, &[WayRow])| {
        let mut points: Vec<Point> = family.iter().map(point).collect();
        points.sort_by(|a, b| a.seconds.total_cmp(&b.seconds));
        // The baseline is black.
        let color = if i == 0 { "#1b1f24" } else { svg::COLORS[(i - 1) % svg::COLORS.len()] };
        Line { name: family[0].family.clone(), color: color.into(), class: "scale", points, ring: None }
    };
    rows.chunk_by(|a, b| a.family == b.family).enumerate().map(line).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_compared_within_their_scale() {
        let row = |scale, milliseconds, psnr_converged, psnr| WayRow {
            scale,
            milliseconds,
            psnr_converged,
            psnr,
            ..WayRow::default()
        };
        let mut rows = vec![
            row(1, 40.0, 60.0, 35.0),
            row(1, 10.0, 50.0, 34.9),
            row(1, 20.0, 45.0, 34.8),
            row(2, 8.0, 70.0, 38.0),
        ];
        compare(&mut rows);
        assert_eq!(rows.iter().map(|row| row.pareto).collect::<Vec<_>>(), [true, true, false, true]);
        assert_eq!(rows.iter().map(|row| row.speed).collect::<Vec<_>>(), [1.0, 4.0, 2.0, 1.0]);
        assert!((rows[2].gain + 0.2).abs() < 1e-9 && rows[3].gain == 0.0);
    }

    #[test]
    fn the_catalogue_holds_settings_that_exist() {
        let mut model = Model::new(trimip_core::Config::default(), Default::default());
        for (family, name, assignments) in catalogue(1024, true) {
            settings::override_model(&mut model, &assignments)
                .unwrap_or_else(|e| panic!("{family} {name}: {e}"));
        }
        assert!(catalogue(1024, false).iter().all(|(family, ..)| !family.starts_with("hybrid")));
    }
}
