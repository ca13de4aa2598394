//! Runs side by side on one page: their outcomes, the settings that differ, and the photographs and renderings of the
//! test views of which all runs have pictures. A curve without a run folder contributes only its name.

use super::{page::escape, page::table, pictures};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::PathBuf;
use trimip::formatting;
use trimip::run::store::{FileStore, ViewRecord};
use trimip::{Result, RunFolder};

/// Maximum number of views shown.
const VIEWS: usize = 4;

/// A run, or a curve without a run.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Display name.
    pub name: String,
    /// Colour of the entry's line in the plot.
    pub color: String,
    /// Folder with the report and the pictures.
    pub folder: Option<PathBuf>,
}

impl Entry {
    /// Reads the `report.json` of the folder; null if that fails.
    fn report(&self) -> Value {
        let text = self
            .folder
            .as_ref()
            .and_then(|folder| trimip_core::plain_file::read(&folder.join("report.json")).ok());
        text.and_then(|text| serde_json::from_slice(&text).ok()).unwrap_or_default()
    }
}

/// Returns a table of verdicts and figures of the entries that have a report; empty if no entry has one.
pub fn outcomes(entries: &[Entry]) -> String {
    let head = [
        "run",
        "verdict",
        "scene",
        "views",
        "PSNR / dB",
        "SSIM",
        "MS-SSIM",
        "FLIP",
        "LPIPS",
        "samples",
        "model",
    ];
    let mut rows = vec![head.map(String::from).to_vec()];
    for entry in entries {
        let report = entry.report();
        if report.is_null() {
            continue;
        }
        let text = |value: &Value| value.as_str().unwrap_or("–").to_string();
        let number = |value: &Value, digits: usize| {
            value.as_f64().map_or("–".into(), |value| format!("{value:.digits$}"))
        };
        let views = match (&report["measure"]["views"], &report["measure"]["test_views"]) {
            (Value::Number(views), Value::Number(all)) => format!("{views} of {all}"),
            _ => "–".into(),
        };
        rows.push(vec![
            entry.name.clone(),
            text(&report["verdict"]),
            text(&report["scene"]),
            views,
            number(&report["mean"]["psnr"], 2),
            number(&report["mean"]["ssim"], 4),
            number(&report["mean"]["ms_ssim"], 4),
            number(&report["mean"]["flip"], 4),
            number(&report["mean"]["lpips"], 4),
            report["samples"].as_f64().map_or("–".into(), |samples| formatting::number(samples, "")),
            report["model_bytes"].as_u64().map_or("–".into(), formatting::bytes),
        ]);
    }
    if rows.len() < 2 {
        return String::new();
    }
    format!("<section><h2>Results</h2>{}</section>\n", table(&rows, false))
}

/// Returns a table of the settings that differ between entries with a report; empty if fewer than two have one.
pub fn differences(entries: &[Entry]) -> String {
    let known: Vec<_> = entries
        .iter()
        .filter_map(|entry| entry.report()["settings"].as_object().cloned().map(|settings| (entry, settings)))
        .collect();
    if known.len() < 2 {
        return String::new();
    }
    let value = |settings: &serde_json::Map<String, Value>, key: &String| match &settings.get(key) {
        Some(setting) => match &setting["value"] {
            Value::String(text) => text.clone(),
            value => value.to_string(),
        },
        None => "–".into(),
    };
    let keys: BTreeSet<&String> = known.iter().flat_map(|(_, settings)| settings.keys()).collect();
    let mut rows = vec![vec!["setting".to_string()]];
    rows[0].extend(known.iter().map(|(entry, _)| entry.name.clone()));
    for key in keys {
        let values: Vec<String> = known.iter().map(|(_, settings)| value(settings, key)).collect();
        if values.iter().any(|value| *value != values[0]) {
            rows.push([vec![key.clone()], values].concat());
        }
    }
    let content = match rows.len() {
        1 => "<p>All settings are equal.</p>".into(),
        _ => table(&rows, false),
    };
    format!("<section><h2>Settings that differ</h2>{content}</section>\n")
}

