//! Bounding box of an object, from its silhouettes: the bounds of a coarse visual hull. Cells are carved if a photograph
//! shows only background there; cells about which no photograph decides are kept.

use crate::geometry::occupancy::coordinates;
use crate::geometry::projections::BallImage;
use crate::scene::strays::strays;
use crate::{Aabb, Camera, Scale, ViewSet};
use glam::DVec3;

/// Number of cells along each side: of the first pass, over the whole box, and of the second, over the bounds that the
/// first pass found.
const CELLS: [usize; 2] = [48, 96];

/// Largest number of silhouettes used. Fewer silhouettes only give a larger hull.
const MOST_VIEWS: usize = 128;

/// Number of photographs that must show only background at a cell before [`cells`] counts the cell as empty.
const VOTES: usize = 2;

/// Smallest width or height, in pixels, of the photographs of a scale that is used, unless those of the finest scale are
/// smaller.
const FINE_ENOUGH: u32 = 128;

/// The silhouette of a view: a summed-area table of the pixels with any opacity.
struct Silhouette {
    camera: Camera,
    /// `None` for a photograph without transparent pixels: it carves nothing.
    sums: Option<Vec<u32>>,
}

/// Relation of a cell to a view.
enum Verdict {
    /// The cell lies outside of the photograph.
    Unseen,
    /// The object may be there.
    Maybe,
    /// The photograph shows only background there.
    Empty,
}

impl Silhouette {
    fn new(views: &ViewSet, index: usize) -> Self {
        let camera = views.views[index].camera;
        let (width, pixels) = (camera.intrinsics.width as usize, views.pixels_of(index));
        if pixels.iter().all(|pixel| pixel[3] > 0) {
            return Self { camera, sums: None };
        }
        let mut sums = vec![0; (width + 1) * (camera.intrinsics.height as usize + 1)];
        for (y, row) in pixels.chunks_exact(width).enumerate() {
            let mut sum = 0;
            for (x, pixel) in row.iter().enumerate() {
                sum += u32::from(pixel[3] > 0);
                sums[(y + 1) * (width + 1) + x + 1] = sums[y * (width + 1) + x + 1] + sum;
            }
        }
        Self { camera, sums: Some(sums) }
    }

    /// Returns the number of object pixels in the columns and rows from `low` to `high`, excluding `high`.
    fn count(&self, sums: &[u32], low: [usize; 2], high: [usize; 2]) -> u32 {
        let at = |x: usize, y: usize| sums[y * (self.camera.intrinsics.width as usize + 1) + x];
        at(high[0], high[1]) + at(low[0], low[1]) - at(low[0], high[1]) - at(high[0], low[1])
    }

    /// Returns the relation of a ball around `centre` to the view.
    fn verdict(&self, centre: DVec3, radius: f64) -> Verdict {
        let k = &self.camera.intrinsics;
        let at = self.camera.rotation.transpose() * (centre - self.camera.origin);
        let (place, reach) = match k.ball(at, radius) {
            BallImage::None => return Verdict::Unseen,
            BallImage::Anywhere => return Verdict::Maybe,
            BallImage::Within { at, reach } => (at, reach),
        };
        let [x, y] = place;
        let (width, height) = (f64::from(k.width), f64::from(k.height));
        if x + reach <= 0.0 || y + reach <= 0.0 || x - reach >= width || y - reach >= height {
            return Verdict::Unseen;
        }
        if x - reach < 0.0 || y - reach < 0.0 || x + reach > width || y + reach > height {
            return Verdict::Maybe;
        }
        let low = [x - reach, y - reach].map(|value| value.floor() as usize);
        let high = [x + reach, y + reach].map(|value| value.ceil() as usize);
        match &self.sums {
            Some(sums) if self.count(sums, low, high) == 0 => Verdict::Empty,
            _ => Verdict::Maybe,
        }
    }
}

