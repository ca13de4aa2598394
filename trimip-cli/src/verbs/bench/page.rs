//! Output files of a training benchmark: `bench.json`, `bench.csv`, `bench.tex`, `bench.svg`, and `bench.html` for people.

use super::results::{Bench, VariantRow, cells};
use crate::curves::reach_json;
use crate::terminal;
use serde_json::{Value, json};
use trimip::machine::{Machine, version};
use trimip::report::latex::tabular;
use trimip::{Config, Error, Result};
use trimip_core::atomic::write_atomically;
use trimip_report::beside::{self, Entry};
use trimip_report::{page, svg};

/// Writes all files; `lines` are the curves of all runs, grouped by variant.
pub fn write(bench: &Bench, rows: &[VariantRow], lines: &[svg::Line]) -> Result<()> {
    let (base, reach) = (Config::from_settings(&bench.base)?, &bench.reach[..]);
    let machine = Machine::detect();
    let keep = |name: &str, text: &str| write_atomically(&bench.out.join(name), text.as_bytes());
    keep("bench.json", &json(rows, reach, &machine, &base)?)?;
    keep("bench.csv", &csv(rows))?;
    keep("bench.tex", &latex(rows))?;
    // A run with a single evaluation has a point but no line.
    keep("bench.svg", &svg::alone(lines, svg::TRAINING).unwrap_or_default())?;
    keep("bench.html", &html(rows, lines, reach, &machine, &base)?)
}

fn json(rows: &[VariantRow], reach: &[f64], machine: &Machine, base: &Config) -> Result<String> {
    let mut variants = json!(rows);
    for (variant, row) in variants.as_array_mut().into_iter().flatten().zip(rows) {
        let times = reach.iter().zip(&row.reaches).map(|(&psnr, &time)| reach_json(psnr, time));
        variant["reaches"] = Value::Array(times.collect());
    }
    serde_json::to_string_pretty(&json!({
        "machine": machine,
        "version": version(),
        "measures": "PSNR of unrounded colours on the configured background, mean of the scales; seconds of training alone",
        "shared": base.to_toml(),
        "reach": reach,
        "variants": variants,
    }))
    .map_err(Error::run)
}

fn csv(rows: &[VariantRow]) -> String {
    let mut csv =
        "variant,seeds,seconds,psnr_mean,psnr_spread,ssim_mean,samples,model_bytes,pareto\n".to_string();
    for row in rows {
        let name = row.name.replace('"', "\"\"");
        csv += &format!(
            "\"{name}\",{},{:.3},{:.4},{:.4},{:.6},{:.0},{:.0},{}\n",
            row.seeds, row.seconds, row.psnr, row.spread, row.ssim, row.samples, row.model_bytes, row.pareto
        );
    }
    csv
}

/// Returns the LaTeX table for papers; the number after ± is half the difference between the best and the worst seed.
fn latex(rows: &[VariantRow]) -> String {
    let seeds = rows.iter().map(|row| row.seeds).max().unwrap_or(1);
    let head = ["variant", "seconds", "PSNR / dB", "SSIM", "model / MB"];
    let row = |row: &VariantRow| {
        let spread = if seeds > 1 { format!(" ± {:.2}", 0.5 * row.spread) } else { String::new() };
        vec![
            row.name.clone(),
            format!("{:.0}", row.seconds),
            format!("{:.2}{spread}", row.psnr),
            format!("{:.4}", row.ssim),
            format!("{:.1}", 1e-6 * row.model_bytes),
        ]
    };
    let cells: Vec<Vec<String>> =
        std::iter::once(head.map(String::from).to_vec()).chain(rows.iter().map(row)).collect();
    let seeds = terminal::count(seeds as u64, "seed");
    format!(
        "% \\usepackage{{booktabs}}\n% means over {seeds}, ± half of their range\n{}",
        tabular(&cells, false)
    )
}

fn html(
    rows: &[VariantRow],
    lines: &[svg::Line],
    reach: &[f64],
    machine: &Machine,
    base: &Config,
) -> Result<String> {
    // In the pictures, the first seed represents its variant.
    let entries: Vec<Entry> = rows
        .iter()
        .zip(svg::COLORS)
        .map(|(row, color)| Entry {
            name: row.name.clone(),
            color: color.into(),
            folder: row.runs.first().cloned(),
        })
        .collect();
    let settings = rows.iter().map(|row| {
        let sets =
            if row.settings.is_empty() { "the shared settings".into() } else { row.settings.join(", ") };
        format!("<li><b>{}</b>: {}</li>", page::escape(&row.name), page::escape(&sets))
    });
    let content = [
        format!(
            "<header><h1>Bench of {}</h1><p class=\"lead\">{}, {} at most.</p></header>\n",
            terminal::count(rows.len() as u64, "variant"),
            page::escape(&machine.cpu),
            terminal::count(machine.cores as u64, "thread")
        ),
        page::plot("Error against time", lines, "One line for each run, one colour for each variant."),
        format!(
            "<section><h2>Variants</h2>{}<p class=\"lead\">Means over the seeds; the spread is the largest minus the \
             smallest PSNR. A star marks variants that no other beats in both time and error. ≤ marks times before which a \
             run had no measurement.</p><ul>{}</ul></section>\n",
            page::table(&cells(rows, reach), false),
            settings.collect::<String>()
        ),
        beside::outcomes(&entries),
        beside::views(&entries)?,
        beside::differences(&entries),
        format!(
            "<section><details><summary>Shared settings</summary><pre>{}</pre></details></section>\n",
            page::escape(&base.to_toml())
        ),
    ];
    Ok(page::whole("Bench – Tri-MipRF", &content.concat()))
}
