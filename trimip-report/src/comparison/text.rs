//! The tables as text: their columns, for the page and the terminal, `paper.md` and `paper.tex`.

use super::content::Comparison;
use super::means::TableRow;
use super::runs::{Scales, Status};
use trimip::formatting;
use trimip::report::{latex::tabular, scale_name};
use trimip::systems::published::{CONVENTION, PUBLISHED, Published, REMARKS, SOURCES};

/// A value of a row.
pub type Value = Box<dyn Fn(&TableRow) -> f64>;

/// A column of a table: its head, its text for a row, and the value by which rows are compared.
pub struct Column {
    /// Head.
    pub head: String,
    /// Text of a row.
    pub text: Box<dyn Fn(&TableRow) -> String>,
    /// The value to compare, greater is better; `None` in columns without comparison.
    pub value: Option<Value>,
}

fn column(head: impl Into<String>, text: impl Fn(&TableRow) -> String + 'static) -> Column {
    Column { head: head.into(), text: Box::new(text), value: None }
}

/// Returns a column whose greatest value is the best.
fn compared(
    head: impl Into<String>,
    digits: usize,
    value: impl Fn(&TableRow) -> f64 + Clone + 'static,
) -> Column {
    let shown = value.clone();
    Column {
        head: head.into(),
        text: Box::new(move |row| number(shown(row), digits)),
        value: Some(Box::new(value)),
    }
}

fn number(value: f64, digits: usize) -> String {
    if value.is_finite() { format!("{value:.digits$}") } else { "–".into() }
}

fn known(value: f64, text: impl Fn(f64) -> String) -> String {
    if value.is_finite() { text(value) } else { "–".into() }
}

/// Returns the columns of a table of these rows, without the column of system names.
pub fn columns(scales: Scales, rows: &[TableRow]) -> Vec<Column> {
    let mut columns = Vec::new();
    let factors = rows.iter().map(|row| &row.scales).max_by_key(|scales| scales.len());
    for factor in factors.into_iter().flatten().map(|(factor, _)| *factor).filter(|_| scales == Scales::Four)
    {
        let of = move |row: &TableRow| {
            row.scales.iter().find(|(own, _)| *own == factor).map_or(f64::NAN, |(_, psnr)| *psnr)
        };
        columns.push(compared(if factor == 1 { "1/1".into() } else { scale_name(factor) }, 2, of));
    }
    columns.push(compared(if scales == Scales::Four { "mean / dB" } else { "PSNR / dB" }, 2, |row| {
        row.cell.psnr
    }));
    if rows.iter().any(|row| row.runs[1] > row.scenes[1]) {
        columns.push(column("± seeds", |row| number(0.5 * row.cell.spread, 2)));
    }
    columns.push(column("plain", |row| number(row.cell.plain, 2)));
    if rows.iter().any(|row| row.published.is_some()) {
        columns.push(column("published", |row| row.published.map_or("–".into(), |psnr| number(psnr, 2))));
    }
    columns.push(compared("SSIM", 4, |row| row.cell.ssim));
    // Measures that no row has get no column. For FLIP and LPIPS, less is better.
    let mut perceptual = |head: &str, value: fn(&TableRow) -> f64, sign: f64| {
        if rows.iter().any(|row| value(row).is_finite()) {
            columns.push(Column {
                head: head.into(),
                text: Box::new(move |row| number(value(row), 4)),
                value: Some(Box::new(move |row| sign * value(row))),
            });
        }
    };
    perceptual("MS-SSIM", |row| row.cell.ms_ssim, 1.0);
    perceptual("FLIP", |row| row.cell.flip, -1.0);
    perceptual("LPIPS", |row| row.cell.lpips, -1.0);
    columns.push(column("time", |row| known(row.cell.seconds, formatting::duration)));
    columns.push(column("model", |row| known(row.cell.model_bytes, |bytes| formatting::bytes(bytes as u64))));
    columns
        .push(column("parameters", |row| known(row.cell.parameters, |count| formatting::number(count, ""))));
    columns.push(column("peak memory", |row| {
        known(row.cell.memory_bytes, |bytes| formatting::bytes(bytes as u64))
    }));
    if rows.iter().any(|row| row.runs[0] < row.runs[1]) {
        columns.push(column("runs", |row| {
            let failed = if row.failed > 0 { format!(", {} failed", row.failed) } else { String::new() };
            format!("{} of {}{failed}", row.runs[0], row.runs[1])
        }));
    }
    columns
}

