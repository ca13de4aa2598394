//! `report.html`: the report for people, one file without anything to fetch.

use super::{Report, Status, pictures, svg};
use crate::{
    machine,
    settings::{Row, rows},
    terminal,
};
use std::path::Path;
use trimip_core::evaluate::{MOST_PSNR, mean_quality};
use trimip_core::{Aabb, Origin, Result, config::Convention, run::progress, tri_mip::Pyramid};

/// The whole page; `images` is the folder of the comparisons.
pub fn page(report: &Report<'_>, images: &Path) -> Result<String> {
    let title = escape(&report.scene);
    Ok(format!(
        "<!doctype html>\n<html lang=\"en\">\n<head>\n<meta charset=\"utf-8\">\n\
         <meta name=\"viewport\" content=\"width=device-width, initial-scale=1\">\n<title>{title} – Tri-MipRF run</title>\n\
         <style>\n{}</style>\n</head>\n<body>\n<main>\n{}{}{}{}{}{}{}{}{}</main>\n</body>\n</html>\n",
        include_str!("style.css"),
        head(report, &title),
        warnings(report),
        quality(report),
        curve(report),
        views(report, images)?,
        measure(report),
        course(report),
        settings(report),
        format_args!("<footer>Written by trimip-cli {}.</footer>\n", machine::version()),
    ))
}

/// Text that is safe inside HTML.
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

fn head(report: &Report<'_>, title: &str) -> String {
    let totals = &report.history.totals;
    let (class, status) = match &report.status {
        Status::Finished => ("", "finished".to_string()),
        Status::Stopped if report.history.finished => ("stopped", "trained, final evaluation stopped".into()),
        Status::Stopped => {
            ("stopped", format!("stopped at {:.0} %", 100.0 * progress(report.config, totals)))
        }
        Status::Failed(message) => ("failed", escape(message)),
    };
    let unknown = || "unknown".to_string();
    let mut tiles = Vec::new();
    if let Some(e) = report.headline() {
        tiles.push((format!("{:.2} dB", e.psnr), "mean PSNR"));
        tiles.push((format!("{:.4}", e.ssim), "mean SSIM"));
    }
    tiles.push((terminal::duration(totals.seconds), "training time"));
    tiles.push((terminal::number(totals.samples as f64, ""), "samples"));
    tiles.push((
        report.samples_per_second().map_or_else(unknown, |rate| terminal::number(rate, "")),
        "samples / s",
    ));
    tiles.push((report.history.peak_memory_bytes().map_or_else(unknown, terminal::bytes), "peak memory"));
    tiles.push((report.model_bytes.map_or("not yet".into(), terminal::bytes), "model file"));
    let tiles: String =
        tiles.iter().map(|(value, name)| format!("<div><b>{value}</b><span>{name}</span></div>")).collect();
    let [x, y, z] = Pyramid::new(&report.config.encoder, &Aabb::new(&report.config.scene)).sides;
    let size = if x == y && y == z { format!("{x}×{x}") } else { format!("{x}×{y}×{z}") };
    format!(
        "<header><h1>{title}</h1>\n<p class=\"lead\">Tri-MipRF, planes {size}, {} steps, backend {} \
         <span class=\"status {class}\">{status}</span></p>\n<div class=\"tiles\">{tiles}</div></header>\n",
        totals.step, report.config.backend,
    )
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
    let mut body = String::new();
    for q in &e.scales {
        let of: Vec<f64> =
            report.views.iter().filter(|v| v.scale == q.scale).filter_map(|v| v.psnr).collect();
        let range = of
            .iter()
            .copied()
            .reduce(f64::min)
            .zip(of.iter().copied().reduce(f64::max))
            .map_or("–".into(), |(low, high)| format!("{low:.2} – {high:.2}"));
        body += &format!(
            "<tr><td>{}</td><td class=\"n\">{}</td><td class=\"n\">{:.3}</td><td class=\"n\">{range}</td><td class=\"n\">{:.3}</td><td class=\"n\">{:.3}</td><td class=\"n\">{:.4}</td></tr>",
            scale_name(q.scale),
            q.images,
            q.psnr,
            q.psnr_8bit,
            q.psnr_opposite,
            q.ssim
        );
    }
    let mean = mean_quality(&e.scales);
    body += &format!(
        "<tr class=\"mean\"><td>mean</td><td class=\"n\">{}</td><td class=\"n\">{:.3}</td><td class=\"n\"></td><td class=\"n\">{:.3}</td><td class=\"n\">{:.3}</td><td class=\"n\">{:.4}</td></tr>",
        e.scales.iter().map(|q| q.images).sum::<usize>(),
        mean.psnr,
        mean.psnr_8bit,
        mean.psnr_opposite,
        mean.ssim
    );
    let remark = mean.remark().map_or(String::new(), |remark| format!("<p>{}</p>", escape(&remark)));
    let note = if e.last {
        remark
    } else {
        format!(
            "<p>Measured on the way, on every {}. test view; the final evaluation is not made yet.</p>",
            e.stride
        )
    };
    format!(
        "<section><h2>Quality per scale</h2><div class=\"scroll\"><table><tr><th>scale</th><th class=\"n\">images</th>\
         <th class=\"n\">PSNR / dB</th><th class=\"n\">least – greatest</th><th class=\"n\">at 8 bits</th><th class=\"n\">on the opposite background</th><th class=\"n\">SSIM</th></tr>{body}</table></div>{note}</section>\n"
    )
}

