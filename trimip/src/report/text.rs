//! `report.md` and `report.tex`: the verdict and the table of metrics, as Markdown, and as a LaTeX `tabular` (package booktabs) of the
//! columns that papers print. PSNR in dB.

use super::content::{Report, scale_name};
use super::latex::tabular;
use crate::formatting;
use trimip_core::measures::{
    metrics::LEAST_SIDE,
    quality::{Measures, mean_quality},
};

/// Returns the header and the rows of the table of metrics: one row per scale and one for their mean. Empty if nothing
/// was measured. A perceptual measure that no scale has is left out.
pub fn measures(report: &Report<'_>) -> Vec<Vec<String>> {
    let Some(e) = report.headline() else { return Vec::new() };
    let mean = mean_quality(&e.scales);
    let perception =
        [("MS-SSIM", (|m| m.ms_ssim) as fn(&Measures) -> f64), ("FLIP", |m| m.flip), ("LPIPS", |m| m.lpips)];
    let perception: Vec<_> = perception.into_iter().filter(|(_, of)| !of(&mean).is_nan()).collect();
    let head = [
        "scale",
        "images",
        "PSNR / dB",
        "least – greatest",
        "plain",
        "box filter",
        "at 8 bits",
        "own exposure",
        "on opposite",
        "mean colour",
        "SSIM",
    ];
    let mut rows = vec![head.map(String::from).to_vec()];
    rows[0].extend(perception.iter().map(|(name, _)| name.to_string()));
    let row = |name: String, images: usize, range: String, m: &Measures| {
        let decibels = |psnr: f64| if psnr.is_nan() { "–".into() } else { format!("{psnr:.2}") };
        let others =
            [m.psnr_plain, m.psnr_box, m.psnr_8bit, m.psnr_exposed, m.psnr_opposite, m.psnr_constant];
        let mut row = vec![name, images.to_string(), decibels(m.psnr), range];
        row.extend(others.map(decibels));
        let fraction = |value: f64| if value.is_nan() { "–".into() } else { format!("{value:.4}") };
        row.push(fraction(m.ssim));
        row.extend(perception.iter().map(|(_, of)| fraction(of(m))));
        row
    };
    for q in &e.scales {
        let of = || report.views.iter().filter(|v| v.scale == q.scale).filter_map(|v| v.psnr);
        let range = of().reduce(f64::min).zip(of().reduce(f64::max));
        let range = range.map_or("–".into(), |(low, high)| format!("{low:.2} – {high:.2}"));
        rows.push(row(scale_name(q.scale), q.images, range, &q.measures));
    }
    let images = e.scales.iter().map(|q| q.images).sum();
    rows.push(row("mean".into(), images, String::new(), &mean));
    rows
}

/// Returns the columns with these names, in the order of the table.
pub fn columns(rows: &[Vec<String>], names: &[&str]) -> Vec<Vec<String>> {
    let Some(head) = rows.first() else { return Vec::new() };
    let kept: Vec<usize> = (0..head.len()).filter(|&column| names.contains(&head[column].as_str())).collect();
    rows.iter().map(|row| kept.iter().filter_map(|&column| row.get(column).cloned()).collect()).collect()
}

/// Returns a sentence on the views behind the means of the perceptual measures; empty if there are none.
pub fn perceptual(report: &Report<'_>) -> String {
    let scales = report.headline().map_or(&[][..], |e| &e.scales);
    let Some(most) = scales.iter().map(|q| q.perceptual_images).max().filter(|&most| most > 0) else {
        return String::new();
    };
    let all = scales.iter().all(|q| q.perceptual_images == q.images);
    let of = if all { "all views".to_string() } else { format!("{most} evenly spread views") };
    let mut text = format!("MS-SSIM, FLIP and LPIPS are means over {of}");
    if scales.iter().any(|q| q.measures.ms_ssim.is_nan()) {
        text += &format!(", MS-SSIM without scales below {LEAST_SIDE} pixels");
    }
    text + ". "
}

/// Returns a sentence on the refined poses; empty if poses were not refined.
pub fn poses(report: &Report<'_>) -> String {
    let Some((moved, aligned)) = &report.history.poses else { return String::new() };
    let aligned = aligned.map_or(String::new(), |aligned| format!("; {aligned}"));
    format!("The {moved}{aligned}. ")
}

/// Returns a sentence on how PSNR depends on the distance to the nearest photograph; empty if that was not measured.
pub fn distance(report: &Report<'_>) -> String {
    let Some(found) = report.psnr_by_distance() else { return String::new() };
    let apart = found.spacings.map_or(String::new(), |(least, greatest)| {
        format!("; these distances are {least:.2} to {greatest:.2} times the spacing of the training cameras")
    });
    format!(
        "The rank correlation of PSNR and the distance to the nearest training camera is {:.2} over {} views{apart}. ",
        found.rank_correlation, found.views
    )
}

