//! `paper.html`: a comparison of systems on one self-contained page. It has curves, points of quality against size and
//! time, tables, crops of the same parts, and the published figures in panels and tables of their own.

mod crops;
mod figure;
mod look;
mod scatter;
mod tables;

use super::page::{self, escape, pairs};
use crate::comparison::{Comparison, Figures, Status};
use look::headline;
use trimip::formatting;
use trimip::systems::published::REMARKS;
use trimip::{Result, config::Convention, machine};

/// Returns the whole page.
///
/// # Errors
/// When a picture cannot be encoded.
pub fn page(comparison: &Comparison) -> Result<String> {
    let mut content = vec![head(comparison), state(comparison)];
    let all = &comparison.scales;
    // The switch of the time axis works for one plot per page, so only the first table gets curves.
    content.extend(all.first().map(|&scales| figure::curves(comparison, scales)));
    content.extend(all.iter().map(|&scales| figure::points(comparison, scales)));
    content.extend(all.iter().map(|&scales| tables::measured(comparison, scales)));
    for &scales in all {
        content.push(crops::section(comparison, scales)?);
    }
    content.extend(all.iter().map(|&scales| tables::published(scales)));
    content.extend([remarks(), measure(comparison), systems(comparison)]);
    Ok(page::whole("Systems side by side – Tri-MipRF", &content.concat()))
}

fn head(comparison: &Comparison) -> String {
    let scenes = match &comparison.scenes[..] {
        [scene] => scene.clone(),
        scenes => formatting::count(scenes.len() as u64, "scene"),
    };
    let figures = || comparison.runs.iter().filter_map(|run| run.figures.as_ref());
    let done = figures().count();
    let mut tiles = vec![
        (format!("{done} of {}", comparison.runs.len()), "runs measured".to_string()),
        (formatting::duration(figures().map(|figures| figures.seconds).sum()), "training in total".into()),
    ];
    let best = comparison.scales.first().and_then(|&scales| {
        let rows = headline(comparison, scales).into_iter();
        // Means over only some of the scenes are not compared.
        let whole = rows.filter(|row| row.scenes[0] == row.scenes[1] && row.cell.psnr.is_finite());
        whole.max_by(|a, b| a.cell.psnr.total_cmp(&b.cell.psnr))
    });
    if let Some(row) = best {
        tiles.insert(0, (format!("{:.2} dB", row.cell.psnr), format!("best mean: {}", row.title)));
    }
    let tiles: String = tiles
        .iter()
        .map(|(value, name)| format!("<div><b>{}</b><span>{}</span></div>", escape(value), escape(name)))
        .collect();
    let mut rows = vec![
        ("scenes", comparison.scenes.join(", ")),
        ("trained on", comparison.split.join(" + ")),
        ("budget", comparison.budget.clone()),
        (
            "machine",
            format!(
                "{}, {}",
                comparison.machine.cpu,
                formatting::count(comparison.machine.cores as u64, "core")
            ),
        ),
    ];
    if !comparison.missing.is_empty() {
        rows.insert(1, ("missing scenes", comparison.missing.join(", ")));
    }
    rows.extend(comparison.command.iter().map(|command| ("command", command.clone())));
    rows.push(("version", format!("trimip-cli {}", machine::version())));
    format!(
        "<header><h1>{} <span class=\"scene\">on {}</span></h1>\n<p class=\"lead\">The systems of the paper’s tables, trained by \
         one program on the same photographs and the same machine.</p>\n<div class=\"tiles\">{tiles}</div>\n\
         <div class=\"origin\">{}</div></header>\n",
        formatting::count(comparison.systems.len() as u64, "system"),
        escape(&scenes),
        pairs(&rows)
    )
}

/// Lists the failed runs, and the number of pending ones.
fn state(comparison: &Comparison) -> String {
    let mut items = String::new();
    for (run, reason) in comparison.failed() {
        items += &format!(
            "<li><b class=\"badge bad\">failed</b> {}, {}, seed {}: {}</li>",
            escape(&run.scene),
            escape(run.system),
            run.seed,
            escape(reason)
        );
    }
    let open = comparison.open();
    if open > 0 {
        let stopped = comparison.runs.iter().filter(|run| run.status == Status::Stopped).count();
        let stopped = if stopped > 0 { format!(", {stopped} of them started") } else { String::new() };
        items += &format!(
            "<li><b class=\"badge doubtful\">open</b> {} to go{stopped}; the same command continues.</li>",
            formatting::count(open as u64, "run")
        );
    }
    if items.is_empty() {
        return items;
    }
    format!("<section><h2>State</h2><ul class=\"warnings\">{items}</ul></section>\n")
}

fn remarks() -> String {
    let items: String = REMARKS.iter().map(|remark| format!("<li>{}</li>", escape(remark))).collect();
    format!("<section><h2>Notes on the published figures</h2><ul class=\"remarks\">{items}</ul></section>\n")
}

/// States the views, background and convention of the measurements made here.
fn measure(comparison: &Comparison) -> String {
    let figures: Vec<&Figures> = comparison.runs.iter().filter_map(|run| run.figures.as_ref()).collect();
    let each = |text: &dyn Fn(&Figures) -> String| {
        let mut texts: Vec<String> = figures.iter().map(|figures| text(figures)).collect();
        texts.sort();
        texts.dedup();
        if texts.is_empty() { "nothing yet".into() } else { texts.join("; ") }
    };
    let rows = [
        (
            "test views",
            each(&|f| match f.test_views {
                Some(all) => format!("{} of {all}", f.views),
                None => f.views.to_string(),
            }),
        ),
        (
            "background",
            each(&|f| {
                let [r, g, b] = f.background;
                format!("({r:.2}, {g:.2}, {b:.2})")
            }),
        ),
        (
            "coarse photographs",
            each(&|f| match f.convention {
                Convention::Public => {
                    "means of straight RGBA truncated to 8 bits, as the public multi-scale set".into()
                }
                Convention::Premultiplied => "means of premultiplied RGBA rounded to 8 bits".into(),
            }),
        ),
        ("trained on", comparison.split.join(" + ")),
    ];
    format!(
        "<section><h2>How it was measured here</h2>{}<p>PSNR is −10·log<sub>10</sub> of the mean squared error of one image, \
         unrounded, in the photographs’ own sRGB values. A scale’s figure is the mean over its images, and “mean” is the mean over \
         the scales; seeds are averaged within a scene, then scenes. “plain” leaves out the edge exponents of the set, which the scene \
         plan fits to the training photographs, for <i>tri-mip</i> alone: published figures are plain. The size is that of the model \
         file with its occupancy grid; the peak memory is that of the process since the start of the run, with the decoded photographs. \
         Curves are measured on about four test views.</p></section>\n",
        pairs(&rows)
    )
}

/// Describes the systems: what each is, how it differs from the published one, and its settings.
fn systems(comparison: &Comparison) -> String {
    let mut html = String::new();
    for system in &comparison.systems {
        html += &format!(
            "<details><summary>{} <code>{}</code> <span class=\"tag\">{}</span></summary><p>Differences from the published \
             system: {}.</p><pre>{}</pre></details>",
            escape(system.title),
            system.name,
            system.kind.word(),
            escape(system.differs),
            escape(system.settings)
        );
    }
    format!(
        "<section><h2>The systems</h2><p class=\"lead\">Each is a layer of settings over the defaults: the published system \
         (whole), without a part (ablation), with fewer parameters (smaller), or with changes of this program (changed).</p>\
         {html}</section>\n"
    )
}
