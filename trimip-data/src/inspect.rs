//! The longer report of `data inspect`: everything that the program finds out about a scene without training.

use crate::{
    describe, lens,
    scene::{Scene, opened, surveyed},
    settings::DataConfig,
    watch::Watch,
};
use trimip_core::{Alpha, Result, plural::count};

/// Everything that the program finds out about a scene without training.
#[derive(Debug)]
pub struct Inspection {
    /// The scene, with its warnings.
    pub scene: Scene,
    /// Name of its layout.
    pub layout: &'static str,
    /// Lines that describe the scene, without warnings.
    pub lines: Vec<String>,
}

/// Returns everything that the program finds out about a scene without training: lines, then warnings. Progress of reading goes to `watch`.
///
/// # Errors
/// As [`open`](crate::open).
pub fn inspect(config: &DataConfig, watch: Watch<'_>) -> Result<Vec<String>> {
    let Inspection { scene, mut lines, .. } = examine(config, watch)?;
    lines.extend(scene.warnings.iter().map(|warning| format!("warning: {warning}")));
    Ok(lines)
}

/// Examines a scene as [`inspect`] does, and returns the scene too.
///
/// # Errors
/// As [`open`](crate::open).
pub fn examine(config: &DataConfig, watch: Watch<'_>) -> Result<Inspection> {
    let (survey, train) = surveyed(config, watch)?;
    let mut lines = describe::description(&survey, config, &train);
    for (name, sources) in [("train", &survey.train), ("test", &survey.test)] {
        let cameras = || sources.iter().filter_map(|source| source.views.first().map(|(_, camera)| camera));
        let fx = range(cameras().map(|camera| camera.intrinsics.fx));
        let fy = range(cameras().map(|camera| camera.intrinsics.fy));
        lines.push(format!("{name}: images {}, {}", describe::sizes(sources), describe::alpha(sources)));
        lines.push(format!("{name}: focal length {fx} x {fy} pixels"));
        let mut lenses: Vec<String> =
            cameras().filter_map(|camera| lens::described(&camera.intrinsics.lens)).collect();
        lenses.sort();
        lenses.dedup();
        match &lenses[..] {
            [] => {}
            [one] => lines.push(format!("{name}: lens {one}")),
            all => lines.push(format!("{name}: {}, the first {}", count(all.len(), "lens model"), all[0])),
        }
        let places = || cameras().map(|camera| survey.origin.stated(camera.origin));
        lines.push(format!(
            "{name}: cameras {} from the origin, x {}, y {}, z {}",
            range(places().map(glam::DVec3::length)),
            range(places().map(|place| place.x)),
            range(places().map(|place| place.y)),
            range(places().map(|place| place.z)),
        ));
    }
    if let Some(scale) = train.scales.first() {
        let pixels = &train.pixels[scale.pixels.clone()];
        let fraction = |test: &dyn Fn(u8) -> bool| {
            100.0 * pixels.iter().filter(|pixel| test(pixel[3])).count() as f64 / pixels.len().max(1) as f64
        };
        let [whole, part, none] = match train.alpha {
            Alpha::Straight | Alpha::Premultiplied => ["opaque", "partly covered", "clear"],
            Alpha::Kept => ["kept", "partly kept", "masked"],
        };
        lines.push(format!(
            "train: {:.1} % of the pixels are {whole}, {:.1} % {part}, {:.1} % {none}",
            fraction(&|alpha| alpha == 255),
            fraction(&|alpha| alpha != 0 && alpha != 255),
            fraction(&|alpha| alpha == 0),
        ));
    }
    for scale in &train.scales {
        lines.push(format!(
            "train: scale 1/{}: {}, {:.2} million pixels of weight {}",
            scale.factor,
            count(scale.views.len(), "view"),
            scale.pixels.len() as f64 / 1e6,
            scale.weight
        ));
    }
    Ok(Inspection { layout: survey.layout, lines, scene: opened(survey, config, train) })
}

/// Formats the range of values as "4.03" or "3.90 to 4.10".
fn range(values: impl Iterator<Item = f64>) -> String {
    let (low, high) = values
        .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)));
    if high - low <= 5e-4 * high.abs() { format!("{low:.2}") } else { format!("{low:.2} to {high:.2}") }
}
