//! `report.html`: the report for people, one self-contained file.

use super::page::{escape, pairs, plot, table};
use super::{page, pictures, settings, svg};
use std::path::Path;
use trimip::formatting;
use trimip::report::{Report, Status, text};
use trimip::{machine, run::provenance, view::PIXELS_PER_DEGREE};
use trimip_core::measures::metrics::LEAST_SIDE;
use trimip_core::measures::quality::{MOST_PSNR, Remedy, mean_quality};
use trimip_core::{Result, config::Convention, engine::events::progress, field::encoders};
use trimip_data::settings::DataConfig;

/// Returns the whole page; `images` is the folder of the comparisons.
pub fn page(report: &Report<'_>, images: &Path) -> Result<String> {
    let content = [
        head(report),
        warnings(report),
        quality(report),
        curve(report),
        pictures::strip(images.parent().unwrap_or(images), &report.config.scene)?,
        pictures::sections(report, images)?,
        measure(report),
        course(report),
        settings::section(report.settings),
    ];
    Ok(page::whole(&format!("{} on {} – Tri-MipRF run", report.run, report.scene), &content.concat()))
}

fn head(report: &Report<'_>) -> String {
    let totals = &report.history.totals;
    let (class, status) = match &report.status {
        Status::Finished => ("plain", "finished".to_string()),
        Status::Stopped if report.history.finished => {
            ("doubtful", "trained, final evaluation stopped".into())
        }
        Status::Stopped => {
            ("doubtful", format!("stopped at {:.0} %", 100.0 * progress(report.config, totals)))
        }
        Status::Failed(message) => ("bad", escape(message)),
    };
    let unknown = || "unknown".to_string();
    let mut tiles = Vec::new();
    if let Some(e) = report.headline() {
        tiles.push((format!("{:.2} dB", e.psnr), "mean PSNR"));
        tiles.push((format!("{:.4}", e.ssim), "mean SSIM"));
        let flip = mean_quality(&e.scales).flip;
        if !flip.is_nan() {
            tiles.push((format!("{flip:.4}"), "mean FLIP"));
        }
    }
    tiles.push((formatting::duration(totals.seconds), "training time"));
    tiles.push((formatting::number(totals.samples as f64, ""), "samples"));
    tiles.push((
        report.samples_per_second().map_or_else(unknown, |rate| formatting::number(rate, "")),
        "samples / s",
    ));
    let kept = totals.samples_per_ray().map_or_else(unknown, |kept| format!("{kept:.1}"));
    tiles.push((kept, "samples / ray"));
    if let Some(fraction) = totals.backward_fraction().filter(|fraction| *fraction < 1.0) {
        tiles.push((format!("{:.0} %", 100.0 * fraction), "with a backward pass"));
    }
    let rays = totals.rays_per_second().map_or_else(unknown, |rate| formatting::number(rate, ""));
    tiles.push((rays, "rays / s"));
    tiles.push((report.history.peak_memory_bytes().map_or_else(unknown, formatting::bytes), "peak memory"));
    tiles.push((report.model_bytes.map_or("not yet".into(), formatting::bytes), "model file"));
    let tiles: String =
        tiles.iter().map(|(value, name)| format!("<div><b>{value}</b><span>{name}</span></div>")).collect();
    let encoder = encoders::of(report.config).describe(report.config);
    let verdict = report.verdict();
    format!(
        "<header><h1>{} <span class=\"scene\">on {}</span></h1>\n\
         <p class=\"lead\">{encoder}, {} steps, backend {} <b class=\"badge {class}\">{status}</b></p>\n\
         <p class=\"verdict\"><b class=\"badge {}\">{}</b> {}.</p>\n<div class=\"tiles\">{tiles}</div>\n{}</header>\n",
        escape(&report.run),
        escape(&report.scene),
        totals.step,
        report.config.backend,
        verdict.class(),
        verdict.label(),
        escape(&verdict.reasons().join("; ")),
        origin(report),
    )
}