/// Returns true if any photograph has a transparent pixel.
pub fn any(views: &ViewSet) -> bool {
    let Some(coarsest) = views.scales.last() else { return false };
    views.alpha.is_opacity() && views.pixels[coarsest.pixels.clone()].iter().any(|pixel| pixel[3] == 0)
}

/// Returns the bounds of the places within `aabb` that may hold the object and that at least `fraction` of the photographs see
/// (0: at least one photograph). No part of the object at such places lies outside of the bounds. `None` if no photograph has a
/// silhouette, or if the silhouettes leave no place.
pub fn bounds(views: &ViewSet, aabb: &Aabb<f64>, fraction: f64) -> Option<Aabb<f64>> {
    bounds_despite(views, aabb, fraction, 0.0)
}

/// Returns the same as [`bounds`], but keeps a place even if up to a share `wrong` of the photographs show background there,
/// so that a few wrong poses or masks carve nothing.
pub fn bounds_despite(views: &ViewSet, aabb: &Aabb<f64>, fraction: f64, wrong: f64) -> Option<Aabb<f64>> {
    let silhouettes = silhouettes(views)?;
    let of = |fraction: f64| fraction * silhouettes.len() as f64;
    let rule = Rule { least: (of(fraction).ceil() as usize).max(1), most_empty: of(wrong) as usize };
    CELLS.iter().try_fold(*aabb, |aabb, &cells| hull(&silhouettes, &aabb, cells, rule))
}

/// Condition under which a place is kept.
#[derive(Clone, Copy)]
struct Rule {
    /// Smallest number of views that must see the place.
    least: usize,
    /// Largest number of views that may show only background there.
    most_empty: usize,
}

/// Returns, for each cell of a grid with `resolution` cells along each side of `aabb` (x fastest), whether the object may
/// be there. A cell is empty if at least two photographs show only background there, so that one wrong mask carves nothing.
/// `None` if no photograph has a silhouette.
pub fn cells(views: &ViewSet, aabb: &Aabb<f64>, resolution: u32) -> Option<Vec<bool>> {
    let mut silhouettes = silhouettes(views)?;
    silhouettes.retain(|silhouette| silhouette.sums.is_some());
    let side = aabb.extent().map(|side| side / f64::from(resolution));
    let radius = 0.5 * DVec3::from_array(side).length();
    let may = |cell: u32| {
        let index = coordinates(cell, resolution);
        let centre = std::array::from_fn(|axis| aabb.min[axis] + (f64::from(index[axis]) + 0.5) * side[axis]);
        let centre = DVec3::from_array(centre);
        let empty = silhouettes.iter().filter(|s| matches!(s.verdict(centre, radius), Verdict::Empty));
        empty.take(VOTES).count() < VOTES
    };
    Some((0..resolution.pow(3)).map(may).collect())
}

/// Returns the views of the coarsest scale that is fine enough. At most [`MOST_VIEWS`] of them have silhouettes; views without
/// one come last. `None` if no view has a silhouette.
fn silhouettes(views: &ViewSet) -> Option<Vec<Silhouette>> {
    if !views.alpha.is_opacity() {
        return None;
    }
    let fine_enough = |scale: &&Scale| {
        let sides = scale.views.clone().map(|i| views.views[i].camera.intrinsics);
        sides.map(|k| k.width.min(k.height)).min().is_some_and(|side| side >= FINE_ENOUGH)
    };
    let scale = views.scales.iter().rev().find(fine_enough).or(views.scales.first())?;
    let stride = scale.views.len().div_ceil(MOST_VIEWS).max(1);
    // A stray camera has a wrong pose, so its silhouette carves nothing.
    let cameras: Vec<Camera> = scale.views.clone().map(|index| views.views[index].camera).collect();
    let strays: Vec<usize> = strays(&cameras).into_iter().map(|(place, _)| place).collect();
    let mut silhouettes: Vec<_> = scale
        .views
        .clone()
        .enumerate()
        .map(|(place, index)| match place.is_multiple_of(stride) && !strays.contains(&place) {
            true => Silhouette::new(views, index),
            false => Silhouette { camera: views.views[index].camera, sums: None },
        })
        .collect();
    // Views with silhouettes come first, so that most cells are carved before the other views are used.
    silhouettes.sort_by_key(|silhouette| silhouette.sums.is_none());
    silhouettes.first().is_some_and(|silhouette| silhouette.sums.is_some()).then_some(silhouettes)
}

