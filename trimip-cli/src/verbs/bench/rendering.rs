//! Error of rendering against time per frame. The error is the difference from the same model's picture in f64 with very short steps. The
//! benchmark varies steps, early termination, pruning, hybrid rendering, occupancy cells, precision and cones per pixel. The field is
//! fixed, so the error is only that of the quadrature and of f32; for another number of cones than the model's, it also contains the
//! difference between the two numbers. When steps are halved, the observed order of convergence is printed next to the expected one. A
//! second table has the error of each stage relative to f64, on samples of the same view.

use super::stages::{self, StageError};
use crate::args::BenchArguments;
use crate::curves::aligned;
use crate::progress::{by_rows, spinner};
use crate::terminal;
use serde::Serialize;
use serde_json::json;
use std::path::Path;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;
use trimip::machine::{self, Machine};
use trimip::run::folder as run_folder;
use trimip::{backends, settings};
use trimip_core::config::{Precision, RendererKind};
use trimip_core::engine::proxy::Proxy;
use trimip_core::field::exact::Exact;
use trimip_core::field::model::{Model, OCCUPANCY, assets};
use trimip_core::geometry::occupancy;
use trimip_core::measures::metrics::psnr_of_error;
use trimip_core::{Camera, Error, Result};
use trimip_core::{atomic::write_atomically, field::tensors::Tensor};
use trimip_data::Watch;

/// Number of steps along the diagonal in the reference. A picture with half as many shows how far the reference is from its limit.
const REFERENCE_STEPS: u32 = 16_384;

/// Number of frames per measurement; the time of the fastest is reported.
const FRAMES: usize = 3;

/// A picture in f64, row-major.
type Picture = Vec<[f64; 3]>;

/// A way to render, with its error and time.
#[derive(Debug, Serialize)]
struct RenderingRow {
    varied: &'static str,
    value: String,
    /// Root-mean-square difference from the reference, colours in [0, 1].
    error: f64,
    /// The error as PSNR, dB.
    psnr: f64,
    milliseconds: f64,
    /// log2 of the error at twice the step length divided by the error at this step length.
    order: Option<f64>,
}

