//! Checks exposure: photographs of nearby cameras show much the same and should be about equally bright. Brightness is
//! the mean linear luminance of the kept pixels of a photograph, in stops (powers of two) relative to white.

use super::{
    check::{Check, Suspect, Values, Verdict},
    views::{cameras, coarsest, median, of_views},
};
use glam::DVec3;
use trimip_core::{Alpha, Camera, ViewSet};

/// Largest usual difference between a photograph and its neighbours, stops: cameras change exposure in steps of a third of a stop.
const MOST_STOPS: f64 = 0.5;

/// Additional stops allowed per radian between the views: the change of a matt ball that is lit at 45° to the view (the
/// logarithmic slope of Lambert's phase function).
const STOPS_PER_RADIAN: f64 = 1.0;

/// Number of nearest views that a view is compared with.
const NEIGHBOURS: usize = 4;

/// Fewest photographs that are compared.
const LEAST_VIEWS: usize = 4;

/// Least side of the compared images, pixels (see [`coarsest`]): a mean needs no larger ones.
const SIDE: u32 = 32;

/// Least alpha of a pixel that counts as kept.
const KEPT: u8 = 128;

/// Least linear luminance of a photograph, so that its logarithm stays finite.
const DARKEST: f64 = 1.0 / 4096.0;

const NAME: &str = "exposure";

/// Returns the mean brightness of the kept pixels in stops (0: white, -1: half of it), or `None` if no pixel is kept.
/// `pixels` are RGBA, in any order.
pub fn stops(pixels: &[[u8; 4]], alpha: Alpha) -> Option<f64> {
    let (mut sum, mut count) = (0.0, 0_u64);
    for pixel in pixels.iter().filter(|pixel| pixel[3] >= KEPT) {
        let whole = if alpha == Alpha::Premultiplied { f64::from(pixel[3]) } else { 255.0 };
        let [r, g, b] = [0, 1, 2].map(|c| linear((f64::from(pixel[c]) / whole).min(1.0)));
        // Rec. 709.
        sum += 0.2126 * r + 0.7152 * g + 0.0722 * b;
        count += 1;
    }
    (count > 0).then(|| (sum / count as f64).max(DARKEST).log2())
}

/// Returns the linear light of an sRGB value.
fn linear(value: f64) -> f64 {
    if value <= 0.040_45 { value / 12.92 } else { ((value + 0.055) / 1.055).powf(2.4) }
}

/// Checks that nearby photographs are equally bright.
pub fn brightness(train: &ViewSet) -> Check {
    let limit = format!(
        "a photograph that is brighter or darker than its {NEIGHBOURS} nearest views by more than {MOST_STOPS} stops plus \
         {STOPS_PER_RADIAN} for each radian between them: a camera changes exposure in steps of a third, and light from a side \
         explains the rest"
    );
    let Some(scale) = coarsest(train, SIDE) else {
        return Check::unknown(NAME, limit, "there is no photograph");
    };
    let own: Vec<Option<f64>> =
        scale.views.clone().map(|view| stops(train.pixels_of(view), train.alpha)).collect();
    let mut known: Vec<f64> = own.iter().copied().flatten().collect();
    if known.len() < LEAST_VIEWS {
        return Check::unknown(NAME, limit, "fewer than four photographs");
    }
    let cameras = cameras(train);
    let away = |view: usize| {
        let near = nearest(&cameras, &own, view);
        let difference = own[view]? - median(near.iter().map(|(_, stops)| *stops))?;
        let most = MOST_STOPS + STOPS_PER_RADIAN * median(near.iter().map(|(angle, _)| *angle))?;
        Some((difference, difference.abs() > most))
    };
    let differences: Vec<Option<(f64, bool)>> = (0..own.len()).map(away).collect();
    let mut doubted: Vec<(usize, f64)> = differences
        .iter()
        .enumerate()
        .filter_map(|(view, known)| known.filter(|(_, beyond)| *beyond).map(|(stops, _)| (view, stops)))
        .collect();
    doubted.sort_by(|a, b| b.1.abs().total_cmp(&a.1.abs()));
    known.sort_by(f64::total_cmp);
    let at = |fraction: f64| known[(fraction * (known.len() - 1) as f64).round() as usize];
    let spread = format!(
        "photographs are {:.2} stops below white (median), nine tenths of them within {:.2} stops",
        -median(known.iter().copied()).unwrap_or(0.0),
        at(0.95) - at(0.05)
    );
    let (figure, verdict) = match doubted.len() {
        0 => (spread, Verdict::Fine),
        some => (
            format!("{spread}; unlike their neighbours: {}", of_views(some, own.len())),
            Verdict::Suspicious(
                "fix exposure and white balance, develop all photographs alike, or leave these out: a model has one \
                 brightness",
            ),
        ),
    };
    let suspect = |(view, difference)| Suspect { view, figure: format!("{difference:+.2} stops") };
    let suspects = doubted.into_iter().map(suspect).collect();
    let of = differences.into_iter().map(|known| known.map(|(stops, _)| stops)).collect();
    let values = vec![Values { name: "brighter than neighbours / stops", of }];
    Check { name: NAME, figure, limit, verdict, suspects, values }
}

/// Returns the angle to `view` and the brightness of the views that are nearest to it in position and direction.
fn nearest(cameras: &[Camera], stops: &[Option<f64>], view: usize) -> Vec<(f64, f64)> {
    let midst = cameras.iter().map(|camera| camera.origin).sum::<DVec3>() / cameras.len() as f64;
    let size =
        cameras.iter().map(|camera| (camera.origin - midst).length()).fold(f64::MIN_POSITIVE, f64::max);
    let own = &cameras[view];
    let angle = |other: &Camera| own.rotation.z_axis.dot(other.rotation.z_axis).clamp(-1.0, 1.0).acos();
    let apart = |other: &Camera| (own.origin - other.origin).length() / size + angle(other);
    let others = (0..cameras.len()).filter(|&other| other != view);
    let mut others: Vec<(f64, usize, f64)> =
        others.filter_map(|other| Some((apart(&cameras[other]), other, stops[other]?))).collect();
    others.sort_by(|a, b| a.0.total_cmp(&b.0));
    others.into_iter().take(NEIGHBOURS).map(|(_, other, stops)| (angle(&cameras[other]), stops)).collect()
}
