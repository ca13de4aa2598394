//! The page of an inspected capture, one self-contained file: a summary, cameras and box from three sides, thumbnails, warnings and checks.

mod checks;
mod frames;
mod space;
mod unplaced;

pub use unplaced::UnplacedPicture;

use super::page::{self, escape, pairs};
use std::collections::HashMap;
use trimip::data::checks::Verdict;
use trimip::formatting;
use trimip::inspect::Inspection;
use trimip::{Alpha, Result};

/// Returns the whole page.
///
/// # Errors
/// When a test photograph cannot be read.
pub fn page(seen: &Inspection) -> Result<String> {
    page_with(seen, &[])
}

/// Returns the whole page, including the pictures that have no camera.
///
/// # Errors
/// When a test photograph cannot be read.
pub fn page_with(seen: &Inspection, unplaced: &[UnplacedPicture]) -> Result<String> {
    let doubts = doubts(seen);
    let content = [
        head(seen),
        space::section(seen, &doubts),
        frames::section(seen, &doubts)?,
        unplaced::section(unplaced)?,
        left_out(seen),
        checks::sections(seen),
    ];
    Ok(page::whole(&format!("{} – Tri-MipRF capture", seen.seen.scene.name), &content.concat()))
}

/// Returns the suspicious figures of training views, by index of the view.
fn doubts(seen: &Inspection) -> HashMap<usize, Vec<String>> {
    let mut doubts: HashMap<usize, Vec<String>> = HashMap::new();
    for check in &seen.checks {
        for suspect in &check.suspects {
            doubts.entry(suspect.view).or_default().push(format!("{}: {}", check.name, suspect.figure));
        }
    }
    doubts
}

fn head(seen: &Inspection) -> String {
    let scene = &seen.seen.scene;
    let finest = scene.train.scales.first().map_or(0..0, |scale| scale.views.clone());
    let size = scene.train.views.get(finest.start).map(|view| view.camera.intrinsics);
    let suspicious =
        seen.checks.iter().filter(|check| matches!(check.verdict, Verdict::Suspicious(_))).count();
    let (class, verdict) = match suspicious {
        0 => ("good", "nothing suspicious".to_string()),
        some => ("doubtful", formatting::count(some as u64, "suspicious check")),
    };
    let alpha = match scene.train.alpha {
        Alpha::Straight => "opacity, with straight colours",
        Alpha::Premultiplied => "opacity, with premultiplied colours",
        Alpha::Kept => "the share of a pixel that masks keep: the rest is neither trained nor measured",
    };
    let tiles = [
        (finest.len().to_string(), "training views"),
        (seen.seen.scene.test_views.len().to_string(), "test views"),
        (size.map_or("none".into(), |k| format!("{}×{}", k.width, k.height)), "pixels of the first view"),
        (scene.train.scales.len().to_string(), "scales"),
        (formatting::bytes(scene.train.bytes() as u64), "training pixels in memory"),
        (scene.points.len().to_string(), "points"),
    ];
    let tiles: String =
        tiles.iter().map(|(value, name)| format!("<div><b>{value}</b><span>{name}</span></div>")).collect();
    let lines: String = seen.seen.lines.iter().map(|line| format!("<li>{}</li>", escape(line))).collect();
    let rows = [
        ("poses", "camera to world; x right, y up, the camera looks along −z (OpenGL)".to_string()),
        ("pixels", "the upper left one is (0, 0); its centre lies at (0.5, 0.5)".into()),
        ("units", "lengths as in the poses, focal lengths in pixels, angles in radians".into()),
        ("alpha", alpha.into()),
        ("space", seen.plan.as_ref().map_or("as configured".into(), ToString::to_string)),
    ];
    format!(
        "<header><h1>{}</h1>\n<p class=\"lead\">{} <b class=\"badge {class}\">{verdict}</b></p>\n\
         <div class=\"tiles\">{tiles}</div>\n<ul class=\"warnings\">{lines}</ul>\n{}</header>\n",
        escape(&scene.name),
        escape(seen.seen.layout),
        pairs(&rows)
    )
}