/// Returns the caption of the figures, one line.
fn caption(report: &Report<'_>) -> String {
    let totals = &report.history.totals;
    let drawn = totals.backward_fraction().filter(|fraction| *fraction < 1.0);
    let drawn =
        drawn.map_or(String::new(), |fraction| format!(" ({:.0} % with a backward pass)", 100.0 * fraction));
    let kept =
        totals.samples_per_ray().map_or(String::new(), |kept| format!("{kept:.1} samples a ray{drawn}, "));
    let rate = totals
        .rays_per_second()
        .map_or(String::new(), |rate| format!("{}, ", formatting::number(rate, "rays/s")));
    format!(
        "{} on {}: {} steps, {} of training, {kept}{rate}backend {}, {}",
        report.run,
        report.scene,
        totals.step,
        formatting::duration(totals.seconds),
        report.config.backend,
        report.views_measured()
    )
}

/// Returns the report's table as Markdown.
pub fn markdown(report: &Report<'_>) -> String {
    let safe = |text: &str| text.replace('|', "\\|").replace('<', "&lt;");
    let mut text = format!(
        "# {}\n\n{}.\n\nVerdict: {}.\n",
        safe(&report.run),
        safe(&caption(report)),
        safe(&report.verdict().words())
    );
    for (i, row) in measures(report).iter().enumerate() {
        let cells: Vec<_> = row.iter().map(|cell| safe(cell)).collect();
        if i == 0 {
            text.push('\n');
        }
        text += &format!("| {} |\n", cells.join(" | "));
        if i == 0 {
            text += &format!("|---|{}\n", "---:|".repeat(row.len() - 1));
        }
    }
    for sentence in
        [perceptual(report), poses(report), distance(report)].iter().filter(|sentence| !sentence.is_empty())
    {
        text += &format!("\n{}\n", sentence.trim_end());
    }
    text
}

/// Columns of the LaTeX table; `report.md` has the others.
const PRINTED: [&str; 7] = ["scale", "images", "PSNR / dB", "SSIM", "MS-SSIM", "FLIP", "LPIPS"];

/// Returns the report's table as LaTeX.
pub fn latex(report: &Report<'_>) -> String {
    let rows = columns(&measures(report), &PRINTED);
    let mut text = format!(
        "% {}\n% Verdict: {}\n% \\usepackage{{booktabs}}\n",
        caption(report),
        report.verdict().words()
    );
    if rows.is_empty() {
        return text;
    }
    let perceptual = perceptual(report);
    if !perceptual.is_empty() {
        text += &format!("% {}\n", perceptual.trim_end());
    }
    text + &tabular(&rows, true)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::run::store::ViewRecord;

    #[test]
    fn the_markdown_table_has_a_row_per_scale_and_their_mean() {
        crate::run::fixtures::report(|report| {
            let text = markdown(report);
            let rows: Vec<_> = text.lines().filter(|line| line.starts_with('|')).collect();
            assert_eq!(rows.len(), 5);
            assert!(rows.iter().all(|row| row.matches('|').count() == rows[0].matches('|').count()));
            assert!(rows[4].contains("| 24.50 |") && text.contains("Verdict: fair: 24.50 dB"), "{text}");
            assert!(text.contains("8 of 200 test views"), "{text}");
            assert!(text.contains("100.0 samples a ray, 100 rays/s"), "{text}");
        });
    }

    #[test]
    fn the_latex_table_has_as_many_columns_as_it_says() {
        crate::run::fixtures::report(|report| {
            let text = latex(report);
            let columns =
                text.split_once("\\begin{tabular}{l").and_then(|(_, rest)| rest.split_once('}')).unwrap().0;
            assert!(columns.chars().all(|c| c == 'r') && text.ends_with("\\end{tabular}\n"), "{text}");
            let rows: Vec<_> = text.lines().filter(|line| line.ends_with("\\\\")).collect();
            let fits = |row: &&str| row.matches('&').count() == columns.len();
            assert!(rows.len() == 4 && columns.len() >= 3 && rows.iter().all(fits), "{text}");
            assert!(
                rows[0].starts_with("scale & images & PSNR / dB & SSIM") && !text.contains("plain"),
                "{text}"
            );
            assert!(text.contains("\\toprule") && text.contains("% \\usepackage{booktabs}"), "{text}");
        });
    }
    #[test]
    fn psnr_is_compared_with_the_distance_of_the_finest_views() {
        let view = |index: usize, scale: u32, psnr: f64| ViewRecord {
            index,
            name: format!("r_{index}"),
            scale,
            psnr: Some(psnr),
            ssim: None,
            ms_ssim: None,
            flip: None,
            lpips: None,
            nearest_distance: Some(0.5 * index as f64),
            nearest_spacings: Some(2.0 * index as f64),
            comparison: None,
            flip_map: None,
        };
        crate::run::fixtures::report(|report| {
            assert_eq!(distance(report), "", "no view is known");
            let views: Vec<ViewRecord> =
                (1..6).flat_map(|i| [view(i, 1, 30.0 - i as f64), view(i, 2, i as f64)]).collect();
            let report = Report {
                views,
                status: report.status.clone(),
                run: report.run.clone(),
                scene: report.scene.clone(),
                machine: report.machine.clone(),
                ..*report
            };
            let found = report.psnr_by_distance().unwrap();
            assert_eq!((found.views, found.rank_correlation, found.spacings), (5, -1.0, Some((2.0, 10.0))));
            let text = markdown(&report);
            assert!(
                text.contains("is -1.00 over 5 views; these distances are 2.00 to 10.00 times"),
                "{text}"
            );
        });
    }
}