/// Renders one view with many settings.
pub fn run(arguments: &BenchArguments, path: &Path) -> Result<u8> {
    let mut model = run_folder::read_model(path)?;
    settings::override_model(&mut model, &arguments.settings.set)?;
    backends::check(&model.config.backend)?;
    // All rows except those of hybrid rendering vary volume rendering.
    model.config.renderer.kind = RendererKind::Volume;
    let camera = camera(&model, arguments)?;
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    terminal::aside(format!("the reference: {width}x{height} pixels in f64, {REFERENCE_STEPS} steps"));
    let exact = Exact::new(&model)?;
    let exactly = |doing, steps| by_rows(doing, |watch| picture(&exact, &camera, steps, watch));
    let reference = exactly("the reference", REFERENCE_STEPS);
    let own = distance(&exactly("the reference with half the steps", REFERENCE_STEPS / 2), &reference);

    let bar = spinner();
    let measure = |model: &Model, varied: &'static str, value: String| {
        bar.set_message(format!("{varied}: {value}"));
        measure(model, &camera, &reference, varied, value)
    };
    let mut rows: Vec<RenderingRow> = Vec::new();
    let mut before: Option<f64> = None;
    for steps in [64, 128, 256, 512, 1024, 2048, 4096] {
        let mut other = model.clone();
        other.config.renderer.steps_per_diagonal = steps;
        // Only the step length varies: no early termination, no pruning, uniform steps.
        (other.config.renderer.min_transmittance, other.config.renderer.min_weight) = (1e-9, 0.0);
        other.config.renderer.step_scale = trimip_core::config::schedule::Schedule::new(vec![[0.0, 1.0]]);
        other.config.renderer.step_per_radius = 0.0;
        let mut row = measure(&other, "steps along the diagonal", steps.to_string())?;
        row.order = before.map(|before| (before / row.error).log2());
        before = Some(row.error);
        rows.push(row);
    }
    for least in [0.1_f32, 1e-2, 1e-3, 1e-4, 1e-6, 1e-9] {
        let mut other = model.clone();
        other.config.renderer.min_transmittance = least;
        rows.push(measure(&other, "least transmittance", format!("{least:e}"))?);
    }
    for least in [0.0_f32, 1e-5, 1e-4, 1e-3, 1e-2] {
        let mut other = model.clone();
        other.config.renderer.min_weight = least;
        rows.push(measure(&other, "least weight", format!("{least:e}"))?);
    }
    if Proxy::is_in(&assets(&model.file)) {
        rows.extend(hybrid_rows(&model, &measure)?);
    }
    let mut coarser = model.clone();
    loop {
        let cells = coarser.config.occupancy.resolution;
        rows.push(measure(&coarser, "occupancy cells a side", cells.to_string())?);
        if !cells.is_multiple_of(8) || cells <= 16 {
            break;
        }
        let bits = coarser.file.u8("model", OCCUPANCY, &[(cells as usize).pow(3).div_ceil(8)])?;
        let bits = occupancy::coarsened(bits, cells);
        coarser.file.tensors.insert(OCCUPANCY.into(), Tensor::u8(&[bits.len()], bits));
        coarser.config.occupancy.resolution = cells / 2;
    }
    for (precision, name) in [(Precision::F32, "f32"), (Precision::Bf16, "bf16"), (Precision::F16, "f16")] {
        let mut other = model.clone();
        other.config.field.precision = precision;
        let session = backends::load(&other)?;
        if session.notes().is_empty() {
            rows.push(measure(&other, "precision", name.into())?);
        }
    }
    for side in [1, 2, 4] {
        let mut other = model.clone();
        (other.config.renderer.cones, other.config.renderer.cone_width) = (side, 0.0);
        rows.push(measure(&other, "cones a pixel", (side * side).to_string())?);
    }
    bar.suspend(|| terminal::line(table(&rows)));
    let remark = format!(
        "the reference differs by {own:.1e} from one with half the steps; expected order: 1 where cells of the occupancy \
         grid begin or end the medium, 2 within it; {} backend, {}",
        model.config.backend,
        Machine::detect().cpu
    );
    bar.suspend(|| terminal::prose(remark));
    bar.set_message("stages");
    let stages = stages::measure(&model, &camera)?;
    bar.finish_and_clear();
    terminal::line(stage_table(&stages));
    run_folder::create_writable(&arguments.out)?;
    let report = json!({
        "model": path.display().to_string(),
        "machine": Machine::detect(),
        "backend": model.config.backend,
        "device": backends::load(&model)?.device_name(),
        "version": machine::version(),
        "width": width,
        "height": height,
        "background": model.config.data.background,
        "reference": { "precision": "f64", "steps": REFERENCE_STEPS, "error_of_half_the_steps": own },
        "measures": "root of the mean squared difference of unrounded colours in [0, 1]; fastest of 3 frames",
        "rows": rows,
        "stages": stages,
    });
    let text = serde_json::to_string_pretty(&report).map_err(Error::run)?;
    write_atomically(&arguments.out.join("rendering.json"), text.as_bytes())?;
    let mut csv = "varied,value,error,psnr,milliseconds,order\n".to_string();
    for row in &rows {
        let order = row.order.map_or(String::new(), |order| format!("{order:.3}"));
        csv += &format!(
            "{},{},{:.6e},{:.3},{:.3},{order}\n",
            row.varied, row.value, row.error, row.psnr, row.milliseconds
        );
    }
    write_atomically(&arguments.out.join("rendering.csv"), csv.as_bytes())?;
    Ok(0)
}

/// Function that measures a way to render a model.
type Measure<'a> = dyn Fn(&Model, &'static str, String) -> Result<RenderingRow> + 'a;

/// Measures hybrid rendering, and varies each setting that selects its samples separately.
fn hybrid_rows(model: &Model, measure: &Measure<'_>) -> Result<Vec<RenderingRow>> {
    let mut base = model.clone();
    base.config.renderer.kind = RendererKind::Hybrid;
    let mut rows = Vec::new();
    for cells in [0.75_f32, 1.0, 1.25, 1.5, 2.0] {
        let mut other = base.clone();
        other.config.hybrid.step = cells;
        rows.push(measure(&other, "hybrid: step in cells", cells.to_string())?);
    }
    for least in [0.001_f32, 0.004, 0.01, 0.03] {
        let mut other = base.clone();
        (other.config.hybrid.least, other.config.hybrid.opaque) = (least, least);
        rows.push(measure(&other, "hybrid: least weight, opaque", least.to_string())?);
    }
    for fraction in [0.0_f32, 0.2, 0.5, 1.0] {
        let mut other = base.clone();
        other.config.hybrid.shared_weight = fraction;
        rows.push(measure(&other, "hybrid: weight of a colour", fraction.to_string())?);
    }
    Ok(rows)
}