/// Returns the column heads of the table of published figures.
pub fn published_columns(scales: Scales) -> Vec<&'static str> {
    match scales {
        Scales::Four => vec![
            "system",
            "1/1",
            "1/2",
            "1/4",
            "1/8",
            "mean / dB",
            "SSIM",
            "lego / dB",
            "time, GPU",
            "model",
            "trained on",
            "background",
            "source",
        ],
        Scales::One => {
            vec!["system", "PSNR / dB", "lego / dB", "model", "trained on", "background", "source"]
        }
    }
}

/// Returns the test views and the sources of a table's published figures.
pub fn published_caption(scales: Scales) -> String {
    let on = match scales {
        Scales::Four => format!("on {CONVENTION}"),
        Scales::One => "at 1/1 alone".into(),
    };
    format!("means of the eight Blender scenes, 200 test views each, {on}. {SOURCES}")
}

/// Returns the published rows that have figures for the table, as text for the columns of [`published_columns`].
pub fn published_cells(scales: Scales) -> Vec<Vec<String>> {
    let db = |value: Option<f64>| value.map_or("–".into(), |value| format!("{value:.2}"));
    let megabytes = |row: &Published| row.megabytes.map_or("–".into(), |mb| format!("{mb} MB"));
    let minutes = |row: &Published| match row.minutes {
        Some(minutes) if minutes >= 1440.0 => format!("{} days", minutes / 1440.0),
        Some(minutes) if minutes >= 120.0 => format!("{} h", minutes / 60.0),
        Some(minutes) => format!("{minutes} min"),
        None => "–".into(),
    };
    let row = |row: &Published| {
        let ends = [row.split, row.background, row.source].map(String::from);
        let mut cells = vec![row.name.to_string()];
        if scales == Scales::Four {
            cells.extend((0..4).map(|i| db(row.scales.map(|scales| scales[i]))));
            cells.push(db(row.average));
            cells.push(row.ssim.map_or("–".into(), |ssim| format!("{ssim:.3}")));
            cells.extend([db(row.lego), minutes(row)]);
        } else {
            cells.extend([db(row.single), db(row.single_lego)]);
        }
        cells.push(megabytes(row));
        cells.extend(ends);
        cells
    };
    let there =
        |row: &&Published| if scales == Scales::Four { row.average.is_some() } else { row.single.is_some() };
    PUBLISHED.iter().filter(there).map(row).collect()
}

/// Returns the text of `paper.md`: every table, the published figures and the remarks on them.
pub fn markdown(comparison: &Comparison) -> String {
    let mut text = "# Systems side by side\n\n".to_string();
    text += &format!(
        "{}: {}. {}. Trained on {}; {}, {}.\n",
        formatting::count(comparison.scenes.len() as u64, "scene"),
        comparison.scenes.join(", "),
        comparison.budget,
        comparison.split.join(" + "),
        comparison.machine.cpu,
        formatting::count(comparison.machine.cores as u64, "core"),
    );
    for &scales in &comparison.scales {
        text += &format!("\n## {}\n", scales.title());
        if comparison.scenes.len() > 1 {
            text += &format!(
                "\nMean over the scenes of each scene's mean:\n\n{}",
                table(scales, &comparison.whole_rows(scales))
            );
        }
        for scene in &comparison.scenes {
            text += &format!("\n{scene}:\n\n{}", table(scales, &comparison.scene_rows(scales, scene)));
        }
        let mut rows = vec![published_columns(scales).into_iter().map(String::from).collect()];
        rows.extend(published_cells(scales));
        text += &format!("\nPublished, {}:\n\n{}", published_caption(scales), lines(&rows));
    }
    text += "\n## Notes on the published figures\n\n";
    for remark in REMARKS {
        text += &format!("- {remark}\n");
    }
    text += "\n## The systems\n\n";
    for system in &comparison.systems {
        text +=
            &format!("- `{}`, {} ({}): {}.\n", system.name, system.title, system.kind.word(), system.differs);
    }
    let failed: Vec<String> = comparison
        .runs
        .iter()
        .filter_map(|run| match &run.status {
            Status::Failed(reason) => {
                Some(format!("- {}, `{}`, seed {}: {}\n", run.scene, run.system, run.seed, safe(reason)))
            }
            _ => None,
        })
        .collect();
    if !failed.is_empty() {
        text += &format!("\n## Runs that failed\n\n{}", failed.concat());
    }
    text
}

