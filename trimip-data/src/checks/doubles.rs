//! Checks for duplicates: different photographs with one pose, and one photograph with different poses. If a photograph
//! is in both the training and the test set, test results are too good.

use super::{
    check::{Check, Suspect, Verdict},
    views::{cameras, coarsest, name},
};
use std::collections::HashMap;
use trimip_core::{Camera, ViewSet};

/// Two cameras have the same pose if their distance is at most this share of the extent of all cameras, and the components
/// of their axes differ by at most this. Files state poses to six digits or more, and the poses of two hand-held
/// photographs differ by more than this.
const SAME: f64 = 1e-6;

/// Least side of the compared images, pixels (see [`coarsest`]): two different photographs are never equal at this size.
const SIDE: u32 = 32;

/// Returns true for two cameras at one place with the same axes.
fn same(a: &Camera, b: &Camera, extent: f64) -> bool {
    let turned = a.rotation - b.rotation;
    let axes = [turned.x_axis, turned.y_axis, turned.z_axis];
    (a.origin - b.origin).length() <= SAME * extent
        && axes.iter().all(|axis| axis.abs().max_element() <= SAME)
}

/// Returns the diagonal of the bounding box of the cameras.
fn extent(cameras: &[Camera]) -> f64 {
    let places = || cameras.iter().map(|camera| camera.origin);
    match (places().reduce(glam::DVec3::min), places().reduce(glam::DVec3::max)) {
        (Some(low), Some(high)) => (high - low).length(),
        _ => 0.0,
    }
}

/// Checks that no two frames have the same pose. `test` has the name and camera of each test frame.
pub fn poses(train: &ViewSet, test: &[(String, Camera)]) -> Check {
    let limit = "two frames at one place with the same axes: no hand holds a camera that still".to_string();
    let cameras = cameras(train);
    let extent = extent(&cameras);
    let named = |view: usize| name(train, view).unwrap_or("?");
    let same_as = |view: usize| (0..view).find(|&other| same(&cameras[view], &cameras[other], extent));
    let suspects: Vec<Suspect> = (0..cameras.len())
        .filter_map(|view| Some(Suspect { view, figure: format!("same as {}", named(same_as(view)?)) }))
        .collect();
    let leaked: Vec<&str> = test
        .iter()
        .filter(|(_, camera)| cameras.iter().any(|other| same(camera, other, extent)))
        .map(|(name, _)| name.as_str())
        .collect();
    // If all test frames are training frames, the user intends it.
    let leaked = if leaked.len() == test.len() { Vec::new() } else { leaked };
    let mut figure = match suspects.len() {
        0 => format!("{} training cameras have different poses", cameras.len()),
        some => format!("{some} of {} training cameras have the pose of another", cameras.len()),
    };
    if let [first, ..] = leaked[..] {
        figure +=
            &format!("; {} test frames, the first {first}, have the pose of a training frame", leaked.len());
    }
    let verdict = match suspects.is_empty() && leaked.is_empty() {
        true => Verdict::Fine,
        false => Verdict::Suspicious(
            "remove frames that are listed twice; a turntable in front of a fixed camera needs poses relative to the turntable",
        ),
    };
    Check { name: "poses used twice", figure, limit, verdict, suspects, values: Vec::new() }
}

/// Checks that no two training frames have the same photograph.
pub fn photographs(train: &ViewSet) -> Check {
    const NAME: &str = "photographs used twice";
    let limit = "two training photographs with the same pixels".to_string();
    let Some(scale) = coarsest(train, SIDE) else {
        return Check::unknown(NAME, limit, "there is no photograph");
    };
    let mut known: HashMap<&[[u8; 4]], usize> = HashMap::new();
    let mut suspects = Vec::new();
    for (view, index) in scale.views.clone().enumerate() {
        let pixels = train.pixels_of(index);
        // Images of one colour are not compared: a mask that keeps nothing makes such images.
        if pixels.iter().all(|pixel| *pixel == pixels[0]) {
            continue;
        }
        match known.get(pixels) {
            Some(&first) => {
                let figure = format!("same as {}", name(train, first).unwrap_or("?"));
                suspects.push(Suspect { view, figure });
            }
            None => {
                known.insert(pixels, view);
            }
        }
    }
    let (figure, verdict) = match suspects.len() {
        0 => (format!("{} training photographs are different", scale.views.len()), Verdict::Fine),
        some => (
            format!("{some} of {} training photographs have the pixels of another", scale.views.len()),
            Verdict::Suspicious("remove the copies, or correct their names: one photograph has one pose"),
        ),
    };
    Check { name: NAME, figure, limit, verdict, suspects, values: Vec::new() }
}