/// Returns the bounds of the cells of a grid over `aabb` that are not carved.
fn hull(silhouettes: &[Silhouette], aabb: &Aabb<f64>, cells: usize, rule: Rule) -> Option<Aabb<f64>> {
    let cell = aabb.extent().map(|side| side / cells as f64);
    let radius = 0.5 * DVec3::from_array(cell).length();
    let (mut low, mut high) = ([usize::MAX; 3], [0; 3]);
    for i in 0..cells.pow(3) {
        let index = [i % cells, i / cells % cells, i / cells / cells];
        // Cells within the bounds found so far need no test.
        if (0..3).all(|axis| low[axis] <= index[axis] && index[axis] < high[axis]) {
            continue;
        }
        let centre = std::array::from_fn(|axis| aabb.min[axis] + (index[axis] as f64 + 0.5) * cell[axis]);
        if kept(silhouettes, DVec3::from_array(centre), radius, rule) {
            for axis in 0..3 {
                low[axis] = low[axis].min(index[axis]);
                high[axis] = high[axis].max(index[axis] + 1);
            }
        }
    }
    let corner = |at: [usize; 3]| std::array::from_fn(|axis| aabb.min[axis] + at[axis] as f64 * cell[axis]);
    (high[0] > 0).then(|| Aabb { min: corner(low), max: corner(high) })
}

