//! Checks the planned box against the object: if the ray of a pixel that shows the object misses the box, the box cuts
//! off a part of the object. World units.

use super::{
    check::{Check, Suspect, Values, Verdict},
    views::{coarsest, of_views, sampled},
};
use trimip_core::{Aabb, ViewSet, scene::silhouettes};

/// Largest usual share of a view's object outside of the box: the soft edge of a silhouette accounts for less.
const MOST_CUT: f64 = 0.02;

/// Least side of the compared images, pixels (see [`coarsest`]).
const SIDE: u32 = 96;

/// Largest number of pixels that are sampled along the longer side of a view, with one ray each.
const RAYS: u32 = 96;

/// Least alpha of a pixel that shows the object.
const OBJECT: u8 = 128;

const NAME: &str = "box around the object";

/// Checks that the box contains the object that the silhouettes show. `aabb` is `None` for unbounded space.
pub fn coverage(train: &ViewSet, aabb: Option<&Aabb<f64>>) -> Check {
    let limit = format!("more than {:.0} % of the object outside the box in a view", 100.0 * MOST_CUT);
    let Some(aabb) = aabb else {
        return Check::unknown(NAME, limit, "space is unbounded: nothing is outside the box");
    };
    let Some(scale) = coarsest(train, SIDE).filter(|_| silhouettes::any(train)) else {
        return Check::unknown(NAME, limit, "the photographs have no silhouettes");
    };
    let cut = |view: usize| {
        let (camera, pixels) = (&train.views[view].camera, train.pixels_of(view));
        let k = &camera.intrinsics;
        let (mut shown, mut missed) = (0_u32, 0_u32);
        for (x, y) in sampled(k.width, k.height, RAYS) {
            if pixels[(y * k.width + x) as usize][3] < OBJECT {
                continue;
            }
            let cone = camera.cone::<f64>(x, y);
            let (enter, leave) = aabb.intersect(cone.origin, cone.direction);
            shown += 1;
            missed += u32::from(!(enter < leave));
        }
        (shown > 0).then(|| f64::from(missed) / f64::from(shown))
    };
    let fractions: Vec<Option<f64>> = scale.views.clone().map(cut).collect();
    let known: Vec<f64> = fractions.iter().copied().flatten().collect();
    if known.is_empty() {
        return Check::unknown(NAME, limit, "the photographs show no object");
    }
    let mut doubted: Vec<(usize, f64)> = fractions
        .iter()
        .enumerate()
        .filter_map(|(view, fraction)| Some((view, (*fraction)?)))
        .filter(|(_, fraction)| *fraction > MOST_CUT)
        .collect();
    doubted.sort_by(|a, b| b.1.total_cmp(&a.1));
    let mean = 100.0 * known.iter().sum::<f64>() / known.len() as f64;
    let percent = |fraction: f64| format!("{:.1} %", 100.0 * fraction);
    let all = format!("{mean:.1} % of the object is outside the planned box (mean of the views)");
    let (figure, verdict) = match doubted.len() {
        0 => (all, Verdict::Fine),
        some => (
            format!("{all}; the box cuts the object in {}", of_views(some, fractions.len())),
            Verdict::Suspicious(
                "set scene.aabb_min and scene.aabb_max around the whole object, or leave them to the plan",
            ),
        ),
    };
    let suspect = |(view, fraction)| Suspect { view, figure: percent(fraction) };
    let suspects = doubted.into_iter().map(suspect).collect();
    let of = fractions.iter().map(|fraction| fraction.map(|fraction| 100.0 * fraction)).collect();
    let values = vec![Values { name: "object beside the box / %", of }];
    Check { name: NAME, figure, limit, verdict, suspects, values }
}