/// Returns the warnings of the readers, such as left-out photographs with the reason, and the warnings of the plan.
fn left_out(seen: &Inspection) -> String {
    let warnings = seen.seen.scene.warnings.iter().chain(&seen.warnings);
    let items: String = warnings.map(|warning| format!("<li>{}</li>", escape(warning))).collect();
    let content = match items.is_empty() {
        true => "<p>Every frame, photograph and pixel is used, and there are no warnings.</p>".to_string(),
        false => format!("<ul class=\"warnings\">{items}</ul>"),
    };
    format!("<section><h2>Warnings and data left out</h2>{content}</section>\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use trimip::data::{Point, unwatched};
    use trimip::inspect::inspect;

    /// Returns the built-in scene at a small size.
    fn seen() -> Inspection {
        let settings = trimip::settings::defaults().with("data.format", "builtin");
        let sets = [("size", 48), ("train", 12), ("test", 3), ("supersampling", 1)];
        let small = sets.iter().fold(settings, |settings, (key, value)| {
            settings.and_then(|settings| settings.with(&format!("data.builtin_{key}"), *value))
        });
        inspect(small.unwrap(), &unwatched).unwrap()
    }

    /// Returns the page without the base64 data of its pictures, which could match any text.
    fn told(page: &str) -> String {
        let parts = page.split("base64,").enumerate();
        let kept = parts.map(|(i, part)| if i == 0 { part } else { &part[part.find('"').unwrap()..] });
        kept.collect()
    }

    #[test]
    fn the_page_shows_what_was_understood_and_fetches_nothing() {
        let mut seen = seen();
        seen.seen.scene.train.views[1].name = "a<b>&c".into();
        seen.seen.scene.warnings.push("a <strange> file".into());
        let grey =
            Point { position: [0.1; 3], color: [1, 2, 255], error: None, seen: None, track: Vec::new() };
        seen.seen.scene.points = vec![grey; 7000];
        let whole = page(&seen).unwrap();
        page::expect_whole(&whole);
        let told = told(&whole);
        for none in ["NaN", "inf,", "<b>&c", "<strange>", "http"] {
            assert!(!told.contains(none), "{none}");
        }
        assert!(told.contains("a&lt;b&gt;&amp;c") && told.contains("a &lt;strange&gt; file"));
        assert!(told.contains("<b>12</b><span>training views</span>"));
        assert!(told.contains("<b>3</b><span>test views</span>"));
        // Every camera and the box appear in three drawings; all frames have thumbnails.
        assert_eq!(told.matches("<path class=\"train\"").count() + told.matches("\"doubt\"").count(), 36);
        assert_eq!(told.matches("<path class=\"test\"").count(), 9);
        assert_eq!(told.matches("<rect class=\"space\"").count(), 3);
        assert_eq!(told.matches("fill=\"#0102ff\"").count(), 3 * 2334, "every third point");
        assert_eq!(told.matches("<img").count(), 15);
        assert_eq!(told.matches("along z, from above</figcaption>").count(), 1);
        assert!(seen.lines().contains(&"warning: a <strange> file".to_string()));
    }

    #[test]
    fn what_is_suspicious_is_told_with_what_to_do() {
        let mut seen = seen();
        let check = &mut seen.checks[0];
        check.verdict = Verdict::Suspicious("turn <it>");
        check.suspects = vec![trimip::data::checks::Suspect { view: 2, figure: "0.12".into() }];
        let told = told(&page(&seen).unwrap());
        assert!(told.contains("turn &lt;it&gt;") && told.contains("r_2 (0.12)"));
        assert_eq!(told.matches("<path class=\"doubt\"").count(), 3);
        assert!(seen.lines().last().is_some_and(|line| line.contains("r_2 (0.12); turn <it>")));
    }
}