fn scale_name(scale: u32) -> String {
    if scale == 1 { "full".into() } else { format!("1/{scale}") }
}

fn curve(report: &Report<'_>) -> String {
    let (curve, last) = (report.curve(), report.history.last());
    let plots = svg::plot(&curve, last, true).zip(svg::plot(&curve, last, false));
    let Some((logarithmic, linear)) = plots.filter(|_| curve.len() > 1) else { return String::new() };
    let mut legend = String::new();
    for (i, q) in curve[0].scales.iter().enumerate() {
        let color = svg::COLORS[i % svg::COLORS.len()];
        legend += &format!("<span><i style=\"color:{color}\"></i>{}</span>", scale_name(q.scale));
    }
    legend += "<span><i></i>mean of the scales</span>";
    let views = |e: &crate::history::Evaluation| e.scales.iter().map(|q| q.images).max().unwrap_or(0);
    let mut note = format!("The lines are measured on {} test views", views(curve[0]));
    if let Some(last) = last.filter(|last| !curve.contains(last)) {
        legend += "<span><i class=\"ring\"></i>final</span>";
        note += &format!(", the rings at the end on {}", views(last));
    }
    format!(
        "<section class=\"plot\"><h2>Error against time</h2><div class=\"legend\">{legend}</div>\
         <div class=\"log\">{logarithmic}</div><div class=\"linear\">{linear}</div>\
         <div class=\"axis\"><label><input type=\"radio\" name=\"axis\" id=\"axis-log\" checked> logarithmic time</label>\
         <label><input type=\"radio\" name=\"axis\" id=\"axis-linear\"> linear time</label></div>\
         <p class=\"lead\">{note}. Training time only: evaluations and pictures are not counted. The right axis is the root of the mean \
         squared error that the PSNR stands for.</p></section>\n"
    )
}

fn views(report: &Report<'_>, images: &Path) -> Result<String> {
    let mut figures = String::new();
    for view in pictures::shown(&report.views).into_iter().flatten() {
        figures += &pictures::figure(images, view)?;
    }
    if figures.is_empty() {
        return Ok(figures);
    }
    Ok(format!(
        "<section><h2>Test views</h2><p class=\"lead\">Finest and coarsest scale. The absolute difference is shown four times as \
         bright. Pictures in their own size are in <code>images/</code>.</p><div class=\"pair\">{figures}</div></section>\n"
    ))
}

fn measure(report: &Report<'_>) -> String {
    let data = &report.config.data;
    let [r, g, b] = data.background;
    let convention = match data.convention {
        Convention::Public => {
            "means of straight RGBA truncated to 8 bits, as the public multi-scale set is made (it darkens silhouettes)"
        }
        Convention::Premultiplied => "means of premultiplied RGBA rounded to 8 bits, right at silhouettes",
    };
    format!(
        "<section><h2>How it was measured</h2>\n<p>PSNR is −10·log<sub>10</sub> of the mean squared error of one image, on \
         rendered values clipped to [0, 1] and not rounded, in the photographs’ own sRGB values from 0 to 1; the target is \
         the 8-bit photograph on the background ({r}, {g}, {b}); an image that equals it counts as {MOST_PSNR} dB. A scale’s figure is the mean over its images, the headline the mean \
         over the scales. SSIM follows Wang et al. 2004: Gaussian window of 11 pixels, σ = 1.5, K<sub>1</sub> = 0.01, \
         K<sub>2</sub> = 0.03.</p>\n<p>Coarser photographs are {convention}. Trained on {}, tested on {}.</p></section>\n",
        escape(&data.train.join(" + ")),
        escape(&data.tested_on()),
    )
}