/// Returns the text of `paper.tex`: the tables of measurements, for the LaTeX package booktabs.
pub fn latex(comparison: &Comparison) -> String {
    let mut text = "% \\usepackage{booktabs}\n".to_string();
    let mut add = |title: String, scales: Scales, rows: &[TableRow]| {
        text += &format!("\n% {}, {title}\n{}", scales.title(), tabular(&cells(scales, rows), false));
    };
    for &scales in &comparison.scales {
        if comparison.scenes.len() > 1 {
            add("mean over the scenes".into(), scales, &comparison.whole_rows(scales));
        }
        for scene in &comparison.scenes {
            add(scene.clone(), scales, &comparison.scene_rows(scales, scene));
        }
    }
    text
}

fn table(scales: Scales, rows: &[TableRow]) -> String {
    lines(&cells(scales, rows))
}

/// Returns the header and rows of a table, with the system's name in the first column.
fn cells(scales: Scales, rows: &[TableRow]) -> Vec<Vec<String>> {
    let columns = columns(scales, rows);
    let mut cells = vec![vec!["system".to_string()]];
    cells[0].extend(columns.iter().map(|column| column.head.clone()));
    for row in rows {
        let mut line = vec![row.title.to_string()];
        line.extend(columns.iter().map(|column| (column.text)(row)));
        cells.push(line);
    }
    cells
}

/// Returns rows as a Markdown table; the first row is the header.
fn lines(rows: &[Vec<String>]) -> String {
    let mut text = String::new();
    for (i, row) in rows.iter().enumerate() {
        let cells: Vec<String> = row.iter().map(|cell| safe(cell)).collect();
        text += &format!("| {} |\n", cells.join(" | "));
        if i == 0 {
            text += &format!("|---|{}\n", "---:|".repeat(row.len() - 1));
        }
    }
    text
}

fn safe(text: &str) -> String {
    text.replace('|', "\\|").replace('<', "&lt;")
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::run;
    use super::*;
    use trimip::{machine::Machine, systems::find};

    #[test]
    fn the_text_has_every_system_scene_and_failure() {
        let mut runs = Vec::new();
        for scene in ["lego", "ship"] {
            runs.push(run("ngp", scene, 42, [20.0, 30.0]));
            runs.push(run("tri-mip", scene, 42, [30.0, 34.0]));
        }
        runs[3].status = Status::Failed("out of | luck".into());
        let comparison = Comparison {
            systems: ["ngp", "tri-mip"].map(|name| find(name).unwrap()).to_vec(),
            scenes: vec!["lego".into(), "ship".into()],
            missing: Vec::new(),
            scales: vec![Scales::Four],
            split: vec!["train".into()],
            budget: "10 s each".into(),
            runs,
            machine: Machine::detect(),
            command: None,
        };
        let text = markdown(&comparison);
        let tables: Vec<&str> = text.split("\n\n").filter(|part| part.starts_with("| ")).collect();
        assert_eq!(tables.len(), 4, "{text}");
        for table in &tables {
            let bars = |line: &str| line.replace("\\|", "").matches('|').count();
            assert!(table.lines().all(|line| bars(line) == bars(table.lines().next().unwrap())), "{table}");
        }
        assert!(tables[0].contains("| Instant-ngp | 20.00 | 30.00 | 25.00 |"), "{}", tables[0]);
        assert!(tables[1].contains("31.83") && !tables[2].contains("31.83"));
        assert!(tables[3].contains("| Tri-MipRF | 33.32 |") && tables[3].contains("3 days"));
        assert!(text.contains("out of \\| luck") && text.contains("LPIPS"));
        let json: serde_json::Value =
            serde_json::from_str(&super::super::json(&comparison).unwrap()).unwrap();
        assert_eq!(json["tables"][0]["mean"][1]["psnr"], 32.0);
        assert_eq!(json["tables"][0]["mean"][1]["memory_bytes"], serde_json::Value::Null);
        assert_eq!(
            (&json["runs"][3]["status"], &json["runs"][3]["reason"]),
            (&"failed".into(), &"out of | luck".into())
        );
    }
}
