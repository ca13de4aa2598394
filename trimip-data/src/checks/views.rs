//! Helpers of the checks for the training views: names, cameras, a coarse scale, pixels of a sparse grid.

use trimip_core::{Camera, Scale, ViewSet, plural::count};

/// Returns the name of a view of the finest scale.
pub fn name(train: &ViewSet, view: usize) -> Option<&str> {
    let index = train.scales.first()?.views.clone().nth(view)?;
    Some(train.views[index].name.as_str())
}

/// Returns the cameras of the finest scale.
pub(super) fn cameras(train: &ViewSet) -> Vec<Camera> {
    let views = train.scales.first().map_or(0..0, |scale| scale.views.clone());
    views.map(|view| train.views[view].camera).collect()
}

/// Returns the coarsest scale that has every frame and whose images have sides of at least `side` pixels; otherwise the finest scale.
pub fn coarsest(train: &ViewSet, side: u32) -> Option<&Scale> {
    let finest = train.scales.first()?;
    let fine_enough = |scale: &&Scale| {
        let sides = scale.views.clone().map(|view| train.views[view].camera.intrinsics);
        scale.views.len() == finest.views.len()
            && sides.map(|k| k.width.min(k.height)).min().is_some_and(|least| least >= side)
    };
    train.scales.iter().rev().find(fine_enough).or(Some(finest))
}

/// Returns the median of the finite values, or `None` if there are none.
pub(super) fn median(values: impl IntoIterator<Item = f64>) -> Option<f64> {
    let mut values: Vec<f64> = values.into_iter().filter(|value| value.is_finite()).collect();
    values.sort_by(f64::total_cmp);
    let middle = values.len() / 2;
    match values.len() {
        0 => None,
        length if length % 2 == 0 => Some(0.5 * (values[middle - 1] + values[middle])),
        _ => Some(values[middle]),
    }
}

/// Formats "1 of 1 view" or "7 of 12 views".
pub(super) fn of_views(some: usize, all: usize) -> String {
    format!("{some} of {}", count(all, "view"))
}

/// Returns the pixels of a grid of at most `side` × `side` over an image.
pub(super) fn sampled(width: u32, height: u32, side: u32) -> impl Iterator<Item = (u32, u32)> {
    let stride = width.max(height).div_ceil(side).max(1);
    let along = move |length: u32| (stride / 2).min(length.saturating_sub(1))..length;
    along(height)
        .step_by(stride as usize)
        .flat_map(move |y| along(width).step_by(stride as usize).map(move |x| (x, y)))
}