/// Returns the camera of test view 0 at the requested size.
fn camera(model: &Model, arguments: &BenchArguments) -> Result<Camera> {
    let frames = trimip_data::open_test(&model.config.section()?)?.frames;
    let set = frames.load(0)?;
    let mut camera = set.views[0].camera;
    let scale = f64::from(arguments.width) / f64::from(camera.intrinsics.width);
    let height = ((f64::from(camera.intrinsics.height) * scale).round() as u32).max(1);
    resize(&mut camera, arguments.width, height, scale);
    Ok(camera)
}

/// Changes the resolution of a camera at the same field of view.
fn resize(camera: &mut Camera, width: u32, height: u32, scale: f64) {
    let k = &mut camera.intrinsics;
    (k.width, k.height) = (width, height);
    for length in [&mut k.fx, &mut k.fy, &mut k.cx, &mut k.cy] {
        *length *= scale;
    }
}

/// Renders a whole picture in f64 on all cores; `watch` receives the progress in rows.
fn picture(exact: &Exact, camera: &Camera, steps: u32, watch: Watch<'_>) -> Picture {
    let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
    let mut pixels = vec![[0.0; 3]; (width * height) as usize];
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let done = AtomicU64::new(0);
    let next = std::sync::Mutex::new(pixels.chunks_mut(width as usize).enumerate());
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                loop {
                    let Ok(Some((y, row))) = next.lock().map(|mut rows| rows.next()) else { break };
                    for (x, pixel) in row.iter_mut().enumerate() {
                        *pixel = exact.pixel(camera, x as u32, y as u32, steps);
                    }
                    watch(1 + done.fetch_add(1, Ordering::Relaxed), height.into());
                }
            });
        }
    });
    pixels
}

fn distance(a: &Picture, b: &Picture) -> f64 {
    let squares = a.iter().zip(b).flat_map(|(a, b)| (0..3).map(move |c| (a[c] - b[c]).powi(2)));
    (squares.sum::<f64>() / (3 * a.len()) as f64).sqrt()
}

/// Measures the error and the time of a model's picture.
fn measure(
    model: &Model,
    camera: &Camera,
    reference: &Picture,
    varied: &'static str,
    value: String,
) -> Result<RenderingRow> {
    let mut session = backends::load(model)?;
    let (mut fastest, mut found) = (f64::INFINITY, Vec::new());
    for _ in 0..FRAMES {
        let started = Instant::now();
        let frame = session.render(camera)?;
        fastest = fastest.min(started.elapsed().as_secs_f64());
        found = frame.pixels.iter().map(|pixel| pixel.rgb.map(f64::from)).collect();
    }
    let error = distance(&found, reference);
    let psnr = psnr_of_error(error * error);
    Ok(RenderingRow { varied, value, error, psnr, milliseconds: 1e3 * fastest, order: None })
}

fn stage_table(rows: &[StageError]) -> String {
    let head = ["stage", "precision", "values", "median ulp", "99 % ulp", "worst / largest", "ms"];
    let mut cells = vec![head.map(String::from).to_vec()];
    cells.extend(rows.iter().map(|row| {
        vec![
            row.stage.to_string(),
            row.precision.to_string(),
            row.values.to_string(),
            format!("{:.1}", row.median_ulp),
            format!("{:.0}", row.high_ulp),
            format!("{:.1e}", row.relative),
            format!("{:.2}", row.milliseconds),
        ]
    }));
    aligned(&cells)
}

fn table(rows: &[RenderingRow]) -> String {
    let mut cells =
        vec![["varied", "value", "error", "PSNR / dB", "ms a frame", "order"].map(String::from).to_vec()];
    cells.extend(rows.iter().map(|row| {
        vec![
            row.varied.to_string(),
            row.value.clone(),
            format!("{:.2e}", row.error),
            format!("{:.1}", row.psnr),
            format!("{:.2}", row.milliseconds),
            row.order.map_or(String::new(), |order| format!("{order:.2}")),
        ]
    }));
    aligned(&cells)
}