/// Returns the test views of the finest scale that all entries with pictures share: the photograph, then each entry's
/// rendering with its PSNR.
pub fn views(entries: &[Entry]) -> Result<String> {
    let pictured: Vec<(&Entry, PathBuf, Vec<ViewRecord>)> = entries
        .iter()
        .filter_map(|entry| {
            let folder = RunFolder::new(entry.folder.as_ref()?);
            let views = finest(FileStore::read(&folder));
            (!views.is_empty()).then(|| (entry, folder.images(), views))
        })
        .collect();
    let Some((_, images, first)) = pictured.first() else { return Ok(String::new()) };
    let same = |a: &ViewRecord, b: &ViewRecord| (&a.name, a.index, a.scale) == (&b.name, b.index, b.scale);
    let common = first
        .iter()
        .filter(|view| pictured.iter().all(|(_, _, views)| views.iter().any(|other| same(view, other))));
    let mut groups = String::new();
    for view in common.take(VIEWS) {
        let Some([_, photograph]) = pictures::compared(images, view) else { continue };
        let mut shots = shot(photograph, "photograph", "")?;
        for (entry, images, views) in &pictured {
            let Some(own) = views.iter().find(|other| same(view, other)) else { continue };
            let Some([rendered, _]) = pictures::compared(images, own) else { continue };
            let psnr = own.psnr.map_or("no number".into(), |psnr| format!("{psnr:.2} dB"));
            shots += &shot(rendered, &format!("{}: {psnr}", entry.name), &entry.color)?;
        }
        groups += &format!("<h3>{}</h3><div class=\"group\">{shots}</div>", escape(&view.name));
    }
    if groups.is_empty() {
        return Ok(
            "<section><h2>Test views</h2><p>No test view has pictures in all of these runs.</p></section>\n"
                .into(),
        );
    }
    Ok(format!(
        "<section><h2>Test views</h2><p class=\"lead\">Click a picture to enlarge it; the arrow keys then \
         switch pictures in place.</p><div class=\"wide\">{groups}</div></section>\n"
    ))
}

/// Returns the views with pictures at the finest scale.
fn finest(views: Vec<ViewRecord>) -> Vec<ViewRecord> {
    let scale = views.iter().map(|view| view.scale).min();
    let wanted = |view: &ViewRecord| Some(view.scale) == scale && view.comparison.is_some();
    views.into_iter().filter(wanted).collect()
}

fn shot(picture: image::RgbImage, caption: &str, color: &str) -> Result<String> {
    let mark = if color.is_empty() { String::new() } else { format!("<i style=\"color:{color}\"></i>") };
    let image = pictures::embedded(picture, "view")?;
    Ok(format!("<figure class=\"shot\">{image}<figcaption>{mark}{}</figcaption></figure>", escape(caption)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;
    use std::path::Path;
    use trimip::view::pictures::{side_by_side, write_png};

    /// Returns a run folder with pictures of the frames `pictured`, at two scales.
    fn run(root: &Path, name: &str, pictured: &[usize], hidden: u32) -> Entry {
        let folder = RunFolder::new(&root.join(name));
        folder.prepare_images().unwrap();
        let mut views = Vec::new();
        for (index, scale) in pictured.iter().flat_map(|&index| [(index, 1), (index, 2)]) {
            let file = format!("{index}_{scale}.png");
            write_png(&folder.images().join(&file), side_by_side(1, 1, &[[0.0; 3]], &[[1.0; 3]])).unwrap();
            let view = json!({
                "index": index, "name": format!("r_{index}"), "scale": scale, "psnr": 20.0, "ssim": null, "comparison": file,
            });
            views.push(view);
        }
        std::fs::write(folder.views(), serde_json::to_string(&views).unwrap()).unwrap();
        let settings = json!({ "field.hidden": { "value": hidden }, "seed": { "value": 0 } });
        let report = json!({
            "verdict": "fair", "settings": settings, "mean": { "psnr": 24.0 },
            "measure": { "views": 2, "test_views": 8 },
        });
        std::fs::write(folder.json(), report.to_string()).unwrap();
        Entry { name: name.into(), color: "red".into(), folder: Some(root.join(name)) }
    }

    #[test]
    fn views_that_all_runs_pictured_stand_beside_their_photograph() {
        let root = tempfile::tempdir().unwrap();
        let curve = Entry { name: "peer".into(), color: String::new(), folder: None };
        let entries = [run(root.path(), "a", &[1, 2], 16), curve, run(root.path(), "b", &[2, 3], 16)];
        let html = views(&entries).unwrap();
        assert!(html.contains("<h3>r_2</h3>") && !html.contains("r_1") && html.contains("b: 20.00 dB"));
        assert_eq!(html.matches("<img").count(), 3);
        let apart = views(&[entries[0].clone(), run(root.path(), "c", &[4], 16)]).unwrap();
        assert!(apart.contains("No test view"));
        assert_eq!(views(&entries[1..2]).unwrap(), "");
    }

    #[test]
    fn settings_that_differ_are_named_alone() {
        let root = tempfile::tempdir().unwrap();
        let entries = [run(root.path(), "a", &[], 16), run(root.path(), "b", &[], 32)];
        let html = differences(&entries);
        assert!(html.contains("field.hidden") && html.contains("32") && !html.contains("seed"));
        assert!(differences(&entries[..1]).is_empty());
        assert!(outcomes(&entries).contains("2 of 8") && outcomes(&[]).is_empty());
    }
}
