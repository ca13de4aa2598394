//! Warnings about the planned box before training.

use super::common_view::{MOST_CAMERAS, cameras, focus};
use super::facts::Facts;
use crate::config::Contraction;
use crate::{Aabb, Config, ViewSet};

/// Number of pixels sampled along each side of a photograph to measure how much of it the box covers.
const PROBES: u32 = 24;

/// Coverage of the photographs below which a warning is given.
const ENOUGH: f64 = 0.5;

/// Returns the share of the pixels with alpha above one half (of the object, or kept by masks) whose rays hit the box; `None`
/// if there is no such pixel.
pub(super) fn coverage(config: &Config, views: &ViewSet) -> Option<f64> {
    let aabb = Aabb::<f64>::new(&config.scene);
    let finest = views.scales.first()?;
    let stride = finest.views.len().div_ceil(MOST_CAMERAS).max(1);
    let (mut shown, mut met) = (0_u64, 0_u64);
    for view in finest.views.clone().step_by(stride) {
        let (camera, pixels) = (&views.views[view].camera, views.pixels_of(view));
        let (width, height) = (camera.intrinsics.width, camera.intrinsics.height);
        for i in 0..PROBES * PROBES {
            let at =
                |place: u32, side: u32| (2 * u64::from(place) + 1) * u64::from(side) / u64::from(2 * PROBES);
            let (x, y) = (at(i % PROBES, width) as u32, at(i / PROBES, height) as u32);
            if pixels[(y * width + x) as usize][3] < 128 {
                continue;
            }
            let cone = camera.cone::<f64>(x, y);
            let (enter, leave) = aabb.intersect(cone.origin, cone.direction);
            shown += 1;
            met += u64::from(enter < leave);
        }
    }
    (shown > 0).then(|| met as f64 / shown as f64)
}

/// Returns the warnings about the planned box, one line each.
pub fn warnings(config: &Config, facts: &Facts<'_>) -> Vec<String> {
    let mut warnings = Vec::new();
    let alone = focus(&cameras(facts.train)).is_none() && facts.stated.is_none();
    if alone && config.scene == Config::default().scene {
        warnings.push(
            "the cameras look in parallel, at no common place: the box stays at ±1.5 units around the origin; set \
             scene.aabb_min and scene.aabb_max to where the subject is"
                .into(),
        );
    }
    match coverage(config, facts.train) {
        Some(_) if config.scene.contraction != Contraction::None => {}
        Some(fraction) if fraction < ENOUGH => warnings.push(format!(
            "the box covers only {:.0} % of what the photographs show: the rest is treated as background; set \
             scene.aabb_min and scene.aabb_max around what you want, or mask the rest (alpha)",
            100.0 * fraction
        )),
        Some(_) => {}
        None => warnings.push(
            "the photographs show nothing at all: every sampled pixel is transparent or masked; see trimip-cli data inspect".into(),
        ),
    }
    warnings
}