/// Returns true unless too many views show only background at a cell or too few see it. Unseen cells cannot be learned.
fn kept(silhouettes: &[Silhouette], centre: DVec3, radius: f64, rule: Rule) -> bool {
    let (mut seen, mut empty) = (0, 0);
    for silhouette in silhouettes {
        if seen >= rule.least && silhouette.sums.is_none() {
            break;
        }
        match silhouette.verdict(centre, radius) {
            Verdict::Unseen => {}
            Verdict::Maybe => seen += 1,
            Verdict::Empty if empty == rule.most_empty => return false,
            Verdict::Empty => empty += 1,
        }
    }
    seen >= rule.least
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Alpha, Intrinsics, View};

    /// Returns silhouettes of a box, from cameras all around it.
    fn photographs(object: &Aabb<f64>, opaque: bool) -> ViewSet {
        let k = Intrinsics::from_angle(160, 160, 0.7);
        let (mut views, mut pixels) = (Vec::new(), Vec::new());
        for i in 0..24 {
            let (turn, rise) = (f64::from(i) * 2.4, f64::from(i % 5) * 0.35 - 0.5);
            let origin = 4.5 * DVec3::new(turn.cos() * rise.cos(), turn.sin() * rise.cos(), rise.sin());
            let camera = Camera::look_at(k, origin, DVec3::ZERO, DVec3::Z);
            views.push(View { name: format!("{i}"), camera, offset: pixels.len() });
            for (y, x) in (0..k.height).flat_map(|y| (0..k.width).map(move |x| (y, x))) {
                let cone = camera.cone::<f64>(x, y);
                let (enter, leave) = object.intersect(cone.origin, cone.direction);
                pixels.push([200, 200, 200, if opaque || enter < leave { 255 } else { 0 }]);
            }
        }
        let all = Scale { factor: 1, weight: 1.0, views: 0..views.len(), pixels: 0..pixels.len() };
        ViewSet {
            views,
            pixels: pixels.into(),
            alpha: Alpha::Straight,
            scales: vec![all],
            depths: Vec::new(),
        }
    }

    #[test]
    fn the_hull_holds_the_object_and_little_more() {
        let whole = Aabb { min: [-1.5; 3], max: [1.5; 3] };
        for object in [
            Aabb { min: [-0.3, -0.9, -0.2], max: [0.4, 0.6, 0.5] },
            Aabb { min: [0.1, 0.1, 0.1], max: [0.2, 0.3, 0.9] },
        ] {
            let found = bounds(&photographs(&object, false), &whole, 0.0).unwrap();
            for axis in 0..3 {
                // The tolerance is two pixels of 0.02 units and a cell of the finer grid.
                let (below, above) = (object.min[axis] - found.min[axis], found.max[axis] - object.max[axis]);
                assert!((-1e-9..0.15).contains(&below), "axis {axis}: {below} below {object:?}");
                assert!((-1e-9..0.15).contains(&above), "axis {axis}: {above} above {object:?}");
            }
        }
    }

    /// Checks that a place that only an opaque photograph sees, such as a close-up, stays within the bounds: it may hold a
    /// subject.
    #[test]
    fn what_an_opaque_photograph_sees_stays() {
        let whole = Aabb { min: [-1.5; 3], max: [1.5; 3] };
        let object = Aabb { min: [-1.2, -0.2, -0.2], max: [-0.8, 0.2, 0.2] };
        let mut views = photographs(&object, false);
        // Both cameras look at the object through a narrow lens, from the side where nothing else is.
        let narrow = Intrinsics::from_angle(160, 160, 0.25);
        views.views.truncate(2);
        for (index, origin) in
            [DVec3::new(-1.0, 0.5, 5.0), DVec3::new(-1.0, 5.0, 0.5)].into_iter().enumerate()
        {
            let camera = Camera::look_at(narrow, origin, DVec3::new(-1.0, 0.0, 0.0), DVec3::Z);
            views.views[index].camera = camera;
            let cones = (0..160).flat_map(|y| (0..160).map(move |x| camera.cone::<f64>(x, y)));
            let start = views.views[index].offset;
            for (pixel, cone) in views.pixels[start..].iter_mut().zip(cones) {
                let (enter, leave) = object.intersect(cone.origin, cone.direction);
                pixel[3] = if enter < leave { 255 } else { 0 };
            }
        }
        views.scales[0].views = 0..2;
        let without = bounds(&views, &whole, 0.0).unwrap();
        let close = Camera::look_at(narrow, DVec3::new(1.1, 0.0, 3.0), DVec3::new(1.1, 0.0, 0.0), DVec3::Y);
        let offset = views.pixels.len();
        views.pixels.extend(vec![[200, 200, 200, 255]; 160 * 160]);
        views.views.push(View { name: "close".into(), camera: close, offset });
        views.scales[0].views = 0..3;
        let with = bounds(&views, &whole, 0.0).unwrap();
        assert!(without.max[0] < 0.5, "{without:?}");
        assert!(with.max[0] > 1.1 && with.min[0] <= without.min[0], "{with:?}");
    }

    #[test]
    fn opaque_photographs_tell_nothing_and_an_object_larger_than_the_box_leaves_it() {
        let whole = Aabb { min: [-0.5; 3], max: [0.5; 3] };
        let large = Aabb { min: [-0.8; 3], max: [0.8; 3] };
        assert_eq!(bounds(&photographs(&large, true), &whole, 0.0), None);
        let masked = ViewSet { alpha: Alpha::Kept, ..photographs(&large, false) };
        assert_eq!(
            (bounds(&masked, &whole, 0.0), any(&masked)),
            (None, false),
            "what is not known is not empty"
        );
        assert_eq!(cells(&masked, &whole, 4), None);
        let found = bounds(&photographs(&large, false), &whole, 0.0).unwrap();
        assert!((0..3).all(|axis| found.min[axis] <= -0.5 + 1e-9 && found.max[axis] >= 0.5 - 1e-9));
    }
}