fn course(report: &Report<'_>) -> String {
    let (history, machine) = (report.history, &report.machine);
    let totals = &history.totals;
    let unknown = || "unknown".to_string();
    let wall: f64 = history.parts.iter().map(|part| part.wall_seconds).sum();
    let count = |value: u64| terminal::number(value as f64, "");
    let per = |value: u64| format!("{:.1}", value as f64 / totals.rays.max(1) as f64);
    let predicted = match report.config.backend.as_str() {
        "cpu" => "memory predicted",
        _ => "memory of the device, predicted",
    };
    let run = [
        ("training", terminal::duration(totals.seconds)),
        ("evaluation", terminal::duration(history.evaluation_seconds())),
        (
            "wall time, everything",
            format!("{} in {}", terminal::duration(wall), sessions(history.parts.len())),
        ),
        ("rays", count(totals.rays)),
        ("samples kept", format!("{} ({} per ray)", count(totals.samples), per(totals.samples))),
        ("samples marched", format!("{} ({} per ray)", count(totals.marched), per(totals.marched))),
        ("occupied cells", format!("{:.2} %", 100.0 * history.training.occupied)),
        ("empty batches", totals.empty_batches.to_string()),
        ("non-finite values", totals.non_finite.to_string()),
        (predicted, history.predicted_memory_bytes.map_or_else(unknown, terminal::bytes)),
        ("memory used at most", history.peak_memory_bytes().map_or_else(unknown, terminal::bytes)),
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
        ("memory", machine.memory_total_bytes.map_or_else(unknown, terminal::bytes)),
        ("system", machine.os.clone()),
        ("version", format!("trimip-cli {}", machine::version())),
    ];
    let table = |rows: &[(&str, String)]| {
        let rows: String = rows
            .iter()
            .map(|(name, value)| format!("<tr><td>{name}</td><td>{}</td></tr>", escape(value)))
            .collect();
        format!("<table>{rows}</table>")
    };
    format!(
        "<div class=\"pair\"><section><h2>Course of the run</h2>{}</section><section><h2>Machine</h2>{}</section></div>\n",
        table(&run),
        table(&place)
    )
}

fn sessions(count: usize) -> String {
    if count == 1 { "one session".into() } else { format!("{count} sessions") }
}

fn settings(report: &Report<'_>) -> String {
    let rows = rows(report.settings);
    let (set, defaults): (Vec<_>, Vec<_>) = rows.iter().partition(|row| row.origin != Origin::Default);
    let table = |rows: &[&Row]| {
        let body: String = rows.iter().map(|row| setting(row)).collect();
        format!(
            "<div class=\"scroll\"><table class=\"settings\"><tr><th>setting</th><th>value</th><th>from</th>\
             <th class=\"m\">meaning</th></tr>{body}</table></div>"
        )
    };
    let chosen =
        if set.is_empty() { "<p>Every setting has its default.</p>".to_string() } else { table(&set) };
    format!(
        "<section><h2>Settings</h2>{chosen}<details><summary>{} settings with their defaults</summary>{}</details></section>\n",
        defaults.len(),
        table(&defaults)
    )
}

fn setting(row: &Row) -> String {
    let path = if row.section.is_empty() { row.key.clone() } else { format!("{}.{}", row.section, row.key) };
    let class = if row.origin == Origin::Default { "" } else { " class=\"set\"" };
    format!(
        "<tr{class}><td class=\"k\">{path}</td><td class=\"v\">{}</td><td class=\"o\">{}</td><td class=\"m o\">{}</td></tr>",
        escape(&row.value),
        escape(&row.origin.to_string()),
        escape(&row.meaning)
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_page_is_whole_fetches_nothing_and_escapes_what_others_wrote() {
        super::super::example(|report| {
            let page = page(report, Path::new("nowhere")).unwrap();
            assert!(page.contains("lego &amp; co") && page.contains("a &lt;dark&gt; image"));
            assert!(!page.contains("http") && !page.contains("<script") && !page.contains("src=\"images"));
            for tag in ["section", "table", "div", "svg", "details", "p"] {
                let open =
                    page.matches(&format!("<{tag}>")).count() + page.matches(&format!("<{tag} ")).count();
                assert_eq!(open, page.matches(&format!("</{tag}>")).count(), "{tag}");
            }
            assert!(page.contains("24.50 dB") && page.contains("25.500"));
        });
    }
}