/// Returns the origin of the report: the measured views, one row per command of a session, and the version and end time
/// of the last session.
fn origin(report: &Report<'_>) -> String {
    let mut rows = vec![("measured on", report.views_measured())];
    let sessions: Vec<_> = report.history.parts.iter().map(|part| &part.provenance).collect();
    let mut commands: Vec<&String> = sessions.iter().filter_map(|session| session.command.as_ref()).collect();
    commands.dedup();
    rows.extend(commands.into_iter().map(|command| ("command", command.clone())));
    let last = |value: Option<String>| value.unwrap_or_else(|| "unknown".into());
    let session = sessions.last();
    let version = session.and_then(|session| session.version.clone());
    rows.push(("version (commit)", last(version.map(|version| format!("trimip-cli {version}")))));
    rows.push(("ended", last(session.and_then(|session| session.ended_unix).map(provenance::date))));
    format!("<div class=\"origin\">{}</div>", pairs(&rows))
}

fn warnings(report: &Report<'_>) -> String {
    if report.history.warnings.is_empty() {
        return String::new();
    }
    let items: String =
        report.history.warnings.iter().map(|text| format!("<li>{}</li>", escape(text))).collect();
    format!("<section><h2>Warnings</h2><ul class=\"warnings\">{items}</ul></section>\n")
}

fn quality(report: &Report<'_>) -> String {
    let Some(e) = report.headline() else {
        return "<section><h2>Quality</h2><p>Not evaluated yet.</p></section>\n".into();
    };
    let mut note = format!("Measured on {}. ", report.views_measured());
    if !e.last {
        note += &format!(
            "The stride over the test views is {}; the final evaluation has not run yet. ",
            e.stride
        );
    }
    note += &text::perceptual(report);
    note += &escape(&text::poses(report));
    note += &text::distance(report);
    if let Some(remark) = mean_quality(&e.scales).remark(Remedy::of(report.config)) {
        note += &format!("Remark: {}. ", escape(&remark));
    }
    let all = text::measures(report);
    format!(
        "<section><h2>Quality per scale</h2>{}<p class=\"lead\">{note}</p><details><summary>Other kinds of PSNR</summary>{}<p>“Plain” \
         leaves out the edge exponents of the set; “box filter” compares with block means of the finest photographs; “at 8 bits” rounds both \
         pictures; “own exposure” applies one gain per channel, fitted for each half of a picture on the other half; “on opposite” uses another \
         background, black where the configured one is bright and white where it is dark; “mean colour” is the PSNR of each photograph’s mean \
         colour in place of the rendering.</p></details></section>\n",
        table(&text::columns(&all, &MEASURES), true),
        table(&text::columns(&all, &OTHER_KINDS), true)
    )
}

/// Columns of the table of measures.
const MEASURES: [&str; 8] =
    ["scale", "images", "PSNR / dB", "least – greatest", "SSIM", "MS-SSIM", "FLIP", "LPIPS"];

/// Columns of the folded table of other kinds of PSNR.
const OTHER_KINDS: [&str; 7] =
    ["scale", "plain", "box filter", "at 8 bits", "own exposure", "on opposite", "mean colour"];

fn curve(report: &Report<'_>) -> String {
    let (curve, last) = (report.curve(), report.history.last());
    if curve.len() < 2 {
        let why = match report.config.eval.points {
            0 => "with eval.points = 0, no test views are measured during training".to_string(),
            _ => format!(
                "test views were measured {} during training, as often as eval.time_fraction allowed",
                formatting::count(curve.len() as u64, "time")
            ),
        };
        return format!(
            "<section><h2>Error against time</h2><p class=\"lead\">No curve: {why}.</p></section>\n"
        );
    }
    let mut note = format!("The lines are measured on {} test views", curve[0].views());
    if let Some(last) = last.filter(|last| !curve.contains(last)) {
        note += &format!(", the rings at the end on {}", last.views());
    }
    plot("Error against time", &svg::lines(&curve, last), &format!("{note}."))
}

