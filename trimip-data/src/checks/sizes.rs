//! Checks sizes and focal lengths: one camera takes photographs of one size and one angle of view. Copies in another
//! size, crops with the old focal length and zoomed shots differ.

use super::{
    check::{Check, Suspect, Verdict},
    views::{cameras, median, of_views},
};
use trimip_core::{Camera, ViewSet};

/// An image is doubted if its side √(width·height) differs from the median by more than this factor: images of two
/// cameras rarely do, a thumbnail does.
const MOST_SIZE: f64 = 1.5;

/// An image is doubted if its focal length, as a share of the side, differs from the median by more than this factor:
/// it is a zoomed shot, or a crop that kept its old focal length.
const MOST_FOCAL: f64 = 1.5;

/// Checks that the training photographs have about one size and one angle of view.
pub fn sizes(train: &ViewSet) -> Check {
    const NAME: &str = "sizes and focal lengths";
    let limit = format!(
        "a side that differs from the median by more than a factor of {MOST_SIZE}, or a focal length as a share of the side by more \
         than {MOST_FOCAL}: a thumbnail, a crop or a zoom"
    );
    let cameras = cameras(train);
    let side = |camera: &Camera| {
        let k = &camera.intrinsics;
        (f64::from(k.width) * f64::from(k.height)).sqrt()
    };
    let focal = |camera: &Camera| (camera.intrinsics.fx * camera.intrinsics.fy).sqrt() / side(camera);
    let medians = median(cameras.iter().map(side)).zip(median(cameras.iter().map(focal)));
    let Some((usual_side, usual_focal)) = medians else {
        return Check::unknown(NAME, limit, "there is no photograph");
    };
    let factor = |value: f64, usual: f64| (value / usual).max(usual / value);
    let doubt = |(view, camera): (usize, &Camera)| {
        let [size, zoom] = [factor(side(camera), usual_side), factor(focal(camera), usual_focal)];
        let k = &camera.intrinsics;
        let figure = match (size > MOST_SIZE, zoom > MOST_FOCAL) {
            (false, false) => return None,
            (true, _) => format!("{}x{}", k.width, k.height),
            (false, true) => format!("focal length {:.0} pixels of {}x{}", k.fx, k.width, k.height),
        };
        Some((size.max(zoom), Suspect { view, figure }))
    };
    let mut doubted: Vec<(f64, Suspect)> = cameras.iter().enumerate().filter_map(doubt).collect();
    doubted.sort_by(|a, b| b.0.total_cmp(&a.0));
    let range = |of: &dyn Fn(&Camera) -> f64, usual: f64| {
        let fractions = || cameras.iter().map(|camera| of(camera) / usual);
        [fractions().fold(f64::INFINITY, f64::min), fractions().fold(0.0, f64::max)]
    };
    let ([small, large], [wide, long]) = (range(&side, usual_side), range(&focal, usual_focal));
    let all = format!(
        "sides are {small:.2} to {large:.2} times the median, focal lengths as shares of the sides {wide:.2} to {long:.2} times"
    );
    let (figure, verdict) = match doubted.len() {
        0 => (all, Verdict::Fine),
        some => (
            format!("{all}; unlike the others: {}", of_views(some, cameras.len())),
            Verdict::Suspicious(
                "a crop or a copy in another size needs its own focal length; leave out zoomed shots that were calibrated as \
                 one camera",
            ),
        ),
    };
    let suspects = doubted.into_iter().map(|(_, suspect)| suspect).collect();
    Check { name: NAME, figure, limit, verdict, suspects, values: Vec::new() }
}