fn measure(report: &Report<'_>) -> String {
    let data = &report.config.data;
    let [r, g, b] = data.background;
    let convention = match data.convention {
        Convention::Public => {
            "means of straight RGBA truncated to 8 bits, as in the public multi-scale set (this darkens silhouettes)"
        }
        Convention::Premultiplied => "means of premultiplied RGBA rounded to 8 bits, correct at silhouettes",
    };
    let sets = report.config.section::<DataConfig>().map_or_else(
        |_| String::new(),
        |data| {
            let (train, test) = (data.train.join(" + "), data.tested_on());
            format!(" Trained on {}, tested on {}.", escape(&train), escape(&test))
        },
    );
    format!(
        "<section><h2>How it was measured</h2>\n<p>PSNR is −10·log<sub>10</sub> of the mean squared error of one image, on \
         rendered values clipped to [0, 1] and not rounded, in the photographs’ own sRGB values from 0 to 1; the target is \
         the 8-bit photograph on the background ({r}, {g}, {b}); an image that equals it counts as {MOST_PSNR} dB. A scale’s figure is the mean over its images, the headline the mean \
         over the scales. SSIM follows Wang et al. 2004: Gaussian window of 11 pixels, σ = 1.5, K<sub>1</sub> = 0.01, \
         K<sub>2</sub> = 0.03; MS-SSIM follows Wang et al. 2003: five scales, the published weights, images of at least \
         {LEAST_SIDE} pixels. FLIP is the mean of LDR-FLIP (Andersson et al. 2020) on values rounded to 8 bits, as seen with \
         {PIXELS_PER_DEGREE:.0} pixels per degree; 0 is equal, 1 the greatest error. LPIPS (Zhang et al. 2018) uses the network \
         of <code>eval.lpips</code>.</p>\n<p>Coarser photographs are {convention}.{sets}</p></section>\n",
    )
}

fn course(report: &Report<'_>) -> String {
    let (history, machine) = (report.history, &report.machine);
    let totals = &history.totals;
    let unknown = || "unknown".to_string();
    let wall: f64 = history.parts.iter().map(|part| part.wall_seconds).sum();
    let count = |value: u64| formatting::number(value as f64, "");
    let per = |value: u64| format!("{:.1}", value as f64 / totals.rays.max(1) as f64);
    let predicted = match report.config.backend.as_str() {
        "cpu" => "memory predicted",
        _ => "device memory, predicted",
    };
    let run = [
        ("training", formatting::duration(totals.seconds)),
        ("evaluation", formatting::duration(history.evaluation_seconds())),
        ("total wall time", format!("{} in {}", formatting::duration(wall), sessions(history.parts.len()))),
        ("rays", count(totals.rays)),
        ("samples kept", format!("{} ({} per ray)", count(totals.samples), per(totals.samples))),
        ("samples marched", format!("{} ({} per ray)", count(totals.marched), per(totals.marched))),
        ("occupied cells", format!("{:.2} %", 100.0 * history.training.occupied)),
        ("empty batches", totals.empty_batches.to_string()),
        ("non-finite values", totals.non_finite.to_string()),
        (predicted, history.predicted_memory_bytes.map_or_else(unknown, formatting::bytes)),
        ("peak memory", history.peak_memory_bytes().map_or_else(unknown, formatting::bytes)),
    ];
    let threads = match report.config.threads {
        0 => "all".to_string(),
        threads => threads.to_string(),
    };
    let place = [
        ("backend", history.devices().join("; ")),
        ("processor", machine.cpu.clone()),
        ("cores", format!("{} (threads used: {threads})", machine.cores)),
        ("instruction sets", machine.simd.join(", ")),
        ("memory", machine.memory_total_bytes.map_or_else(unknown, formatting::bytes)),
        ("system", machine.os.clone()),
        ("version", format!("trimip-cli {}", machine::version())),
    ];
    format!(
        "<div class=\"pair\"><section><h2>Course of the run</h2>{}</section><section><h2>Machine</h2>{}</section></div>\n",
        pairs(&run),
        pairs(&place)
    )
}

fn sessions(count: usize) -> String {
    if count == 1 { "one session".into() } else { format!("{count} sessions") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_whole_fetches_nothing_and_escapes_what_others_wrote() {
        trimip::run::fixtures::report(|report| {
            let page = page(report, Path::new("nowhere")).unwrap();
            page::expect_whole(&page);
            assert!(page.contains("lego &amp; co") && page.contains("a &lt;dark&gt; image"));
            assert!(page.contains("24.50 dB") && page.contains("25.50") && page.contains("first_run"));
        });
    }

    #[test]
    fn the_page_says_where_the_run_came_from_and_what_it_came_to() {
        trimip::run::fixtures::report(|report| {
            let page = page(report, Path::new("nowhere")).unwrap();
            for part in [
                "<b>100.0</b><span>samples / ray",
                "<b>100</b><span>rays / s",
                "config a&amp;b.toml",
                "0.1.0 (abc)",
                "1970-01-01",
                "8 of 200 test views",
            ] {
                assert!(page.contains(part), "{part}");
            }
            assert!(page.contains("<b class=\"badge doubtful\">fair</b>"));
        });
    }
}
